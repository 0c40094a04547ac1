//! Byte pipes to devices. Knows nothing of the protocol.
//!
//! An [`Address`] is where a device is, as a URL; [`Address::connect`] makes a [`Pipe`] to it. One write to a pipe's
//! writer is one frame, for the transports that care; one flush is its way through the line, for those that are slow.

mod address;
pub mod can;
mod options;
mod pace;
mod present;
mod serial;
mod tcp;
mod udp;

use std::fmt;
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};
use url::Url;

pub use address::{Address, InvalidAddress};
pub use can::CanAddress;
pub use options::Options;
pub use pace::Pacer;
pub use serial::SerialAddress;
pub use tcp::TcpAddress;
pub use udp::UdpAddress;

/// How long connecting may take before it counts as failed.
pub const CONNECT_WITHIN: Duration = Duration::from_secs(3);

/// A connection to a device.
pub struct Pipe {
    /// What the device sends. An end of file, like an error, is the end of the link.
    pub reader: Box<dyn AsyncRead + Send + Unpin>,
    /// What the device is sent: a frame a write. A flush ends when the frame is on the line, so that nothing waits in a
    /// buffer where it can't be overtaken any more.
    pub writer: Box<dyn AsyncWrite + Send + Unpin>,
}

impl fmt::Debug for Pipe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pipe").finish_non_exhaustive()
    }
}

/// What a transport means for the protocol on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkProperties {
    /// The scheme of its URLs.
    pub name: &'static str,
    /// Whether the device notices the connection's end: FAST STOP unless it was announced (`fw4-en 3.1.2`).
    pub connection_oriented: bool,
    /// How fast the line is, where that matters.
    pub bytes_per_second: Option<u32>,
    /// Whether a frame may come twice.
    pub may_duplicate: bool,
    /// How long a frame's bytes may stop coming, beyond their line time, before the frame is given up.
    pub frame_gap: Duration,
}

/// The host and the port of a URL that has nothing else but options.
fn host_of(url: &Url, default_port: u16) -> Result<(String, u16), String> {
    let host = url.host_str().filter(|host| !host.is_empty()).ok_or("it names no host")?;
    let port = url.port().unwrap_or(default_port);
    if port == 0 {
        return Err("port 0 cannot be connected to".to_owned());
    }
    if !url.username().is_empty() || url.password().is_some() {
        return Err("a device has no user and no password".to_owned());
    }
    if !matches!(url.path(), "" | "/") {
        return Err("nothing but options may stand behind the port".to_owned());
    }
    // A URL has an IPv6 address in brackets; a socket address has not.
    Ok((host.trim_start_matches('[').trim_end_matches(']').to_owned(), port))
}
