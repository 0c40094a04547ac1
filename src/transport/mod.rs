//! Byte pipes to devices, independent of the protocol.
//!
//! An [`Address`] is a device's URL, and [`Address::connect`] opens a [`Pipe`] to the device. Each write to the pipe's
//! writer must be one frame. On slow lines, a flush completes once the frame has been transmitted.

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
pub use present::available;
pub use serial::SerialAddress;
pub use tcp::TcpAddress;
pub use udp::UdpAddress;

/// Time limit for connecting.
pub const CONNECT_WITHIN: Duration = Duration::from_secs(3);

/// A connection to a device.
pub struct Pipe {
    /// Bytes from the device. End of file, like an error, is the end of the link.
    pub reader: Box<dyn AsyncRead + Send + Unpin>,
    /// Bytes to the device, one frame per write. A flush ends when the frame is on the line, so that no frame waits in
    /// a buffer where a FAST STOP cannot overtake it.
    pub writer: Box<dyn AsyncWrite + Send + Unpin>,
    /// Discards the bytes that the operating system has not sent yet, when the pipe is closed; `None` if there are none.
    pub discard_unsent: Option<Box<dyn Fn() + Send + Sync>>,
}

impl Pipe {
    /// A pipe without bytes in buffers of the operating system.
    #[must_use]
    pub fn new(
        reader: impl AsyncRead + Send + Unpin + 'static,
        writer: impl AsyncWrite + Send + Unpin + 'static,
    ) -> Self {
        Self { reader: Box::new(reader), writer: Box::new(writer), discard_unsent: None }
    }
}

impl fmt::Debug for Pipe {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Pipe").finish_non_exhaustive()
    }
}

/// Properties of a transport that matter to the protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkProperties {
    /// URL scheme.
    pub name: &'static str,
    /// Whether the device notices the end of a connection. Unless announced with 07h, the end is then a FAST STOP
    /// (`fw4-en 3.1.2`).
    pub connection_oriented: bool,
    /// Line rate, or `None` if it does not matter.
    pub bytes_per_second: Option<u32>,
    /// Whether frames can be duplicated.
    pub may_duplicate: bool,
    /// Time limit, beyond the line time, after which an incomplete frame is given up.
    pub frame_gap: Duration,
}

/// Host and port of a URL. Apart from options, other parts are an error.
fn host_of(url: &Url, default_port: u16) -> Result<(String, u16), String> {
    let host = url.host_str().filter(|host| !host.is_empty()).ok_or("the host is missing")?;
    let port = url.port().unwrap_or(default_port);
    if port == 0 {
        return Err("port 0 is not valid".to_owned());
    }
    if !url.username().is_empty() || url.password().is_some() {
        return Err("user and password are not supported".to_owned());
    }
    if !matches!(url.path(), "" | "/") {
        return Err("only options can follow the port".to_owned());
    }
    // An IPv6 address has brackets in a URL, but not in a socket address.
    Ok((host.trim_start_matches('[').trim_end_matches(']').to_owned(), port))
}
