//! Byte pipes to devices, independent of the protocol.
//!
//! An [`Address`] is a device's URL, and [`Address::connect`] opens a [`Pipe`] to the device. Each write to the pipe's
//! writer must be one frame. On slow lines, a flush completes once the frame has been transmitted. "Field practice" in
//! a comment refers to the section of this name in `src/rulings.md`.

mod address;
pub mod can;
mod exclusive;
pub mod host;
mod options;
mod pace;
mod present;
mod serial;
mod tcp;
mod udp;

use std::fmt;
use std::net::IpAddr;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite};
use url::{Host, Url};

pub use address::{Address, InvalidAddress};
pub use can::CanAddress;
pub use exclusive::{DevicesInUse, ExclusiveAddress, find_same_device};
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
    /// Discards the bytes that the operating system has not sent yet, when the pipe is closed; `None` without any.
    pub discard_unsent: Option<Box<dyn Fn() + Send + Sync>>,
    /// First other address that bytes came from. They are ignored; the address helps to find a wrong configuration.
    pub stranger: Arc<OnceLock<IpAddr>>,
}

impl Pipe {
    /// A pipe without bytes in buffers of the operating system.
    #[must_use]
    pub fn new(
        reader: impl AsyncRead + Send + Unpin + 'static,
        writer: impl AsyncWrite + Send + Unpin + 'static,
    ) -> Self {
        Self { reader: Box::new(reader), writer: Box::new(writer), discard_unsent: None, stranger: Arc::default() }
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

/// Host and port of a URL, and the zone that was taken out of the URL. Apart from options, other parts are an error.
fn host_of(url: &Url, zone: Option<&str>, default_port: u16) -> Result<(String, u16), String> {
    let host = match url.host().ok_or("the host is missing")? {
        Host::Domain("") => return Err("the host is missing".to_owned()),
        Host::Domain(name) => {
            host::check_host(name).map_err(|error| format!("the host is {error}"))?;
            name.to_ascii_lowercase()
        }
        Host::Ipv4(address) => address.to_string(),
        Host::Ipv6(address) => match zone {
            Some(zone) if !address.is_unicast_link_local() => {
                return Err(format!("{address} is not a link-local address, so leave out the zone %{zone}"));
            }
            Some(zone) if !is_interface_name(zone) => {
                return Err(format!("the zone {zone:?} is not the name of a network interface"));
            }
            Some(zone) => format!("{address}%{zone}"),
            None if address.is_unicast_link_local() => {
                return Err(format!(
                    "{address} is a link-local address, so name the network interface too: [{address}%25eth0]"
                ));
            }
            None => address.to_string(),
        },
    };
    if let Some(kind) = host.parse().ok().and_then(host::kind_of_no_device) {
        return Err(format!("{host} is {kind}; use the device's own address"));
    }
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
    Ok((host, port))
}

/// Whether the kernel could have an interface of this name, or number.
fn is_interface_name(zone: &str) -> bool {
    // IFNAMSIZ, including the terminating NUL.
    (1..=15).contains(&zone.len()) && zone.chars().all(|letter| letter.is_ascii_graphic() && letter != '/')
}
