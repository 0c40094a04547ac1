//! Orders of a virtual device for the gripper, and the gripper's replies.

use super::status::{RefusedStatus, status_of_end};
use crate::gripper::FastStop;
use crate::model::{Action, CommandReport, FastStopId};
use crate::wsg::{Command, Data, Reply, Status};

#[derive(Debug, PartialEq)]
pub(super) enum PortOrder {
    Command(Action),
    FastStop,
    Acknowledge(FastStopId),
    /// Acknowledges a fault of the device while no FAST STOP is latched.
    AcknowledgeFault,
    Exchange(Command),
    Release,
}

/// An order and its request.
#[derive(Debug, PartialEq)]
pub(super) struct PortOrdered {
    pub ask: PortRequest,
    pub order: PortOrder,
}

/// A request that is being executed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct PortRequest {
    pub id: u8,
    /// Whether the next request waits for the reply.
    pub is_awaited: bool,
    /// Number of requests of a stream that this one has overtaken. They get the same replies.
    pub overtaken: usize,
}

/// The gripper's reply to an order.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum PortReply {
    /// The device has accepted a motion; the result follows.
    Accepted,
    Reply(Reply),
    Refused(RefusedStatus),
    /// A fault can't be acknowledged without an id: it is over, or a FAST STOP was found behind it.
    NoFault,
    FastStopped(FastStop),
}

impl PortReply {
    /// The final reply of a command.
    pub(super) fn of_end(command: &CommandReport) -> Self {
        if let Some(rejection) = &command.rejection {
            return Self::Refused(rejection.into());
        }
        match status_of_end(command) {
            Status::E_SUCCESS => {
                let answer = command.payload.as_deref().and_then(|payload| hex::decode(payload).ok());
                Self::Reply(Reply::Success(answer.map_or(Data::None, Data::Custom)))
            }
            status => Self::Reply(Reply::Status(status)),
        }
    }
}
