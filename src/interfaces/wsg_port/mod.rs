//! The WSG port: a gripper that speaks the manual's own protocol, to several clients at a time, each with a virtual
//! device of its own.
//!
//! `device` is that device, a pure machine, with `input` (requests in bytes) and `status` (what was not done, as a
//! status); `client` is the I/O around it, and `tcp` and `udp` bring clients in.
//!
//! A motion takes the lease where it is free, and the client keeps it until it announces its end (07h), or is lost. No
//! client gets a frame that it has not asked for.

mod client;
mod device;
mod input;
mod listener;
mod port;
mod status;
mod tcp;
mod udp;

pub use listener::{Address, Listener, serve};
pub use port::{LOST_AFTER, MAX_DESCRIPTORS, MIN_DESCRIPTORS, Port, Rules};
pub use udp::Datagrams;
