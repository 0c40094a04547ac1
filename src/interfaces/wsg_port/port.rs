//! One gripper's ports: their rules, and the admission of their clients.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use ipnet::IpNet;
use tokio_util::sync::CancellationToken;

use crate::gripper::Handle;
use crate::gripper::model::{Client, Door};
use crate::interfaces::admission::{Admission, Bounds, ConnectionPermit};
use crate::interfaces::sockets;
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
pub const LOST_AFTER: Duration = sockets::LOST_AFTER;

/// Rights of a port's clients.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rules {
    /// Whether checksums of requests count.
    pub checksum_evaluation: bool,
    /// Whether everyone may acknowledge every FAST STOP.
    pub acknowledge_any: bool,
    /// Networks of the clients that may connect; all where the list is empty.
    pub allow: Vec<IpNet>,
}

/// One gripper's ports.
#[derive(Debug)]
pub struct Port {
    pub(super) gripper: Handle,
    pub(super) rules: Arc<Rules>,
    /// Descriptors of its TCP clients.
    descriptors: usize,
    pub(super) audit: Arc<Audit>,
}

impl Port {
    /// The port of this gripper, whose TCP clients may take so many descriptors.
    #[must_use]
    pub fn new(gripper: Handle, rules: Rules, descriptors: usize, audit: Arc<Audit>) -> Arc<Self> {
        let descriptors = descriptors.clamp(MIN_DESCRIPTORS, MAX_DESCRIPTORS);
        Arc::new(Self { gripper, rules: Arc::new(rules), descriptors, audit })
    }

    /// Admission of its clients.
    pub(super) fn admission(&self) -> Arc<Admission> {
        Admission::new(Bounds::alike(self.descriptors))
    }

    /// Admits a client. Where there are as many as may be, the client that was silent for longest gives way, unless it
    /// holds the lease.
    pub(super) fn admit(admission: &Arc<Admission>, peer: SocketAddr) -> Arc<ConnectionPermit> {
        // Clients learn of the gateway's end in another way.
        Arc::new(admission.admit(peer.ip(), &CancellationToken::new()))
    }

    pub(super) fn allows(&self, peer: IpAddr) -> bool {
        let peer = peer.to_canonical();
        self.rules.allow.is_empty() || self.rules.allow.iter().any(|net| net.contains(&peer))
    }

    /// Before there are credentials, a client is its address: a driver that was restarted is the same again, though
    /// its port is another.
    pub(super) fn client(peer: SocketAddr) -> Client {
        Client { subject: format!("wsg:{}", peer.ip().to_canonical()).into(), door: Door::Wsg }
    }
}
