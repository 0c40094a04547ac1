//! Rejections of requests. Bad input, the gateway's own state, the device's refusal and the gateway's failure are
//! different types. Every interface maps each of them in one exhaustive match.

use std::sync::Arc;

use wsg::Status;

use crate::{Code, CommandId, FastStopId, Link, ServoEnd};

#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejection {
    /// The request is not valid, whatever the gripper's state.
    #[error(transparent)]
    Invalid(#[from] Invalid),
    /// The gateway's state forbids the request for now.
    #[error(transparent)]
    Conflict(#[from] Conflict),
    /// The device refused the request.
    #[error(transparent)]
    Device(#[from] DeviceRefusal),
    /// The request did not reach the device, or no valid reply came.
    #[error(transparent)]
    Failure(#[from] Failure),
}

impl Rejection {
    /// Machine-readable cause.
    #[must_use]
    pub fn code(&self) -> Code {
        match self {
            Self::Invalid(Invalid::OutOfRange { .. }) => Code::OutOfRange,
            Self::Invalid(Invalid::Malformed { .. }) => Code::Malformed,
            Self::Conflict(conflict) => conflict.code(),
            Self::Device(refusal) => refusal.code(),
            Self::Failure(failure) => failure.code(),
        }
    }
}

/// An invalid value. It never becomes a frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum Invalid {
    /// Outside the device's limits, or the soft limits.
    #[error("{field} is {value}; it must be from {min} to {max} ({limit})")]
    OutOfRange {
        field: &'static str,
        value: f32,
        min: f32,
        max: f32,
        /// Source of the limit, and the remedy.
        limit: &'static str,
    },
    /// A value of the wrong form.
    #[error("{field}: {detail}")]
    Malformed { field: &'static str, detail: String },
}

/// Conflict with the gateway's own state.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum Conflict {
    #[error("FAST STOP {id} is latched: remove its cause, then acknowledge it by this id")]
    FastStop { id: FastStopId },
    #[error(
        "the device is still in FAST STOP after the acknowledgement (flags: {flags}): remove the cause and try again"
    )]
    FastStopPersists { id: FastStopId, flags: String },
    #[error("{}", stale_fast_stop(*given, *current))]
    StaleFastStop { given: FastStopId, current: Option<FastStopId> },
    #[error("the device has not confirmed FAST STOP {id} yet: wait for the confirmation, then try again")]
    FastStopUnconfirmed { id: FastStopId },
    #[error("another acknowledgement is in progress: wait for its result")]
    Acknowledging { id: Option<FastStopId> },
    #[error("the gripper is not referenced: home it first")]
    NotReferenced,
    #[error(
        "command {id} is still running: wait until it has ended, then repeat the request; stop it only if its motion is \
         not wanted any more"
    )]
    AlreadyRunning { id: CommandId },
    #[error("the fingers are moving without a command: stop them, then repeat the request")]
    FingersMove,
    #[error("the device lost settings that could not be restored ({settings}): set them again first")]
    SettingsLost { settings: String },
    #[error(
        "{holder} holds the lease for another {expires_in_ms} ms unless it is renewed: wait, ask for a hand-over with \
         `request`, or take it with `force`, which stops a running motion"
    )]
    LeaseHeld {
        holder: Arc<str>,
        /// Remaining time to live without use.
        expires_in_ms: u64,
    },
    #[error(
        "the gripper is reserved for {holder}, whose lease was lost while a part was held or a motion continued: \
         another client needs `force` to take it"
    )]
    Reserved { holder: Arc<str> },
    #[error(
        "{holder} holds the lease until it disconnects or releases it: wait, ask for a hand-over with `request`, or \
         take it with `force`, which stops a running motion"
    )]
    LeaseBound { holder: Arc<str>, ttl_ms: u64 },
    #[error(
        "the request has no lease token: {holder} holds the lease, which this client ({subject}) took itself; send its \
         token as `lease` or in the header Wsg-Lease"
    )]
    LeaseTokenMissing { holder: Arc<str>, subject: Arc<str>, expires_in_ms: u64 },
    /// The request for a hand-over waits for the holder. It is forgotten a minute after its last repetition.
    #[error("{holder} holds the lease: the request for a hand-over waits in place {place}; repeat it within a minute")]
    LeaseRequested { holder: Arc<str>, place: usize },
    #[error("{}", stale_lease(*epoch, holder.as_deref()))]
    StaleLease { epoch: u64, holder: Option<Arc<str>> },
    #[error("the request id was already used for a different request: use a new id for each new request")]
    RequestIdReused,
    #[error(
        "the journal was restored, so it is unknown whether a request with this id has moved the gripper: look at the \
         gripper, then send a request without an id, or acknowledge the alarm `journal_restored`; ids are accepted \
         again 10 minutes after the restart"
    )]
    UnknownPast,
    #[error("{by} steers the fingers in a servo session: wait, or end the session with a Stop")]
    Steering { by: Arc<str> },
    #[error("{}", no_servo(*ended))]
    NoServo { ended: Option<ServoEnd> },
    #[error("the target was not applied: {why}; send a newer one, with `at` by the gateway's clock")]
    StaleTarget { why: &'static str },
}

impl Conflict {
    fn code(&self) -> Code {
        match self {
            Self::FastStop { .. } | Self::FastStopPersists { .. } => Code::FastStop,
            Self::StaleFastStop { .. } => Code::StaleFastStop,
            Self::FastStopUnconfirmed { .. } => Code::FastStopUnconfirmed,
            Self::NotReferenced => Code::NotReferenced,
            Self::Acknowledging { .. } | Self::AlreadyRunning { .. } | Self::FingersMove | Self::Steering { .. } => {
                Code::AlreadyRunning
            }
            Self::SettingsLost { .. } => Code::DeviceRefused,
            Self::LeaseHeld { .. }
            | Self::LeaseBound { .. }
            | Self::LeaseTokenMissing { .. }
            | Self::LeaseRequested { .. } => Code::LeaseHeld,
            Self::StaleLease { .. } => Code::StaleLease,
            Self::Reserved { .. } => Code::Reserved,
            Self::RequestIdReused => Code::RequestIdReused,
            Self::UnknownPast => Code::UnknownPast,
            Self::NoServo { .. } => Code::NoServo,
            Self::StaleTarget { .. } => Code::StaleTarget,
        }
    }
}

fn no_servo(ended: Option<ServoEnd>) -> String {
    let reason = match ended {
        None => "this client has none".to_owned(),
        Some(ended) => format!("the last one ended because of `{}`", ended.name()),
    };
    format!("no servo session is open: {reason}; begin one with `servo.start`")
}

fn stale_lease(epoch: u64, holder: Option<&str>) -> String {
    match holder {
        Some(holder) => format!(
            "the lease token is no longer valid: {holder} holds the lease (epoch {epoch}); wait, or ask for a hand-over"
        ),
        None => format!(
            "the lease token is not valid: nobody holds the lease (newest epoch: {epoch}); take the lease again"
        ),
    }
}

fn stale_fast_stop(given: FastStopId, current: Option<FastStopId>) -> String {
    match current {
        Some(current) => format!(
            "FAST STOP {given} is not the newest: remove the cause of FAST STOP {current}, then acknowledge that one"
        ),
        None => format!("no FAST STOP is latched, so {given} cannot be acknowledged"),
    }
}

/// A status other than success from the device. Clients get its name and number.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the device refused {command}: {status} ({}), {}{}", status.code(), status.meaning(), self.remedy())]
pub struct DeviceRefusal {
    pub command: &'static str,
    pub status: Status,
    /// Id of the latched FAST STOP, if there is one.
    pub fast_stop: Option<FastStopId>,
}

impl DeviceRefusal {
    fn code(&self) -> Code {
        match self.status {
            Status::E_ACCESS_DENIED if self.fast_stop.is_some() => Code::FastStop,
            Status::E_NOT_INITIALIZED => Code::NotReferenced,
            // No command of the gateway runs, so the device still counts its last grip as running (`fw4-en 3.2.6`).
            Status::E_ALREADY_RUNNING if self.command == "Grip" => Code::ReleaseFirst,
            Status::E_ALREADY_RUNNING => Code::AlreadyRunning,
            Status::E_RANGE_ERROR => Code::OutOfRange,
            _ => Code::DeviceRefused,
        }
    }

    fn remedy(&self) -> &'static str {
        match self.code() {
            Code::ReleaseFirst => "; if the fingers stand still, release before the next grip",
            Code::AlreadyRunning => "; wait until the gripper stands still, then repeat the request",
            _ => "",
        }
    }
}

/// A motion that the device accepted, and then ended with an error. The command reports this as its result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the device ended {command} with {status} ({}), {}: {}", status.code(), status.meaning(), self.remedy())]
pub struct MotionError {
    pub command: &'static str,
    pub status: Status,
}

impl MotionError {
    /// Machine-readable cause.
    #[must_use]
    pub const fn code(&self) -> Code {
        match self.status {
            Status::E_RANGE_ERROR => Code::OutOfRange,
            _ => Code::DeviceRefused,
        }
    }

    fn remedy(&self) -> &'static str {
        match self.status {
            // After a block, the fingers can go on pushing, and snap to the target when freed (`fw4-en 3.2.2`).
            Status::E_AXIS_BLOCKED => "stop the gripper, remove the obstacle, then repeat the command",
            Status::E_RANGE_ERROR => "the fingers reached a soft or hard limit; choose a target within the limits",
            Status::E_TIMEOUT => "check that nothing hinders the fingers, then repeat the command",
            _ => "check the state and the flags of the gripper before you repeat the command",
        }
    }
}

/// Failure to reach the device, or to get a valid reply.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages name the fields")]
pub enum Failure {
    #[error("{}", link_down(*link, url, cause.as_deref()))]
    LinkDown {
        link: Link,
        /// Address of the device.
        url: String,
        /// `None` while the link is being set up.
        cause: Option<String>,
    },
    /// The gateway is shutting down, or the gripper is being removed.
    #[error("the gateway is disconnecting from this gripper and accepts no new commands for it")]
    Draining,
    #[error("the device did not answer {command} within {waited_ms} ms")]
    DeviceTimeout { command: &'static str, waited_ms: u64 },
    /// The device sends this value by itself, but has not sent it yet. The width follows only after homing.
    #[error("the device has not sent the value of {command} yet: home it if it is not referenced, then try again")]
    NoValueYet { command: &'static str },
    /// The device should send this value by itself, and does not.
    #[error("the value of {command} is unknown: {cause}")]
    ValueUnknown { command: &'static str, cause: String },
    #[error("{cause}: motions are refused until the device sends its flags (40h) again; check the device and its line")]
    FlagsUnknown { cause: String },
    /// The device never received the request.
    #[error("{command} was not sent, because an earlier request still had no reply: try again later")]
    NotSent { command: &'static str },
    /// The device never received the request.
    #[error("{command} was not sent, because it could not begin within {waited_ms} ms: send it again")]
    Late { command: &'static str, waited_ms: u64 },
    /// The device never received the request.
    #[error("{command} was not sent, because a Stop came first: send it again if it is still wanted")]
    StoppedFirst { command: &'static str },
    #[error("unexpected reply from the device to {command}: {detail}")]
    DeviceProtocol { command: &'static str, detail: String },
    #[error("{limit} requests are already waiting for this gripper: try again later")]
    Overloaded { limit: usize },
    #[error(
        "this client has reached the limit of {limit} request ids for this gripper within 10 minutes: wait, or send \
             fewer requests with an id"
    )]
    RequestIds { limit: usize },
    #[error(
        "journal unavailable ({cause}): motion is blocked until it recovers, unless on_journal_failure is set to \
             continue"
    )]
    JournalDown { cause: String },
    #[error(
        "{command} wears the device's flash memory, so the limit is one every {every_ms} ms: try again later, and \
         only if the value has changed"
    )]
    FlashWear { command: &'static str, every_ms: u64 },
    #[error(
        "{command} would take {line_ms} ms of line time; while the fingers may move, at most {max_ms} ms are allowed: wait \
         until they stand still, then repeat the request"
    )]
    LineTime { command: &'static str, line_ms: u64, max_ms: u64 },
}

fn link_down(link: Link, url: &str, cause: Option<&str>) -> String {
    let remedy = match cause {
        None => "it is being set up; try again in a moment",
        // The cause of a released link includes the remedy.
        Some(_) if link == Link::Released => "",
        // On transports other than TCP, a cause in two parts also includes it.
        Some(cause) if !url.starts_with("tcp:") && cause.contains(": ") => "",
        Some(_) => "check power, cable and address",
    };
    let parts = cause.into_iter().chain(Some(remedy).filter(|remedy| !remedy.is_empty()));
    format!("no link to the device at {url} ({link}): {}", parts.collect::<Vec<_>>().join(": "))
}

impl Failure {
    const fn code(&self) -> Code {
        match self {
            Self::LinkDown { .. } | Self::FlagsUnknown { .. } | Self::Draining => Code::LinkDown,
            Self::DeviceTimeout { .. }
            | Self::NoValueYet { .. }
            | Self::ValueUnknown { .. }
            | Self::NotSent { .. }
            | Self::Late { .. }
            | Self::StoppedFirst { .. } => Code::DeviceTimeout,
            Self::DeviceProtocol { .. } => Code::DeviceProtocol,
            Self::JournalDown { .. } => Code::JournalDown,
            Self::Overloaded { .. } | Self::RequestIds { .. } | Self::FlashWear { .. } => Code::Overloaded,
            Self::LineTime { .. } => Code::AlreadyRunning,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_link_is_reported_with_address_cause_and_remedy() {
        let said = |link, url: &str, cause: Option<&str>| {
            Failure::LinkDown { link, url: url.to_owned(), cause: cause.map(str::to_owned) }.to_string()
        };
        assert_eq!(
            said(Link::Connecting, "tcp://192.168.1.20:1000", Some("Connection refused (os error 111)")),
            "no link to the device at tcp://192.168.1.20:1000 (connecting): Connection refused (os error 111): check \
             power, cable and address"
        );
        let setup = said(Link::Connecting, "can://can0", None);
        assert_eq!(
            setup,
            "no link to the device at can://can0 (connecting): it is being set up; try again in a moment"
        );
        for (link, url, cause) in [
            (Link::Reconnecting, "can://can0", "can0 is down: bring it up with sudo ip link set can0 up"),
            (Link::Released, "tcp://192.168.1.20:1000", "by http:10.0.0.5; a `connect` request restores the link"),
        ] {
            assert!(said(link, url, Some(cause)).ends_with(&format!("({link}): {cause}")), "{cause}");
        }
    }
}
