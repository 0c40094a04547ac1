//! Why a request was not done. Bad input, the gateway's own state, the device's refusal and our failure are
//! different types, and every door maps each to its own words in one exhaustive match.

use std::sync::Arc;

use crate::wsg::Status;

use super::model::{CommandId, FastStopId, Link};

/// Why a request has no outcome.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// What was asked for can't be.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// It could be, but not now.
    #[error(transparent)]
    Conflict(#[from] Conflict),
    /// The device refused it.
    #[error(transparent)]
    Device(#[from] DeviceRefusal),
    /// We couldn't ask, or got no answer.
    #[error(transparent)]
    Failure(#[from] Failure),
}

/// A value that can't be. It never becomes a frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Invalid {
    /// Outside the device's limits, or the soft limits.
    #[error("{field} is {value}, and must be from {min} to {max} ({limit})")]
    OutOfRange {
        /// The field's name, as the doors have it.
        field: &'static str,
        /// What was given.
        value: f32,
        /// The lowest allowed value.
        min: f32,
        /// The highest allowed value.
        max: f32,
        /// Whose limit it is, and what can be done.
        limit: &'static str,
    },
    /// A value of the wrong form.
    #[error("{field}: {detail}")]
    Malformed {
        /// The field's name, as the doors have it.
        field: &'static str,
        /// What is wrong with it, and what is allowed.
        detail: String,
    },
}

/// The gateway's own state forbids it for now.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Conflict {
    /// A FAST STOP holds.
    #[error("a FAST STOP holds: acknowledge it by its id {id}, after its cause is gone")]
    FastStop {
        /// What an acknowledge has to name.
        id: FastStopId,
    },
    /// An acknowledge was sent, and the device's flags still show FAST STOP.
    #[error("the device stays in FAST STOP after the acknowledge (flags: {flags}): remove its cause, then repeat it")]
    FastStopPersists {
        /// What an acknowledge has to name.
        id: FastStopId,
        /// The device's flags, by name.
        flags: String,
    },
    /// The acknowledge names a FAST STOP that isn't the newest.
    #[error("{}", stale_fast_stop(*given, *current))]
    StaleFastStop {
        /// What it named.
        given: FastStopId,
        /// What holds now.
        current: Option<FastStopId>,
    },
    /// The device's flags haven't shown the FAST STOP yet, so it can't be acknowledged.
    #[error("the device has not confirmed FAST STOP {id} yet: it can be acknowledged once it has")]
    FastStopUnconfirmed {
        /// The unconfirmed one.
        id: FastStopId,
    },
    /// Somebody else's acknowledge of it is on its way.
    #[error("FAST STOP {id} is being acknowledged already: wait for its result")]
    Acknowledging {
        /// What is being acknowledged.
        id: FastStopId,
    },
    /// The fingers are not referenced.
    #[error("the gripper is not referenced: home it first")]
    NotReferenced,
    /// A command runs, and one moves at a time.
    #[error("command {id} is running: wait for its end, or stop it")]
    AlreadyRunning {
        /// The running one.
        id: CommandId,
    },
    /// The device has restarted, and refused to take what clients had set.
    #[error("the device has lost what was set, and refused to take it again ({settings}): set it anew first")]
    SettingsLost {
        /// What is lost.
        settings: String,
    },
    /// Somebody else holds the lease, or the gripper is reserved.
    #[error("{}", lease_held(holder, *expires_in_ms))]
    LeaseHeld {
        /// Who.
        holder: Arc<str>,
        /// How long it lives without use; none where the gripper is reserved for a holder that was lost.
        expires_in_ms: Option<u64>,
    },
    /// The lease token isn't that of the lease.
    #[error("{}", stale_lease(*epoch, holder.as_deref()))]
    StaleLease {
        /// The newest lease's.
        epoch: u64,
        /// Who holds that.
        holder: Option<Arc<str>>,
    },
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

/// We couldn't ask the device, or got no answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// There is no working link.
    #[error("the link to the device is {link}: {cause}")]
    LinkDown {
        /// How it is.
        link: Link,
        /// Why.
        cause: String,
    },
    /// The gateway is shutting down, or gives this gripper up.
    #[error("the gateway is giving this gripper up, and takes no new commands for it")]
    Draining,
    /// No answer came in time.
    #[error("the device did not answer {command} within {waited_ms} ms")]
    DeviceTimeout {
        /// What was asked of it.
        command: &'static str,
        /// For how long we waited.
        waited_ms: u64,
    },
    /// Its answer can't be one.
    #[error("the device's answer to {command} is none: {detail}")]
    DeviceProtocol {
        /// What was asked of it.
        command: &'static str,
        /// What is wrong with the answer.
        detail: String,
    },
    /// Too many requests wait already.
    #[error("{limit} requests wait for this gripper already: try again later")]
    Overloaded {
        /// The bound.
        limit: usize,
    },
    /// The client's request ids take all the slots that it may have.
    #[error(
        "this client has used {limit} request ids for this gripper within 10 minutes, which is the bound: wait, or \
             send fewer requests with an id"
    )]
    RequestIds {
        /// The bound.
        limit: usize,
    },
    /// The journal takes no records, and nothing moves that is not written down.
    #[error(
        "the journal takes no records ({cause}), and nothing moves that is not written down: mend it, or set \
             on_journal_failure to continue"
    )]
    JournalDown {
        /// Why.
        cause: String,
    },
    /// It would wear out the device's flash memory.
    #[error(
        "{command} wears the device's flash memory, and is sent once in {every_ms} ms at most: try again later, and \
         only when the value has changed"
    )]
    FlashWear {
        /// What was asked for.
        command: &'static str,
        /// The shortest time between two writes.
        every_ms: u64,
    },
    /// It would keep the line busy for too long while the fingers move.
    #[error("{command} would take {line_ms} ms of line time, and no more than {max_ms} ms are allowed while moving")]
    LineTime {
        /// What was asked for.
        command: &'static str,
        /// How long it would take.
        line_ms: u64,
        /// The bound.
        max_ms: u64,
    },
}
