//! The doors: each parses once, admits nothing, and hands what clients ask for to a gripper's handle.
//!
//! Architecture invariant: a door decides nothing about a gripper. What is refused because of a lease, a latch or a
//! device's limits is refused by the gripper's actor, so all doors refuse the same.

mod admission;
mod context;
pub mod dashboard;
pub mod http;
pub mod metrics;
mod pace;
mod quick_ack;
mod runtimes;
pub mod sockets;
pub mod websocket;
pub mod wsg_port;
pub mod zenoh;

pub use admission::Bounds;
pub use context::Context;
pub use runtimes::Runtimes;
