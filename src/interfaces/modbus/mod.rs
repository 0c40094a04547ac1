//! Modbus TCP: the grippers as registers, for PLCs and other cyclic controllers.
//!
//! `registers` has the layout of both register maps. `commands` translates the gateway map to orders, and `fieldbus` the
//! gripper's own cyclic image. `image` keeps the registers that a client has written, and decides when they are an order.
//! `status` fills the input registers. `adu` reads and writes the frames, `connection` serves one client, and `server`
//! accepts them. `context` has what they share.
//!
//! A client is known by its address, since Modbus has no credentials. Its first motion takes a free lease, which ends
//! with the connection, as on the WSG port.
//!
//! The requests are parsed by tokio-modbus. Its server is not used: it ends all connections if it fails to accept one,
//! and closes a connection for a request with a wrong length.

mod adu;
mod commands;
mod connection;
mod context;
mod fieldbus;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;
mod image;
mod order;
mod registers;
mod server;
mod status;

pub use context::{ModbusContext, ModbusSettings};
pub use server::serve;
