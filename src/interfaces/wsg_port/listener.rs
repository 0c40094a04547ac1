//! Addresses and listeners of the WSG port.

use std::fmt;
use std::io;
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use super::port::Port;
use super::udp::Datagrams;
use super::{tcp, udp};
use crate::connections::accept;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ListenAddress {
    Tcp(SocketAddr),
    Udp(SocketAddr, Datagrams),
}

impl ListenAddress {
    /// Whether both stand for one socket, whatever its settings.
    #[must_use]
    pub fn is_same_socket(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Tcp(one), Self::Tcp(other)) | (Self::Udp(one, _), Self::Udp(other, _)) => one == other,
            _ => false,
        }
    }

    /// Address of the socket.
    #[must_use]
    pub fn socket(&self) -> SocketAddr {
        let (Self::Tcp(address) | Self::Udp(address, _)) = self;
        *address
    }

    /// Whether the system chooses the port.
    #[must_use]
    pub fn is_any_port(&self) -> bool {
        self.socket().port() == 0
    }
}

impl fmt::Display for ListenAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => write!(f, "tcp://{address}"),
            Self::Udp(address, _) => write!(f, "udp://{address}"),
        }
    }
}

/// A bound port that is not served yet, and not registered with a runtime.
#[derive(Debug)]
pub enum Listener {
    Tcp(TcpListener),
    Udp(UdpSocket, Datagrams),
}

impl Listener {
    pub fn bind(address: ListenAddress) -> io::Result<Self> {
        Ok(match address {
            ListenAddress::Tcp(address) => Self::Tcp(accept::listen(address)?),
            ListenAddress::Udp(address, datagrams) => {
                let socket = UdpSocket::bind(address)?;
                socket.set_nonblocking(true)?;
                Self::Udp(socket, datagrams)
            }
        })
    }

    /// Returns the same socket, to be served with the settings of this address.
    #[must_use]
    pub fn with_settings_of(self, address: ListenAddress) -> Self {
        match (self, address) {
            (Self::Udp(socket, _), ListenAddress::Udp(_, datagrams)) => Self::Udp(socket, datagrams),
            (same, _) => same,
        }
    }

    pub fn url(&self) -> io::Result<String> {
        Ok(match self {
            Self::Tcp(listener) => format!("tcp://{}", listener.local_addr()?),
            Self::Udp(socket, _) => format!("udp://{}", socket.local_addr()?),
        })
    }
}

/// Serves clients: accepts new ones until `draining`, and serves all until `closing`. A UDP port returns
/// its socket. A TCP port returns it only if `closing` is cancelled before `draining`; otherwise it refuses new clients
/// while it serves the last ones.
pub async fn serve(
    port: Arc<Port>,
    listener: Listener,
    draining: CancellationToken,
    closing: CancellationToken,
) -> io::Result<Option<Listener>> {
    match listener {
        Listener::Tcp(listener) => {
            let listener = tokio::net::TcpListener::from_std(listener)?;
            let listener = tcp::serve(port, listener, draining, closing).await;
            listener.map(|listener| listener.into_std().map(Listener::Tcp)).transpose()
        }
        Listener::Udp(socket, datagrams) => {
            let socket = tokio::net::UdpSocket::from_std(socket)?;
            let socket = udp::serve(port, socket, datagrams, draining, closing).await;
            socket.map(|socket| socket.into_std().map(|socket| Listener::Udp(socket, datagrams))).transpose()
        }
    }
}
