//! The result of an operation.

use std::sync::Arc;

use serde::Serialize;
use serde_json::value::{RawValue, to_raw_value};

use super::connection_lease::ConnectionLease;
use super::problem::Problem;
use crate::gripper::Ticket;
use crate::gripper::model::{Code, Name};

/// The successful result of an operation.
#[derive(Debug)]
pub struct OperationReply {
    /// The result as JSON.
    pub body: Box<RawValue>,
    /// The command or lease that outlives the reply, if any.
    pub effect: Effect,
    /// Version of the recipe in the reply, if it is one.
    pub version: Option<u64>,
    /// Whether the operation created what it returns.
    pub is_new: bool,
}

/// A command or lease that outlives a reply.
#[derive(Debug)]
pub enum Effect {
    None,
    /// A command that has not ended.
    Running {
        gripper: Name,
        ticket: Ticket,
    },
    /// A request for a hand-over that waits for the lease holder.
    Waiting,
    /// A lease that was acquired.
    Leased(Arc<ConnectionLease>),
}

/// A result without an effect.
#[derive(Debug)]
pub struct Json<T>(pub T);

/// A result with its version, which a later change can require.
#[derive(Debug)]
pub struct Versioned<T> {
    pub version: u64,
    /// Whether the operation created the result.
    pub is_new: bool,
    pub result: T,
}

/// A result that the function of an operation can return.
pub(super) trait IntoReply {
    fn into_reply(self) -> Result<OperationReply, Problem>;
}

impl IntoReply for OperationReply {
    fn into_reply(self) -> Result<OperationReply, Problem> {
        Ok(self)
    }
}

impl<T: Serialize> IntoReply for Json<T> {
    fn into_reply(self) -> Result<OperationReply, Problem> {
        OperationReply::new(&self.0, Effect::None)
    }
}

impl<T: Serialize> IntoReply for Versioned<T> {
    fn into_reply(self) -> Result<OperationReply, Problem> {
        let reply = OperationReply::new(&self.result, Effect::None)?;
        Ok(OperationReply { version: Some(self.version), is_new: self.is_new, ..reply })
    }
}

impl OperationReply {
    pub(super) fn new(result: &impl Serialize, effect: Effect) -> Result<Self, Problem> {
        let body = to_raw_value(result)
            .map_err(|error| Problem::new(Code::Internal, format!("the result could not be serialised: {error}")))?;
        Ok(Self { body, effect, version: None, is_new: false })
    }
}
