//! One gripper's ports: rules and admission of clients.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use ipnet::IpNet;
use tokio_util::sync::CancellationToken;

use crate::access::Access;
use crate::gripper::Handle;
use crate::gripper::model::{Client, Door};
use crate::interfaces::admission::{Admission, Bounds, ConnectionPermit};
use crate::interfaces::metrics::WsgPortMetrics;
use crate::interfaces::peers::KnownPeers;
use crate::interfaces::sockets;
use crate::operations::audit::Audit;

/// Silence after which a client's lease is lost: no TCP acknowledgements, or no datagrams unless configured otherwise.
pub const LOST_AFTER: Duration = sockets::LOST_AFTER;

#[derive(Debug, Clone, PartialEq)]
pub struct Rules {
    /// Whether the checksums of requests are checked.
    pub checksum_evaluation: bool,
    /// Whether every client may acknowledge every FAST STOP.
    pub acknowledge_any: bool,
    /// Networks that may connect. If empty: known clients and loopback, or every client if the gateway needs no
    /// credentials (see [`KnownPeers::allows`]).
    pub allow: Vec<IpNet>,
    /// Limits of the gripper that clients may change.
    pub limits: AllowedLimits,
}

/// Limits of the gripper that clients may change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AllowedLimits {
    All,
    /// A force limit up to this value. No soft limits, and no Overdrive Mode.
    ForceUpTo(f32),
    None,
}

#[derive(Debug)]
pub struct Port {
    pub(super) gripper: Handle,
    pub(super) rules: Rules,
    /// Maximum number of descriptors for TCP clients.
    descriptors: usize,
    pub(super) audit: Arc<Audit>,
    pub(super) peers: KnownPeers,
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
        let descriptors = descriptors.clamp(Bounds::MIN_ALIKE, Bounds::MAX_ALIKE);
        let peers = KnownPeers::new(rules.allow.clone(), access);
        Arc::new(Self { gripper, rules, descriptors, audit, peers, metrics })
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

    pub(super) fn client(&self, peer: IpAddr) -> Client {
        self.peers.client(peer, "wsg", Door::Wsg)
    }
}
