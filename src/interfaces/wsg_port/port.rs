//! One gripper's ports: rules and admission of clients.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use ipnet::IpNet;
use tokio_util::sync::CancellationToken;

use crate::access::{Access, Identity};
use crate::gripper::Handle;
use crate::gripper::model::{Client, Door};
use crate::interfaces::admission::{Admission, Bounds, ConnectionPermit};
use crate::interfaces::metrics::WsgPortMetrics;
use crate::interfaces::sockets;
use crate::operations::audit::Audit;

/// Maximum number of clients of one port. Only one of them moves the gripper, so there are seldom more than a few.
const MAX_CLIENTS: usize = 128;

/// Slots for clients that have sent nothing yet, and for evicted clients, which end within milliseconds. A new client's
/// FAST STOP must not wait for them.
const OTHER_CLIENTS: usize = 128;

/// Maximum number of descriptors for one port's TCP clients.
pub const MAX_DESCRIPTORS: usize = MAX_CLIENTS + OTHER_CLIENTS;
/// Minimum number of descriptors for one port's TCP clients.
pub const MIN_DESCRIPTORS: usize = 4;

/// Silence after which a client's lease is lost: no TCP acknowledgements, or no datagrams unless configured otherwise.
pub const LOST_AFTER: Duration = sockets::LOST_AFTER;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rules {
    /// Whether the checksums of requests are checked.
    pub checksum_evaluation: bool,
    /// Whether every client may acknowledge every FAST STOP.
    pub acknowledge_any: bool,
    /// Networks whose clients may connect; all if empty.
    pub allow: Vec<IpNet>,
}

#[derive(Debug)]
pub struct Port {
    pub(super) gripper: Handle,
    pub(super) rules: Rules,
    /// Maximum number of descriptors for TCP clients.
    descriptors: usize,
    pub(super) audit: Arc<Audit>,
    access: Arc<Access>,
    pub(super) metrics: WsgPortMetrics,
}

impl Port {
    /// Returns the port of this gripper, whose TCP clients can use this many descriptors.
    #[must_use]
    pub fn new(
        gripper: Handle,
        rules: Rules,
        descriptors: usize,
        (audit, access, metrics): (Arc<Audit>, Arc<Access>, WsgPortMetrics),
    ) -> Arc<Self> {
        let descriptors = descriptors.clamp(MIN_DESCRIPTORS, MAX_DESCRIPTORS);
        Arc::new(Self { gripper, rules, descriptors, audit, access, metrics })
    }

    pub(super) fn admission(&self) -> Arc<Admission> {
        Admission::new(Bounds::alike(self.descriptors))
    }

    /// Admits a client. If all slots are taken, the client that has been silent longest gives way, unless it holds the
    /// lease.
    pub(super) fn admit(admission: &Arc<Admission>, peer: SocketAddr) -> Arc<ConnectionPermit> {
        // Clients have their own shutdown signal.
        Arc::new(admission.admit(peer.ip(), &CancellationToken::new()))
    }

    /// Whether a client may connect: from an allowed network, or as a known client. Without a list of networks, a gateway
    /// that needs credentials accepts known clients and its own host; others accept every client.
    pub(super) fn allows(&self, peer: IpAddr) -> bool {
        let peer = peer.to_canonical();
        let is_open = || self.rules.allow.is_empty() && (peer.is_loopback() || !self.access.is_guarded());
        let is_allowed = || self.rules.allow.iter().any(|net| net.contains(&peer));
        is_open() || is_allowed() || self.identity(peer).is_some()
    }

    /// The identity of a client that the configuration knows by its address.
    pub(super) fn identity(&self, peer: IpAddr) -> Option<Identity> {
        self.access.of_address(&peer.into())
    }

    /// Returns a client with its configured name, or else identified by its IP address. A restarted driver is the same
    /// client, although its port differs.
    pub(super) fn client(&self, peer: SocketAddr) -> Client {
        let name = self.identity(peer.ip()).and_then(|identity| identity.name);
        let by_address = || format!("wsg:{}", peer.ip().to_canonical());
        Client::new(name.map_or_else(by_address, |name| name.to_string()), Door::Wsg)
    }
}
