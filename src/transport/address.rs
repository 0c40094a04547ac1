//! Device addresses as URLs: `tcp://192.168.1.20:1000`, `udp://192.168.1.20:1500?local_port=1501`,
//! `serial:///dev/ttyUSB0?baud=115200&stop_bits=1`, `can://can0?tx=0x64&rx=0x65`.

use std::borrow::Cow;
use std::fmt;
use std::io;
use std::net::SocketAddr;
use std::str::FromStr;

use tokio::time::Instant;
use url::Url;

use super::can::CanAddress;
use super::serial::SerialAddress;
use super::tcp::{self, TcpAddress};
use super::udp::{self, UdpAddress};
use super::{CONNECT_WITHIN, LinkProperties, Pipe, host};

/// Address of a device.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// `tcp://host:port`
    Tcp(TcpAddress),
    /// `udp://host:port?local_port=port`
    Udp(UdpAddress),
    /// `serial:///path?baud=rate&stop_bits=number`
    Serial(SerialAddress),
    /// `can://interface?tx=id&rx=id&bitrate=rate`
    Can(CanAddress),
}

/// Example URL of each transport.
const EXAMPLES: [(&str, &str); 4] = [
    ("tcp", "tcp://192.168.1.20:1000"),
    ("udp", "udp://192.168.1.20:1500?local_port=1501"),
    ("serial", "serial:///dev/ttyUSB0?baud=115200&stop_bits=1"),
    ("can", "can://can0?tx=0x64&rx=0x65"),
];

/// Reason why a text is not a valid address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidAddress {
    /// The text is not a URL.
    #[error("{text:?} is not a valid URL ({detail}); write it as {example}")]
    NoUrl {
        text: String,
        detail: String,
        /// Valid URL of the same transport.
        example: &'static str,
    },
    /// No transport has this scheme.
    #[error("{text:?}: unknown transport {scheme:?}; use one of tcp, udp, serial, can")]
    UnknownScheme { text: String, scheme: String },
    /// A part of the URL is missing, invalid or not supported by the transport.
    #[error("{text:?}: {detail}; write it as {example}")]
    Part {
        text: String,
        detail: String,
        /// Valid URL of the same transport.
        example: &'static str,
    },
}

/// Example URL with the same scheme as `text`.
fn example_for(text: &str) -> &'static str {
    let scheme = text.split(':').next().unwrap_or_default();
    let example = EXAMPLES.iter().find(|(name, _)| *name == scheme).unwrap_or(&EXAMPLES[0]);
    example.1
}

impl FromStr for Address {
    type Err = InvalidAddress;

    fn from_str(text: &str) -> Result<Self, InvalidAddress> {
        let example = example_for(text);
        let (plain, zone) = take_zone(text);
        let url = Url::parse(&plain).map_err(|error| InvalidAddress::NoUrl {
            text: text.to_owned(),
            detail: error.to_string(),
            example,
        })?;
        let parsed = match url.scheme() {
            "tcp" => TcpAddress::parse(&url, zone).map(Self::Tcp),
            "udp" => UdpAddress::parse(&url, zone).map(Self::Udp),
            "serial" => SerialAddress::parse(&url).map(Self::Serial),
            "can" => CanAddress::parse(&url).map(Self::Can),
            scheme => {
                return Err(InvalidAddress::UnknownScheme { text: text.to_owned(), scheme: scheme.to_owned() });
            }
        };
        let parsed = if url.fragment().is_some() { Err("a fragment (#) is not supported".to_owned()) } else { parsed };
        parsed.map_err(|detail| InvalidAddress::Part { text: text.to_owned(), detail, example })
    }
}

/// Takes the zone of an IPv6 address out of a URL, since the URL's parser knows none: `[fe80::1%25eth0]` (RFC 6874), or
/// `[fe80::1%eth0]`, as other programs show it.
fn take_zone(text: &str) -> (Cow<'_, str>, Option<&str>) {
    let Some((scheme, rest)) = text.split_once("://[") else { return (text.into(), None) };
    let Some((address, after)) = rest.split_once(']') else { return (text.into(), None) };
    let Some((address, zone)) = address.split_once('%') else { return (text.into(), None) };
    let zone = zone.strip_prefix("25").filter(|zone| !zone.is_empty()).unwrap_or(zone);
    (format!("{scheme}://[{address}]{after}").into(), Some(zone))
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(TcpAddress { host, port }) => write!(f, "tcp://{}:{port}", InUrl(host)),
            Self::Udp(UdpAddress { host, port, local_port, .. }) => {
                write!(f, "udp://{}:{port}?local_port={local_port}", InUrl(host))
            }
            Self::Serial(address) => address.fmt(f),
            Self::Can(address) => address.fmt(f),
        }
    }
}

/// A host in URL form, with brackets around an IPv6 address.
struct InUrl<'a>(&'a str);

impl fmt::Display for InUrl<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0.split_once('%') {
            Some((address, zone)) => write!(f, "[{address}%25{zone}]"),
            None if self.0.contains(':') => write!(f, "[{}]", self.0),
            None => f.write_str(self.0),
        }
    }
}

impl Address {
    /// Properties of the transport.
    #[must_use]
    pub const fn properties(&self) -> LinkProperties {
        match self {
            Self::Tcp(_) => tcp::PROPERTIES,
            Self::Udp(_) => udp::PROPERTIES,
            Self::Serial(address) => address.properties(),
            Self::Can(address) => address.properties(),
        }
    }

    /// Whether the two devices share the capacity of one line: a CAN bus.
    #[must_use]
    pub fn shares_line_with(&self, other: &Self) -> bool {
        matches!((self, other), (Self::Can(one), Self::Can(other)) if one.interface == other.interface)
    }

    /// Reason and remedy if the two addresses cannot be used at the same time.
    #[must_use]
    pub fn conflict_with(&self, other: &Self) -> Option<String> {
        let is_one_device = match (self, other) {
            (Self::Udp(one), Self::Udp(other)) if one.local_port == other.local_port => {
                let port = one.local_port;
                let remedy = "use a separate local_port for each, and set the same port on the device";
                return Some(format!("both listen on UDP port {port}: {remedy}"));
            }
            (Self::Can(one), Self::Can(other)) => return one.conflict_with(other),
            (Self::Tcp(one), Self::Tcp(other)) => one == other,
            (Self::Udp(one), Self::Udp(other)) => (&one.host, one.port) == (&other.host, other.port),
            (Self::Serial(one), Self::Serial(other)) => one.path == other.path,
            _ => false,
        };
        let remedy = "use separate addresses, or remove one";
        is_one_device.then(|| format!("both are at {self}, but a device accepts only one client: {remedy}"))
    }

    /// Opens a pipe. Only TCP contacts the device; other transports are ready once the local port is open.
    ///
    /// # Errors
    /// The operating system's error with a remedy, or a timeout after [`super::CONNECT_WITHIN`].
    pub async fn connect(&self) -> io::Result<Pipe> {
        let deadline = Instant::now() + CONNECT_WITHIN;
        let resolved = self.resolve().await?;
        self.connect_to(&resolved, deadline).await
    }

    /// Returns the addresses of the device's host; none for a serial port and CAN.
    ///
    /// # Errors
    /// The host is unknown, or was not resolved within [`CONNECT_WITHIN`].
    pub(super) async fn resolve(&self) -> io::Result<Vec<SocketAddr>> {
        match self {
            Self::Tcp(TcpAddress { host, port }) | Self::Udp(UdpAddress { host, port, .. }) => {
                host::resolve(host, *port, CONNECT_WITHIN).await
            }
            Self::Serial(_) | Self::Can(_) => Ok(Vec::new()),
        }
    }

    /// Opens a pipe to a host with these addresses.
    pub(super) async fn connect_to(&self, resolved: &[SocketAddr], deadline: Instant) -> io::Result<Pipe> {
        match self {
            Self::Tcp(_) => tcp::connect(resolved, deadline).await,
            Self::Udp(address) => address.connect(resolved).await,
            Self::Serial(address) => address.connect().await,
            Self::Can(address) => address.connect(),
        }
    }
}

#[cfg(test)]
#[path = "address_tests.rs"]
mod tests;
