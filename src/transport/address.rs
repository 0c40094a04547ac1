//! Where a device is, as a URL: `tcp://192.168.1.20:1000`.

use std::fmt;
use std::io;
use std::str::FromStr;

use url::Url;

use super::tcp::{self, TcpAddress};
use super::{Pipe, Traits};

/// The port that devices listen on (field practice; the manuals name none).
const DEFAULT_TCP_PORT: u16 = 1000;

/// Where a device is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Address {
    /// `tcp://host:port`
    Tcp(TcpAddress),
}

/// Why a text is no address.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidAddress {
    /// Not a URL at all.
    #[error("{text:?} is no URL ({detail}): write it as tcp://192.168.1.20:1000")]
    NoUrl {
        /// What was given.
        text: String,
        /// What is wrong with it.
        detail: String,
    },
    /// A transport that isn't there yet.
    #[error("{text:?}: {scheme} is not supported yet; tcp is")]
    NotYet {
        /// What was given.
        text: String,
        /// Its scheme.
        scheme: String,
    },
    /// No transport's scheme.
    #[error("{text:?}: there is no transport {scheme:?}; there is tcp")]
    UnknownScheme {
        /// What was given.
        text: String,
        /// Its scheme.
        scheme: String,
    },
    /// A part that this transport doesn't have, or lacks.
    #[error("{text:?}: {detail}; write it as tcp://192.168.1.20:1000")]
    Part {
        /// What was given.
        text: String,
        /// What is wrong with it.
        detail: String,
    },
}

impl FromStr for Address {
    type Err = InvalidAddress;

    fn from_str(text: &str) -> Result<Self, InvalidAddress> {
        let no_url =
            |error: url::ParseError| InvalidAddress::NoUrl { text: text.to_owned(), detail: error.to_string() };
        let url = Url::parse(text).map_err(no_url)?;
        match url.scheme() {
            "tcp" => parse_tcp(text, &url).map(Self::Tcp),
            scheme @ ("udp" | "serial" | "can") => {
                Err(InvalidAddress::NotYet { text: text.to_owned(), scheme: scheme.to_owned() })
            }
            scheme => Err(InvalidAddress::UnknownScheme { text: text.to_owned(), scheme: scheme.to_owned() }),
        }
    }
}

fn parse_tcp(text: &str, url: &Url) -> Result<TcpAddress, InvalidAddress> {
    let wrong = |detail: &str| InvalidAddress::Part { text: text.to_owned(), detail: detail.to_owned() };
    let host = url.host_str().filter(|host| !host.is_empty()).ok_or_else(|| wrong("it names no host"))?;
    let port = url.port().unwrap_or(DEFAULT_TCP_PORT);
    if port == 0 {
        return Err(wrong("port 0 cannot be connected to"));
    }
    if !url.username().is_empty() || url.password().is_some() {
        return Err(wrong("a device has no user and no password"));
    }
    if !matches!(url.path(), "" | "/") || url.query().is_some() || url.fragment().is_some() {
        return Err(wrong("tcp takes a host and a port, and nothing behind them"));
    }
    // A URL has an IPv6 address in brackets; a socket address has not.
    let host = host.trim_start_matches('[').trim_end_matches(']').to_owned();
    Ok(TcpAddress { host, port })
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(TcpAddress { host, port }) if host.contains(':') => write!(f, "tcp://[{host}]:{port}"),
            Self::Tcp(TcpAddress { host, port }) => write!(f, "tcp://{host}:{port}"),
        }
    }
}

impl Address {
    /// What its transport means for the protocol.
    #[must_use]
    pub const fn traits(&self) -> Traits {
        match self {
            Self::Tcp(_) => tcp::TRAITS,
        }
    }

    /// Connects.
    ///
    /// # Errors
    /// As the operating system says, or that it took longer than [`super::CONNECT_WITHIN`].
    pub async fn connect(&self) -> io::Result<Pipe> {
        match self {
            Self::Tcp(address) => address.connect().await,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_url_and_back() {
        for (text, written) in [
            ("tcp://192.168.1.20:1000", "tcp://192.168.1.20:1000"),
            ("tcp://gripper.cell7", "tcp://gripper.cell7:1000"),
            ("tcp://[::1]:1234/", "tcp://[::1]:1234"),
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), written);
        }
    }

    #[test]
    fn a_mistake_is_named_with_its_remedy() {
        let message = |text: &str| text.parse::<Address>().unwrap_err().to_string();
        assert!(message("192.168.1.20:1000").contains("tcp://192.168.1.20:1000"));
        assert!(message("udp://host:1500").contains("not supported yet"));
        assert!(message("http://host").contains("no transport"));
        assert!(message("tcp://host:0").contains("port 0"));
        assert!(message("tcp://:1000").contains("tcp://"));
        assert!(message("tcp://host:1000?baud=9600").contains("nothing behind"));
        assert!(message("tcp://host:70000").contains("port"));
    }
}
