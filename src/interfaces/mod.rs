//! The interfaces: each parses requests once and passes them to operations or to a gripper's handle.
//!
//! Architecture invariant: an interface decides nothing about a gripper. The gripper's actor refuses requests because
//! of a lease, a latch or a device's limits, so all interfaces refuse the same requests.

mod accept;
mod admission;
mod client_stream;
mod context;
pub mod dashboard;
pub mod foreign;
pub mod http;
pub mod metrics;
pub mod modbus;
pub mod mqtt;
pub mod networks;
mod on_demand;
mod pace;
pub mod peers;
mod quick_ack;
mod runtimes;
pub mod self_signed;
pub mod sockets;
pub mod tls;
pub mod websocket;
pub mod wsg_port;
pub mod zenoh;

pub use accept::listen;
pub use admission::Bounds;
pub use context::Context;
pub use runtimes::Runtimes;
