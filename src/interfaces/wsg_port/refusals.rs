//! Refused requests of one client. Each is counted in the metrics and recorded in the journal. The log has one warning
//! per remedy.

use std::collections::BTreeSet;

use super::input::Unusable;
use super::port::Port;
use crate::gripper::{Conflict, Invalid, Rejection};
use crate::model::Client;
use crate::operations::calls::audit::RefusedRequest;
use crate::wsg::{Status, id};

/// A request that the virtual device refused by itself.
#[derive(Debug, PartialEq)]
pub(super) struct Refused {
    pub id: u8,
    pub status: Status,
    pub cause: Cause,
}

/// Cause of a [`Refused`] request.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub(super) enum Cause {
    #[error(transparent)]
    Unusable(#[from] Unusable),
    #[error("too many requests of this client are waiting")]
    Overrun,
    #[error("the client has announced its disconnect (07h)")]
    Announced,
    #[error(
        "24h may not clear this FAST STOP: another client or an unknown cause triggered it, or another client holds \
         the lease"
    )]
    Acknowledge,
    #[error("the client's role or grippers do not allow the request")]
    Forbidden,
    #[error("clients of the WSG port may not change this limit (wsg_port_limits)")]
    Limits,
}

impl Cause {
    const fn remedy(self, id: u8) -> &'static str {
        match self {
            Self::Unusable(Unusable::Checksum) => {
                "check the line; for clients without valid checksums, set wsg_port_checksum_evaluation = false"
            }
            Self::Unusable(_) if id == id::ACKNOWLEDGE_FAST_STOP => {
                "send 24h with its key, the three bytes \"ack\" (61 63 6B)"
            }
            Self::Unusable(_) => "see the command's parameters in the gripper's manual",
            Self::Overrun => "wait for replies before sending further requests",
            Self::Announced => "connect again",
            Self::Acknowledge => {
                "acknowledge the FAST STOP over HTTP or on the dashboard, or set wsg_port_acknowledge = \"any\""
            }
            Self::Limits => {
                "change the limit over HTTP or on the dashboard, or raise wsg_port_max_force_n, or set wsg_port_limits = \
                 \"open\""
            }
            Self::Forbidden => "change the client's role, or add this gripper to its [[clients]] section",
        }
    }
}

/// Setting or request that remedies a rejection.
fn remedy(id: u8, rejection: &Rejection) -> &'static str {
    let is_script = id::describe(id).is_none();
    match rejection {
        Rejection::Invalid(Invalid::OutOfRange { .. }) if is_script => {
            "send a nearer or slower target, or change stream_max_step_mm and stream_max_speed_mm_s"
        }
        Rejection::Invalid(Invalid::OutOfRange { .. }) => "change the target, or the soft limits (34h, 36h)",
        Rejection::Invalid(Invalid::Malformed { .. }) => "see the command's parameters in the gripper's manual",
        Rejection::Conflict(conflict) => match conflict {
            Conflict::FastStop { .. }
            | Conflict::StaleFastStop { .. }
            | Conflict::FastStopUnconfirmed { .. }
            | Conflict::FastStopPersists { .. }
            | Conflict::Acknowledging { .. } => {
                "remove the cause of the FAST STOP, and acknowledge it with 24h, over HTTP or on the dashboard"
            }
            Conflict::LeaseHeld { .. }
            | Conflict::Reserved { .. }
            | Conflict::LeaseBound { .. }
            | Conflict::LeaseTokenMissing { .. }
            | Conflict::LeaseRequested { .. }
            | Conflict::StaleLease { .. } => {
                if is_script {
                    "list the id in read_ids if its script only reads; otherwise let the holder release the lease"
                } else {
                    "let the holder release the lease, or take it over HTTP with \"force\": true and release it"
                }
            }
            Conflict::NotReferenced => "home the gripper first (20h)",
            Conflict::SettingsLost { .. } => "set the lost settings again (30h, 32h, 34h)",
            Conflict::AlreadyRunning { .. }
            | Conflict::FingersMove
            | Conflict::RequestIdReused
            | Conflict::UnknownPast
            | Conflict::Steering { .. }
            | Conflict::NoServo { .. }
            | Conflict::StaleTarget { .. } => "wait for the end of the motion, or send a Stop (22h) first",
        },
        Rejection::Device(_) => "look up the gripper's status in its manual",
        Rejection::Failure(_) => "remove the cause, and repeat the request",
    }
}

/// Remedies that were already logged for one client.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    logged: BTreeSet<&'static str>,
}

impl Refusals {
    pub(super) fn record(&mut self, port: &Port, client: &Client, refused: &Refused) {
        let Refused { id, status, cause } = *refused;
        self.note(port, client, (id, status), cause.to_string(), cause.remedy(id));
    }

    pub(super) fn record_rejection(&mut self, port: &Port, client: &Client, id: u8, status: Status, cause: &Rejection) {
        self.note(port, client, (id, status), cause.to_string(), remedy(id, cause));
    }

    fn note(&mut self, port: &Port, client: &Client, (id, status): (u8, Status), cause: String, remedy: &'static str) {
        let command = id::name(id).map_or_else(|| format!("{id:02X}h"), ToOwned::to_owned);
        let gripper = port.gripper.name();
        let code = status.to_string();
        port.metrics.refused(gripper.as_str(), status.name());
        if self.logged.insert(remedy) {
            tracing::warn!(%gripper, client = %client.subject, command, code, cause, remedy, "request refused");
        }
        port.audit
            .take(RefusedRequest { gripper: Some(gripper.clone()), client: client.clone(), command, code }, cause);
    }
}
