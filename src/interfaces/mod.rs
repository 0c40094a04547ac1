//! The interfaces: each parses requests once and passes them to operations or to a gripper's handle.
//!
//! Architecture invariant: an interface decides nothing about a gripper. The gripper's actor refuses requests because
//! of a lease, a latch or a device's limits, so all interfaces refuse the same requests.

mod context;
pub mod dashboard;
pub mod http;
pub mod modbus;
pub mod mqtt;
mod on_demand;
pub mod websocket;
pub mod wsg_port;
pub mod zenoh;

pub use context::Context;
