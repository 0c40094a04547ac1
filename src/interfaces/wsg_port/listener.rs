//! Addresses and listeners of the WSG port.

use std::fmt;
use std::io;
use std::net::{SocketAddr, TcpListener, UdpSocket};
use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use super::port::Port;
use super::udp::Datagrams;
use super::{tcp, udp};

/// Address of a gripper's port.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Address {
    /// Connections.
    Tcp(SocketAddr),
    /// Datagrams.
    Udp(SocketAddr, Datagrams),
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => write!(f, "tcp://{address}"),
            Self::Udp(address, _) => write!(f, "udp://{address}"),
        }
    }
}

/// A port that clients can reach, and that is not served yet: by whichever runtime will do so.
#[derive(Debug)]
pub enum Listener {
    /// Connections.
    Tcp(TcpListener),
    /// Datagrams.
    Udp(UdpSocket, Datagrams),
}

impl Listener {
    /// At this address.
    ///
    /// # Errors
    /// As the operating system says.
    pub fn bind(address: Address) -> io::Result<Self> {
        Ok(match address {
            Address::Tcp(address) => {
                let listener = TcpListener::bind(address)?;
                listener.set_nonblocking(true)?;
                Self::Tcp(listener)
            }
            Address::Udp(address, datagrams) => {
                let socket = UdpSocket::bind(address)?;
                socket.set_nonblocking(true)?;
                Self::Udp(socket, datagrams)
            }
        })
    }

    /// URL of the listener.
    ///
    /// # Errors
    /// As the operating system says.
    pub fn url(&self) -> io::Result<String> {
        Ok(match self {
            Self::Tcp(listener) => format!("tcp://{}", listener.local_addr()?),
            Self::Udp(socket, _) => format!("udp://{}", socket.local_addr()?),
        })
    }
}

/// Serves clients: new ones until `draining`, and all until `closing`.
///
/// # Errors
/// As the operating system says.
pub async fn serve(
    port: Arc<Port>,
    listener: Listener,
    draining: CancellationToken,
    closing: CancellationToken,
) -> io::Result<()> {
    match listener {
        Listener::Tcp(listener) => {
            let listener = tokio::net::TcpListener::from_std(listener)?;
            tcp::serve(port, listener, draining, closing).await;
        }
        Listener::Udp(socket, datagrams) => {
            let socket = tokio::net::UdpSocket::from_std(socket)?;
            udp::serve(port, socket, datagrams, draining, closing).await;
        }
    }
    Ok(())
}
