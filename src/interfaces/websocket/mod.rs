//! WebSocket: JSON-RPC 2.0, with operations as methods, and updates as notifications.
//!
//! A client's `socket` reads and answers requests; its `writer` writes answers and updates on another runtime, from an
//! `outbox` whose bytes are bounded.

mod bodies;
mod halves;
mod outbox;
mod rpc;
mod socket;
mod writer;

pub use bodies::{Subscribe, Subscribed};
pub use socket::{Connection, serve};

/// The subprotocol.
pub const SUBPROTOCOL: &str = "wsg.v1";
