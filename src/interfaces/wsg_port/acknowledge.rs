//! Acknowledging a FAST STOP with 24h, and a client's right to do so.
//!
//! Many drivers send 24h as their first request. So that a driver can start again, 24h clears a FAST STOP that the
//! gripper or a lost driver of the same host caused. By default, 24h never clears a FAST STOP that another client
//! requested.

use std::sync::Arc;

use tokio::time::timeout;

use crate::gripper::handle::FAST_STOP_WAIT;
use crate::gripper::{Conflict, Handle, Rejection};
use crate::model::{Client, FastStopCause, FastStopId, LatchFields};

/// Acknowledges a FAST STOP. A driver that connects again just after its connection was lost sends 24h before the device
/// has confirmed the FAST STOP for that loss.
pub(super) async fn acknowledge(gripper: &Handle, id: FastStopId, client: Client) -> Result<(), Rejection> {
    let result = gripper.acknowledge(id, client.clone()).await;
    if !matches!(result, Err(Rejection::Conflict(Conflict::FastStopUnconfirmed { .. }))) {
        return result;
    }
    let mut states = gripper.states();
    let confirmed = states.wait_for(|state| state.latch.as_ref().is_none_or(|latch| latch.fast_stop_confirmed));
    // Without a confirmation, the second attempt is refused for the same reason.
    let _ = timeout(FAST_STOP_WAIT, confirmed).await;
    gripper.acknowledge(id, client).await
}

#[derive(Debug)]
pub(super) struct AcknowledgeRight {
    subject: Arc<str>,
    /// Whether the client may acknowledge every FAST STOP.
    any: bool,
    /// Whether the client holds the lease.
    holds_lease: bool,
    /// The last FAST STOP that this client caused.
    caused: Option<FastStopId>,
    /// The last FAST STOP that this client has seen.
    seen: Option<FastStopId>,
}

impl AcknowledgeRight {
    pub(super) fn new(subject: Arc<str>, any: bool) -> Self {
        Self { subject, any, holds_lease: false, caused: None, seen: None }
    }

    pub(super) fn set_holder(&mut self, holds_lease: bool) {
        self.holds_lease = holds_lease;
    }

    pub(super) fn caused(&mut self, id: FastStopId) {
        (self.caused, self.seen) = (Some(id), Some(id));
    }

    pub(super) fn saw(&mut self, id: FastStopId) {
        self.seen = Some(id);
    }

    /// Whether the client knows of any FAST STOP.
    pub(super) fn knows_any(&self) -> bool {
        self.seen.is_some()
    }

    /// Whether the client may clear this FAST STOP. `is_held` is true if any client holds the lease.
    pub(super) fn allows(&self, latch: &LatchFields, is_held: bool) -> bool {
        let is_held = is_held && !self.holds_lease;
        let id = Some(latch.fast_stop_id);
        let may_clear = match latch.fast_stop_cause {
            FastStopCause::Requested => false,
            FastStopCause::ClientLost => !is_held && latch.fast_stop_by == self.subject,
            // A person may have caused the FAST STOP at the gripper itself.
            FastStopCause::Unknown => self.seen == id,
            FastStopCause::UnannouncedDisconnect
            | FastStopCause::TemperatureFault
            | FastStopCause::PowerFault
            | FastStopCause::CurrentFault
            | FastStopCause::FingerFault
            | FastStopCause::SoftLimit => !is_held || self.seen == id,
        };
        self.any || may_clear || self.caused == id && latch.fast_stop_by == self.subject
    }
}
