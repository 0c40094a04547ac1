//! One gripper's ports: rules and admission of clients.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use ipnet::IpNet;
use serde::Deserialize;
use tokio_util::sync::CancellationToken;

use crate::access::Access;
use crate::connections::admission::{Admission, Bounds, ConnectionPermit};
use crate::connections::metrics::WsgPortMetrics;
use crate::connections::networks::networks;
use crate::connections::peers::KnownPeers;
use crate::connections::sockets;
use crate::gripper::Handle;
use crate::model::{Client, Door};
use crate::operations::calls::audit::Audit;
use crate::settings::{FileSection, SettingValue, flag, parsed, plain, settings};

/// Silence after which a client's lease is lost: no TCP acknowledgements, or no datagrams unless configured otherwise.
pub const LOST_AFTER: Duration = sockets::LOST_AFTER;

settings! {
    /// Rules of the WSG ports of a gripper.
    pub struct Rules {
        /// Addresses that can connect to the WSG port, such as `192.168.1.7` or `192.168.1.0/24`.
        // If empty: known clients and loopback, or every client if the gateway needs no credentials (see
        // `KnownPeers::allows`).
        pub allow: Vec<IpNet> = "wsg_port_allow", networks(
            "all addresses; with credentials, [loopback and known clients](access.md#clients-that-cannot-send-a-header)",
            "[\"192.168.1.0/24\"]",
        ), Reload;
        /// FAST STOPs that a driver can acknowledge: `own` or `any`.
        pub acknowledge: AcknowledgePolicy = "wsg_port_acknowledge",
            plain(AcknowledgePolicy::Own, "\"own\"", "`\"own\"`, `\"any\"`"), Reload;
        /// Whether checksums are checked. With `false`, the gateway accepts any checksum from WSG port clients.
        pub checksum_evaluation: bool = "wsg_port_checksum_evaluation", flag(true), Reload;
        /// Limits of the gripper that drivers may change: `open` or `fixed`.
        pub limits: LimitsPolicy = "wsg_port_limits", plain(LimitsPolicy::Open, "\"open\"", "`\"open\"`, `\"fixed\"`")
            .shown("`\"open\"`", "\"fixed\""), Reload;
        /// Highest force limit in N that WSG port clients may set while `wsg_port_limits` is `"fixed"`.
        pub max_force_n: Option<f32> = "wsg_port_max_force_n", max_force(), Reload;
        check Rules::check;
    }
}

/// FAST STOPs that a client may acknowledge with 24h.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AcknowledgePolicy {
    /// A FAST STOP that the client has seen, and that the client or the device caused.
    Own,
    /// Any FAST STOP.
    Any,
}

/// Limits of the gripper that clients may change. Existing drivers set the force limit at each start, so by default they
/// may change all of them, like on the gripper itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LimitsPolicy {
    /// All of them.
    Open,
    /// No soft limits, no Overdrive Mode, and no force limit above `max_force_n`. Without that, no force limit.
    Fixed,
}

/// A force, like those on the line.
fn max_force() -> SettingValue<Option<f32>> {
    let default = "none: with `\"fixed\"`, every Set Force Limit (32h) is refused";
    parsed(None, "", "above 0", |force_n: f64| parse_max_force(force_n).map(Some)).shown(default, "40")
}

fn parse_max_force(force_n: f64) -> Result<f32, String> {
    match force_n as f32 {
        force_n if force_n.is_finite() && force_n > 0.0 => Ok(force_n),
        force_n => Err(format!("is {force_n}; it must be a force in N above 0")),
    }
}

impl Rules {
    fn check(&self, section: &mut FileSection<'_>) {
        if self.max_force_n.is_some() && self.limits == LimitsPolicy::Open {
            let key = "wsg_port_max_force_n";
            let remedy = "add wsg_port_limits = \"fixed\"";
            section.fail(key, format_args!("{key} has no effect while clients may change all limits: {remedy}"));
        }
    }
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
