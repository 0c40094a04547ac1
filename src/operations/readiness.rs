//! Readiness of the gateway: whether its grippers, its journal and its network work.

use serde::Serialize;
use utoipa::ToSchema;

use super::gateway::Gateway;
use crate::gripper::Recorder as _;
use crate::model::{Link, State};

/// Readiness of the gateway.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gateway": "wsg", "version": "0.2.0", "ready": false, "journal_cause": null, "journal_damage": null,
    "journal_restored": null, "zenoh_cause": null,
    "not_ready": ["left: reconnecting: connection refused"], "warnings": []
}))]
pub struct Readiness {
    /// The gateway's name.
    #[schema(max_length = 32)]
    gateway: String,
    /// Version of the gateway.
    version: &'static str,
    /// Whether every gripper is connected or released, the journal is writable, undamaged and not
    /// a restored copy, and Zenoh is connected as
    /// configured.
    pub ready: bool,
    /// Why the journal can't be written; null while it can.
    #[schema(required)]
    journal_cause: Option<String>,
    /// Damage to earlier records of the journal, and the remedy; null if none was found. New records are still written,
    /// and motions continue.
    #[schema(required)]
    journal_damage: Option<String>,
    /// How the journal differs from that of the last run, until the alarm `journal_restored` is acknowledged; null if it
    /// continues that one. Until then, for at most 10 minutes, unknown request ids are refused.
    #[schema(required)]
    journal_restored: Option<String>,
    /// Why Zenoh is not connected as configured, or why motions over Zenoh are refused; null if all is well or Zenoh is
    /// off.
    #[schema(required)]
    zenoh_cause: Option<String>,
    /// Grippers that are neither connected nor released: name, link state and cause.
    not_ready: Vec<String>,
    /// Settings that are risky on a network, each with its meaning. They do not make the gateway unready.
    warnings: Vec<String>,
}

/// Meaning of `insecure_http` on a network.
pub const EXPOSED: &str = "connections are not encrypted (insecure_http): anyone on the network can read the tokens";

impl Readiness {
    pub fn of(own: &Gateway) -> Self {
        let journal = own.journal.health().borrow().clone();
        let journal_cause = journal.failure;
        let journal_damage = journal.damage;
        let journal_restored = journal.restored;
        let not_ready: Vec<_> =
            own.grippers.all().iter().filter_map(|gripper| why_not_ready(&gripper.state())).collect();
        let zenoh_cause = own.peers.cause().borrow().clone().or_else(|| own.peers.why_no_motions());
        let ready = journal_restored.is_none()
            && journal_cause.is_none()
            && journal_damage.is_none()
            && zenoh_cause.is_none()
            && not_ready.is_empty();
        let gateway = own.name.to_string();
        let version = env!("CARGO_PKG_VERSION");
        let warnings = own.access.is_exposed().then(|| EXPOSED.to_owned()).into_iter().collect();
        Self {
            gateway,
            version,
            ready,
            journal_cause,
            journal_damage,
            journal_restored,
            zenoh_cause,
            not_ready,
            warnings,
        }
    }
}

/// Reason that a gripper is not ready. A gripper that a client has released on purpose counts as ready.
fn why_not_ready(state: &State) -> Option<String> {
    let cause = state.link_cause.as_ref().map(|cause| format!(": {cause}")).unwrap_or_default();
    let is_ready = matches!(state.link, Link::Connected | Link::Released);
    (!is_ready).then(|| format!("{}: {}{cause}", state.gripper, state.link))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn released_gripper_is_ready() {
        for (link, expected) in [
            (Link::Connecting, Some("left: connecting")),
            (Link::Connected, None),
            (Link::Unresponsive, Some("left: unresponsive")),
            (Link::Reconnecting, Some("left: reconnecting")),
            (Link::Released, None),
        ] {
            let state = State { link, ..State::unknown("left".parse().unwrap()) };
            assert_eq!(why_not_ready(&state).as_deref(), expected);
        }
    }
}
