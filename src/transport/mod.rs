//! Byte pipes to devices. Knows nothing of the protocol.
//!
//! An [`Address`] is where a device is, as a URL; [`Address::connect`] makes a [`Pipe`] to it. One write to a pipe's
//! writer is one frame, for the transports that care.

mod address;
mod tcp;

use std::fmt;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};

pub use address::{Address, InvalidAddress};
pub use tcp::TcpAddress;

/// How long connecting may take before it counts as failed.
pub const CONNECT_WITHIN: Duration = Duration::from_secs(3);

/// A connection to a device.
pub struct Pipe {
    /// What the device sends. An end of file, like an error, is the end of the link.
    pub reader: Box<dyn AsyncRead + Send + Unpin>,
    /// What the device is sent.
    pub writer: Box<dyn AsyncWrite + Send + Unpin>,
}

impl fmt::Debug for Pipe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pipe").finish_non_exhaustive()
    }
}

/// What a transport means for the protocol on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Traits {
    /// The scheme of its URLs.
    pub name: &'static str,
    /// Whether the device notices the connection's end: FAST STOP unless it was announced (`fw4-en 3.1.2`).
    pub connection_oriented: bool,
    /// How fast the line is, where that matters.
    pub bytes_per_second: Option<u32>,
    /// How long a frame's bytes may stop coming, beyond their line time, before the frame is given up.
    pub frame_gap: Duration,
}
