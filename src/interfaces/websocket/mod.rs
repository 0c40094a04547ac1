//! WebSocket: JSON-RPC 2.0 with operations as methods and updates as notifications.
//!
//! A client's `socket` reads and answers requests, until its `farewell`. Its `writer` sends responses and updates on
//! another runtime, from an `outbox` with bounded bytes.

mod bodies;
mod farewell;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;
mod message_results;
mod outbox;
mod rpc;
mod socket;
mod socket_end;
mod split_connection;
mod writer;

pub use bodies::{Subscribe, Subscribed};
pub use rpc::MAX_ID_BYTES;
pub use socket::{Connection, serve};

pub const SUBPROTOCOL: &str = "wsg.v1";
