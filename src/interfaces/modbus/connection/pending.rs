//! Requests and orders that have not ended.

use std::time::Instant;

use super::super::adu::Header;
use crate::gripper::{AcquiredLease, Handle};
use crate::model::{LeaseToken, Name};
use crate::operations::{OperationReply, Problem};

/// A request whose command is being admitted.
pub(super) struct Unanswered {
    pub header: Header,
    pub target: Target,
    /// Number of the command in the registers of the target.
    pub number: u64,
    pub until: Instant,
    pub reply: ReplyAfterWrite,
}

/// Response to a request that writes.
#[derive(Clone, Copy)]
pub(super) enum ReplyAfterWrite {
    Echo { address: u16, word: u16 },
    Read { address: u16, count: u16 },
}

/// A request's unit.
#[derive(Clone)]
pub(super) enum Target {
    Gateway,
    Gripper(Handle),
}

/// Progress of an order.
pub(super) enum OrderStep {
    /// Nothing has to be done any more.
    Finished,
    Ended {
        gripper: Handle,
        number: u64,
        kind: OrderKind,
        result: Result<OperationReply, Problem>,
    },
    /// The lease of a motion is kept, if it is still this connection's.
    Kept {
        gripper: Handle,
        /// Whether the motion was to take the lease.
        claims: bool,
        acquired: Option<Box<AcquiredLease>>,
    },
}

/// Kinds of orders that differ in their effect on the lease.
pub(super) enum OrderKind {
    /// A motion with a lease token. `claims` is true if the motion was to take the lease.
    Motion {
        token: LeaseToken,
        claims: bool,
    },
    ReleasesLease,
    Other,
}

impl Target {
    /// The gripper's name; `None` for the gateway.
    pub(super) fn gripper(&self) -> Option<Name> {
        match self {
            Self::Gateway => None,
            Self::Gripper(gripper) => Some(gripper.name().clone()),
        }
    }
}
