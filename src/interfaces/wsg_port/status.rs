//! Statuses of refused requests: every [`Rejection`] as a status of the manual.

use crate::gripper::{Conflict, DeviceRefusal, Failure, Invalid, Rejection};
use crate::model::{CommandReport, FastStopId, Outcome};
use crate::wsg::Status;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RefusedStatus {
    pub status: Status,
    /// The FAST STOP that caused the refusal.
    pub fast_stop: Option<FastStopId>,
}

impl From<&Rejection> for RefusedStatus {
    fn from(rejection: &Rejection) -> Self {
        let fast_stop = match rejection {
            Rejection::Conflict(Conflict::FastStop { id }) => Some(*id),
            Rejection::Device(refusal) => refusal.fast_stop,
            _ => None,
        };
        Self { status: status_of(rejection), fast_stop }
    }
}

/// Returns the status of a rejection. The match is exhaustive, so that every new reason gets a status.
fn status_of(rejection: &Rejection) -> Status {
    match rejection {
        Rejection::Invalid(Invalid::OutOfRange { .. }) => Status::E_RANGE_ERROR,
        Rejection::Invalid(Invalid::Malformed { .. }) => Status::E_CMD_FORMAT_ERROR,
        Rejection::Conflict(conflict) => match conflict {
            Conflict::FastStop { .. }
            | Conflict::StaleFastStop { .. }
            | Conflict::FastStopUnconfirmed { .. }
            | Conflict::LeaseHeld { .. }
            | Conflict::Reserved { .. }
            | Conflict::LeaseBound { .. }
            | Conflict::LeaseTokenMissing { .. }
            | Conflict::LeaseRequested { .. }
            | Conflict::StaleLease { .. } => Status::E_ACCESS_DENIED,
            Conflict::AlreadyRunning { .. }
            | Conflict::FingersMove
            | Conflict::Acknowledging { .. }
            | Conflict::Steering { .. } => Status::E_ALREADY_RUNNING,
            Conflict::NotReferenced | Conflict::SettingsLost { .. } => Status::E_NOT_INITIALIZED,
            Conflict::FastStopPersists { .. }
            | Conflict::RequestIdReused
            | Conflict::UnknownPast
            | Conflict::NoServo { .. }
            | Conflict::StaleTarget { .. } => Status::E_CMD_FAILED,
        },
        Rejection::Device(DeviceRefusal { status, .. }) => *status,
        Rejection::Failure(failure) => match failure {
            Failure::LinkDown { .. } | Failure::FlagsUnknown { .. } => Status::E_IO_ERROR,
            Failure::ValueUnknown { .. } => Status::E_NOT_AVAILABLE,
            Failure::Draining => Status::E_ACCESS_DENIED,
            Failure::DeviceTimeout { .. }
            | Failure::NoValueYet { .. }
            | Failure::NotSent { .. }
            | Failure::Late { .. } => Status::E_TIMEOUT,
            Failure::StoppedFirst { .. } => Status::E_CMD_ABORTED,
            Failure::DeviceProtocol { .. } => Status::E_INCONSISTENT_DATA,
            // E_ACCESS_DENIED would mean that another client or a FAST STOP blocks the request.
            Failure::Overloaded { .. }
            | Failure::RequestIds { .. }
            | Failure::FlashWear { .. }
            | Failure::LineTime { .. } => Status::E_INSUFFICIENT_RESOURCES,
            Failure::JournalDown { .. } => Status::E_WRITE_ERROR,
        },
    }
}

/// Returns the status of a command's final reply: the device's own status, if it gave one.
pub(super) fn status_of_end(command: &CommandReport) -> Status {
    if let Some(rejection) = &command.rejection {
        return status_of(rejection);
    }
    match (command.status_code, command.outcome) {
        (Some(code), _) => Status::from_code(code),
        (None, Some(Outcome::Aborted)) => Status::E_CMD_ABORTED,
        // The motion may have happened, so report neither success nor failure.
        (None, _) => Status::E_TIMEOUT,
    }
}
