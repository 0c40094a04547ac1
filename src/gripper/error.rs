//! Rejections of requests. Bad input, the gateway's own state, the device's refusal and the gateway's failure are
//! different types, and every interface maps each to its own words in one exhaustive match.

use std::sync::Arc;

use crate::wsg::Status;

use super::model::{CommandId, FastStopId, Link};

/// Rejection of a request.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// The request can never be done.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// The request can't be done now.
    #[error(transparent)]
    Conflict(#[from] Conflict),
    /// The device refused it.
    #[error(transparent)]
    Device(#[from] DeviceRefusal),
    /// The device could not be asked, or did not answer.
    #[error(transparent)]
    Failure(#[from] Failure),
}

/// A value that can't be. It never becomes a frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum Invalid {
    /// Outside the device's limits, or the soft limits.
    #[error("{field} is {value}, and must be from {min} to {max} ({limit})")]
    OutOfRange {
        field: &'static str,
        value: f32,
        min: f32,
        max: f32,
        /// Whose limit it is, and the remedy.
        limit: &'static str,
    },
    /// A value of the wrong form.
    #[error("{field}: {detail}")]
    Malformed { field: &'static str, detail: String },
}

/// The gateway's own state forbids it for now.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum Conflict {
    /// A FAST STOP holds.
    #[error("a FAST STOP holds: acknowledge it by its id {id}, after its cause is gone")]
    FastStop { id: FastStopId },
    /// An acknowledge was sent, and the device's flags still show FAST STOP.
    #[error("the device stays in FAST STOP after the acknowledge (flags: {flags}): remove its cause, then repeat it")]
    FastStopPersists { id: FastStopId, flags: String },
    /// The acknowledge names a FAST STOP that isn't the newest.
    #[error("{}", stale_fast_stop(*given, *current))]
    StaleFastStop { given: FastStopId, current: Option<FastStopId> },
    /// The device's flags haven't shown the FAST STOP yet, so it can't be acknowledged.
    #[error("the device has not confirmed FAST STOP {id} yet: it can be acknowledged once it has")]
    FastStopUnconfirmed { id: FastStopId },
    /// Another client's acknowledge is on its way.
    #[error("FAST STOP {id} is being acknowledged already: wait for its result")]
    Acknowledging { id: FastStopId },
    /// The fingers are not referenced.
    #[error("the gripper is not referenced: home it first")]
    NotReferenced,
    /// A command runs, and one moves at a time.
    #[error("command {id} is running: wait for its end, or stop it")]
    AlreadyRunning { id: CommandId },
    /// The device has restarted, and refused to take what clients had set.
    #[error("the device has lost what was set, and refused to take it again ({settings}): set it anew first")]
    SettingsLost { settings: String },
    /// Another client holds the lease, or the gripper is reserved.
    #[error("{}", lease_held(holder, *expires_in_ms))]
    LeaseHeld {
        holder: Arc<str>,
        /// How long it lives without use; none where the gripper is reserved for a holder that was lost.
        expires_in_ms: Option<u64>,
    },
    /// The lease token isn't that of the lease.
    #[error("{}", stale_lease(*epoch, holder.as_deref()))]
    StaleLease { epoch: u64, holder: Option<Arc<str>> },
    /// The request id was used for something else.
    #[error("the request id was used for another request: a new request needs a new id")]
    RequestIdReused,
}

fn lease_held(holder: &str, expires_in_ms: Option<u64>) -> String {
    match expires_in_ms {
        Some(ms) => format!(
            "{holder} holds the lease, for {ms} ms more if it is not renewed: wait, ask for it with request, or have a \
             supervisor force it"
        ),
        None => format!(
            "the gripper holds a part, and is reserved for {holder}, which was lost: {holder} or a supervisor may take \
             the lease"
        ),
    }
}

fn stale_lease(epoch: u64, holder: Option<&str>) -> String {
    match holder {
        Some(holder) => format!("the lease token is not valid any more: {holder} holds lease {epoch}"),
        None => format!("the lease token is not valid: no lease is held, and the newest was {epoch}; take it anew"),
    }
}

fn stale_fast_stop(given: FastStopId, current: Option<FastStopId>) -> String {
    match current {
        Some(current) => format!("FAST STOP {given} is not the newest: {current} holds now"),
        None => format!("no FAST STOP holds, so {given} cannot be acknowledged"),
    }
}

/// The device answered with a status other than success. What it was reaches the client by name and number.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the device refused {command}: {status} ({}), {}", status.code(), status.meaning())]
pub struct DeviceRefusal {
    /// What was asked of it.
    pub command: &'static str,
    /// Its answer.
    pub status: Status,
    /// The FAST STOP that holds, if one does.
    pub fast_stop: Option<FastStopId>,
}

/// Failure to ask the device, or to get an answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum Failure {
    /// There is no working link.
    #[error("the link to the device is {link}: {cause}")]
    LinkDown { link: Link, cause: String },
    /// The gateway is shutting down, or gives this gripper up.
    #[error("the gateway is giving this gripper up, and takes no new commands for it")]
    Draining,
    /// No answer came in time.
    #[error("the device did not answer {command} within {waited_ms} ms")]
    DeviceTimeout { command: &'static str, waited_ms: u64 },
    /// Its answer can't be one.
    #[error("the device's answer to {command} is none: {detail}")]
    DeviceProtocol { command: &'static str, detail: String },
    /// Too many requests wait already.
    #[error("{limit} requests wait for this gripper already: try again later")]
    Overloaded { limit: usize },
    /// The client's request ids take all the slots that it may have.
    #[error(
        "this client has used {limit} request ids for this gripper within 10 minutes, which is the bound: wait, or \
             send fewer requests with an id"
    )]
    RequestIds { limit: usize },
    /// The journal takes no records, and nothing moves that is not written down.
    #[error(
        "the journal takes no records ({cause}), and nothing moves that is not written down: mend it, or set \
             on_journal_failure to continue"
    )]
    JournalDown { cause: String },
    /// It would wear out the device's flash memory.
    #[error(
        "{command} wears the device's flash memory, and is sent once in {every_ms} ms at most: try again later, and \
         only when the value has changed"
    )]
    FlashWear { command: &'static str, every_ms: u64 },
    /// It would keep the line busy for too long while the fingers move.
    #[error("{command} would take {line_ms} ms of line time, and no more than {max_ms} ms are allowed while moving")]
    LineTime { command: &'static str, line_ms: u64, max_ms: u64 },
}
