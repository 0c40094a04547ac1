//! The WSG port: a gripper that speaks the manual's own protocol, to several clients at a time, each with a virtual
//! device of its own.
//!
//! `device` is that device, a pure machine, with `input` (requests in bytes) and `status` (what was not done, as a
//! status); `client` is the I/O around it, and `tcp` and `udp` bring clients in.
//!
//! A motion takes the lease where it is free, and the client keeps it until it announces its end (07h), or is lost. No
//! client gets a frame that it has not asked for.

mod client;
mod device;
mod input;
mod status;
mod tcp;
mod udp;

use std::fmt;
use std::io;
use std::net::{IpAddr, SocketAddr, TcpListener, UdpSocket};
use std::sync::Arc;
use std::time::Duration;

use ipnet::IpNet;
use tokio_util::sync::CancellationToken;

use super::admission::{Admission, Bounds, ConnectionPermit};
use crate::gripper::Handle;
use crate::gripper::model::{Client, Door};
use crate::operations::audit::Audit;

/// Clients of one port at a time. One of them moves the gripper, so there are seldom more than a few.
const MAX_CLIENTS: usize = 128;

/// Clients that have said nothing yet, and as many evicted ones that are still ending, which takes milliseconds: a new
/// client's FAST STOP must not wait for them.
const OTHER_CLIENTS: usize = 128;

/// Descriptors of one port's TCP clients, at the most and at the least.
pub const MAX_DESCRIPTORS: usize = MAX_CLIENTS + OTHER_CLIENTS;
/// See [`MAX_DESCRIPTORS`].
pub const MIN_DESCRIPTORS: usize = 4;

/// A client that has been silent for so long is lost: one that doesn't acknowledge its TCP segments, or that sends no
/// datagram where nothing else is said.
pub const LOST_AFTER: Duration = super::sockets::LOST_AFTER;

/// Where a gripper is served.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Address {
    /// Connections.
    Tcp(SocketAddr),
    /// Datagrams.
    Udp(SocketAddr, Datagrams),
}

/// How clients that send datagrams are served.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Datagrams {
    /// Answers go to this port, as those of devices do, and otherwise to the sender's.
    pub reply_port: Option<u16>,
    /// How long a client may be silent.
    pub lost_after: Duration,
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => write!(f, "tcp://{address}"),
            Self::Udp(address, _) => write!(f, "udp://{address}"),
        }
    }
}

/// What a port grants its clients.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rules {
    /// Whether checksums of requests count.
    pub checksum_evaluation: bool,
    /// Whether everyone may acknowledge every FAST STOP.
    pub acknowledge_any: bool,
    /// Who may connect; none is everyone.
    pub allow: Vec<IpNet>,
}

/// One gripper's ports.
#[derive(Debug)]
pub struct Port {
    gripper: Handle,
    rules: Arc<Rules>,
    /// Descriptors of its TCP clients.
    descriptors: usize,
    audit: Arc<Audit>,
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

    /// Where clients reach it.
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

impl Port {
    /// The port of this gripper, whose TCP clients may take so many descriptors.
    #[must_use]
    pub fn new(gripper: Handle, rules: Rules, descriptors: usize, audit: Arc<Audit>) -> Arc<Self> {
        let descriptors = descriptors.clamp(MIN_DESCRIPTORS, MAX_DESCRIPTORS);
        Arc::new(Self { gripper, rules: Arc::new(rules), descriptors, audit })
    }

    /// Serves clients: new ones until `draining`, and all until `closing`.
    ///
    /// # Errors
    /// As the operating system says.
    pub async fn serve(
        self: Arc<Self>,
        listener: Listener,
        draining: CancellationToken,
        closing: CancellationToken,
    ) -> io::Result<()> {
        match listener {
            Listener::Tcp(listener) => {
                let listener = tokio::net::TcpListener::from_std(listener)?;
                tcp::serve(self, listener, draining, closing).await;
            }
            Listener::Udp(socket, datagrams) => {
                let socket = tokio::net::UdpSocket::from_std(socket)?;
                udp::serve(self, socket, datagrams, draining, closing).await;
            }
        }
        Ok(())
    }

    /// Admission of its clients.
    fn admission(&self) -> Arc<Admission> {
        Admission::new(Bounds::alike(self.descriptors))
    }

    /// Admits a client. Where there are as many as may be, the client that was silent for longest gives way, unless it
    /// holds the lease.
    fn admit(admission: &Arc<Admission>, peer: SocketAddr) -> Arc<ConnectionPermit> {
        // Clients learn of the gateway's end in another way.
        Arc::new(admission.admit(peer.ip(), &CancellationToken::new()))
    }

    fn allows(&self, peer: IpAddr) -> bool {
        let peer = peer.to_canonical();
        self.rules.allow.is_empty() || self.rules.allow.iter().any(|net| net.contains(&peer))
    }

    /// Before there are credentials, a client is its address: a driver that was restarted is the same again, though
    /// its port is another.
    fn client(peer: SocketAddr) -> Client {
        Client { subject: format!("wsg:{}", peer.ip().to_canonical()).into(), door: Door::Wsg }
    }
}
