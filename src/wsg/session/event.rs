//! Events that a session reports to its owner.

use std::time::Duration;

use super::Token;
use crate::Status;
use crate::reply::{Data, InvalidReply, Reply};

/// An event of a session.
#[derive(Debug, Clone, PartialEq)]
pub enum SessionEvent {
    /// The device has accepted a request with `E_CMD_PENDING`; its result follows.
    Accepted(Token),
    /// A request has ended.
    Ended(Token, End),
    /// A value of 40h, 41h, 43h, 44h or 45h, from an automatic update or a reply.
    Update(Data),
    /// A frame of one of these ids without its value.
    NoValue(u8, NoValue),
    /// The first reply of an id that is longer than the manuals say, with its size in bytes. Its known fields are used.
    LongReply(u8, usize),
}

/// Content of an update or a reply that has no value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NoValue {
    /// An error status.
    Refused(Status),
    /// Bytes that no device could send.
    Invalid(InvalidReply),
}

/// End of a request.
#[derive(Debug, Clone, PartialEq)]
pub enum End {
    /// With a reply.
    Reply(Reply),
    /// With an invalid reply. Does not occur for motions, whose invalid replies are ignored.
    Invalid(InvalidReply),
    /// Without any reply before the deadline.
    Unanswered {
        /// Whether the frame was handed out. If not, the device never received it.
        written: bool,
        /// Whether a Stop or FAST STOP was confirmed meanwhile.
        stopped: bool,
        /// Time spent waiting.
        waited: Duration,
    },
    /// Accepted, but without a result before the deadline.
    NoResult {
        /// Whether a Stop or FAST STOP was confirmed meanwhile, which explains the missing result.
        stopped: bool,
    },
}
