//! Where a device is, as a URL: `tcp://192.168.1.20:1000`, `udp://192.168.1.20:1500?local_port=1501`,
//! `serial:///dev/ttyUSB0?baud=115200&stop_bits=1`, `can://can0?tx=0x64&rx=0x65`.

use std::fmt;
use std::io;
use std::str::FromStr;

use url::Url;

use super::can::CanAddress;
use super::serial::SerialAddress;
use super::tcp::{self, TcpAddress};
use super::udp::{self, UdpAddress};
use super::{LinkProperties, Pipe};

/// Where a device is.
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

/// How each transport's URL is written.
const EXAMPLES: [(&str, &str); 4] = [
    ("tcp", "tcp://192.168.1.20:1000"),
    ("udp", "udp://192.168.1.20:1500?local_port=1501"),
    ("serial", "serial:///dev/ttyUSB0?baud=115200&stop_bits=1"),
    ("can", "can://can0?tx=0x64&rx=0x65"),
];

/// Why a text is no address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidAddress {
    /// Not a URL at all.
    #[error("{text:?} is no URL ({detail}): write it as {example}")]
    NoUrl {
        /// What was given.
        text: String,
        /// What is wrong with it.
        detail: String,
        /// A right one.
        example: &'static str,
    },
    /// No transport's scheme.
    #[error("{text:?}: there is no transport {scheme:?}; there are tcp, udp, serial, can")]
    UnknownScheme {
        /// What was given.
        text: String,
        /// Its scheme.
        scheme: String,
    },
    /// A part that this transport doesn't have, or lacks.
    #[error("{text:?}: {detail}; write it as {example}")]
    Part {
        /// What was given.
        text: String,
        /// What is wrong with it.
        detail: String,
        /// A right one.
        example: &'static str,
    },
}

/// How a URL that begins like this one is written.
fn example_for(text: &str) -> &'static str {
    let scheme = text.split(':').next().unwrap_or_default();
    let example = EXAMPLES.iter().find(|(name, _)| *name == scheme).unwrap_or(&EXAMPLES[0]);
    example.1
}

impl FromStr for Address {
    type Err = InvalidAddress;

    fn from_str(text: &str) -> Result<Self, InvalidAddress> {
        let example = example_for(text);
        let url = Url::parse(text).map_err(|error| InvalidAddress::NoUrl {
            text: text.to_owned(),
            detail: error.to_string(),
            example,
        })?;
        let parsed = match url.scheme() {
            "tcp" => TcpAddress::parse(&url).map(Self::Tcp),
            "udp" => UdpAddress::parse(&url).map(Self::Udp),
            "serial" => SerialAddress::parse(&url).map(Self::Serial),
            "can" => CanAddress::parse(&url).map(Self::Can),
            scheme => {
                return Err(InvalidAddress::UnknownScheme { text: text.to_owned(), scheme: scheme.to_owned() });
            }
        };
        let parsed = if url.fragment().is_some() { Err("nothing may stand behind a #".to_owned()) } else { parsed };
        parsed.map_err(|detail| InvalidAddress::Part { text: text.to_owned(), detail, example })
    }
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

/// A host as URLs have it: an IPv6 address in brackets.
struct InUrl<'a>(&'a str);

impl fmt::Display for InUrl<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0.contains(':') { write!(f, "[{}]", self.0) } else { f.write_str(self.0) }
    }
}

impl Address {
    /// What its transport means for the protocol.
    #[must_use]
    pub const fn properties(&self) -> LinkProperties {
        match self {
            Self::Tcp(_) => tcp::PROPERTIES,
            Self::Udp(_) => udp::PROPERTIES,
            Self::Serial(address) => address.properties(),
            Self::Can(address) => address.properties(),
        }
    }

    /// Why devices at these two addresses can't be served together, and what to do about it.
    #[must_use]
    pub fn conflict_with(&self, other: &Self) -> Option<String> {
        let is_one_device = match (self, other) {
            (Self::Udp(one), Self::Udp(other)) if one.local_port == other.local_port => {
                let port = one.local_port;
                let remedy = "give each a local_port of its own, and set the same on the device";
                return Some(format!("both listen on UDP port {port}: {remedy}"));
            }
            (Self::Can(one), Self::Can(other)) => return one.conflict_with(other),
            (Self::Tcp(one), Self::Tcp(other)) => one == other,
            (Self::Udp(one), Self::Udp(other)) => (&one.host, one.port) == (&other.host, other.port),
            (Self::Serial(one), Self::Serial(other)) => one.path == other.path,
            _ => false,
        };
        let remedy = "give each an address of its own, or leave one out";
        is_one_device.then(|| format!("both are at {self}, and a device has one client: {remedy}"))
    }

    /// Connects. Only TCP asks the device; the others are ready once there is something to send by.
    ///
    /// # Errors
    /// As the operating system says, with what to do about it, or that it took longer than
    /// [`super::CONNECT_WITHIN`].
    pub async fn connect(&self) -> io::Result<Pipe> {
        match self {
            Self::Tcp(address) => address.connect().await,
            Self::Udp(address) => address.connect().await,
            Self::Serial(address) => address.connect().await,
            Self::Can(address) => address.connect(),
        }
    }
}

#[cfg(test)]
#[path = "address_tests.rs"]
mod tests;
