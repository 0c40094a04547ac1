//! The doors: each parses once, admits nothing, and hands what clients ask for to a gripper's handle.
//!
//! Architecture invariant: a door decides nothing about a gripper. What is refused because of a lease, a latch or a
//! device's limits is refused by the gripper's actor, so all doors refuse the same.

mod admission;
pub mod dashboard;
pub mod http;
pub mod metrics;
pub mod refusals;
mod runtimes;
pub mod sockets;
pub mod wsg_port;
pub mod zenoh;

pub use admission::Bounds;
pub use runtimes::Runtimes;
