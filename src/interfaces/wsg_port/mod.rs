//! The WSG port: the manual's own protocol for several clients at a time, each with its own virtual device.
//!
//! `device` is the virtual device, a pure machine. Its parts are `input` (parses requests), `values` (what getters
//! return), `acknowledge` (24h, and the right to it) and `status` (maps refusals to statuses). `client` is the I/O
//! around the device, `rights` checks the clients' roles, and `refusals` reports what was refused. `tcp` and `udp`
//! accept clients, `opening` checks their first bytes, and `unreachable` notices dead ones.
//!
//! A motion takes a free lease, and the client keeps the lease until it announces its disconnect (07h) or is lost. No
//! client gets a frame that it has not requested.

mod acknowledge;
mod client;
mod device;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;
mod input;
mod listener;
mod opening;
mod order;
mod port;
mod refusals;
mod rights;
mod status;
mod tcp;
mod udp;
mod unreachable;
mod values;

pub use listener::{ListenAddress, Listener, serve};
pub use port::{AcknowledgePolicy, LOST_AFTER, LimitsPolicy, Port, Rules};
pub use udp::Datagrams;
