//! Clients that speak another protocol than the port. Web pages are among them: a page can make a browser send HTTP to any
//! port of its machine, and the body can contain any bytes.

use std::fmt::Display;

use prometheus::{IntCounterVec, Opts, Registry, Result};

/// Protocol that a client speaks, judged by its first bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ForeignProtocol {
    Http,
    Tls,
    Ssh,
    Other,
}

/// First words of HTTP requests. A WebSocket begins with one, too.
const HTTP_METHODS: [&[u8]; 9] =
    [b"GET ", b"POST ", b"PUT ", b"HEAD ", b"OPTIONS ", b"DELETE ", b"PATCH ", b"CONNECT ", b"PRI "];

/// First byte of a TLS handshake (RFC 8446, 5.1), and the major version behind it.
const TLS: [u8; 2] = [0x16, 0x03];

impl ForeignProtocol {
    #[must_use]
    pub fn of(first: &[u8]) -> Self {
        if HTTP_METHODS.iter().any(|method| first.starts_with(method)) {
            Self::Http
        } else if first.starts_with(&TLS) {
            Self::Tls
        } else if first.starts_with(b"SSH-") {
            Self::Ssh
        } else {
            Self::Other
        }
    }

    const fn label(self) -> &'static str {
        match self {
            Self::Http => "http",
            Self::Tls => "tls",
            Self::Ssh => "ssh",
            Self::Other => "other",
        }
    }

    const fn remedy(self) -> &'static str {
        match self {
            Self::Http | Self::Tls => {
                "send HTTP requests to the address of --listen; if no program of yours sent this, look for a web page \
                 or a port scanner on that machine"
            }
            Self::Ssh | Self::Other => {
                "connect a client that speaks the protocol of this port; if no program of yours connected, look for a \
                 port scanner on that machine"
            }
        }
    }
}

/// Counter of clients that were refused because of their first bytes, by protocol.
#[derive(Debug, Clone)]
pub struct ForeignClients {
    /// The protocol that the port expects, for the log.
    expected: &'static str,
    refused: IntCounterVec,
}

impl ForeignClients {
    pub fn register(registry: &Registry, door: &str, expected: &'static str) -> Result<Self> {
        let help = "Connections closed and datagrams ignored because their bytes belong to another protocol.";
        let refused = Opts::new("wsg_foreign_clients_total", help).const_label("door", door);
        let refused = IntCounterVec::new(refused, &["protocol"])?;
        registry.register(Box::new(refused.clone()))?;
        // The commonest protocol starts at 0, so that the first client is an increase.
        refused.with_label_values(&[ForeignProtocol::Http.label()]);
        Ok(Self { expected, refused })
    }

    /// Counts and logs a connection that is closed because of these bytes.
    pub fn closed(&self, peer: impl Display, first: &[u8]) {
        let protocol = self.count(first);
        tracing::warn!(%peer, expected = self.expected, found = protocol.label(), remedy = protocol.remedy(),
            "connection closed: its bytes belong to another protocol");
    }

    /// Counts a datagram that does not begin with a frame, and logs the first one of a host.
    pub fn ignored(&self, peer: impl Display, datagram: &[u8], is_first: bool) {
        let protocol = self.count(datagram);
        if !is_first {
            return;
        }
        tracing::warn!(%peer, expected = self.expected, found = protocol.label(), remedy = protocol.remedy(),
            "datagrams ignored: they do not begin with a frame");
    }

    fn count(&self, first: &[u8]) -> ForeignProtocol {
        let protocol = ForeignProtocol::of(first);
        self.refused.with_label_values(&[protocol.label()]).inc();
        protocol
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn protocols_are_known_by_their_first_bytes() {
        for (first, protocol) in [
            (&b"POST /x HTTP/1.1\r\n"[..], ForeignProtocol::Http),
            (b"GET /ws HTTP/1.1\r\n", ForeignProtocol::Http),
            (&[0x16, 0x03, 0x01, 0x02], ForeignProtocol::Tls),
            (b"SSH-2.0-OpenSSH", ForeignProtocol::Ssh),
            (b"G", ForeignProtocol::Other),
            (&[0x00, 0x01], ForeignProtocol::Other),
        ] {
            assert_eq!(ForeignProtocol::of(first), protocol, "{first:x?}");
        }
    }
}
