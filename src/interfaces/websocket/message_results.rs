//! Results of a message or a request on a socket.

use std::sync::Arc;

use serde_json::Value;
use serde_json::value::{RawValue, to_raw_value};

use super::bodies::Following;
use super::rpc::{RpcError, RpcResponse};
use crate::gripper::Ticket;
use crate::operations::{Code, ConnectionLease, Effect, OperationReply, Problem};

/// The result of a message.
#[derive(Default)]
pub struct MessageResult {
    pub requests: usize,
    pub bytes: usize,
    pub answer: Option<String>,
    pub running: Vec<Ticket>,
    pub leases: Vec<Arc<ConnectionLease>>,
    pub following: Option<Following>,
}

/// The result of one request.
#[derive(Default)]
pub struct Answered {
    pub answer: Option<RpcResponse>,
    pub running: Option<Ticket>,
    pub lease: Option<Arc<ConnectionLease>>,
    pub following: Option<Following>,
}

impl Answered {
    pub fn new(id: Option<Value>, result: Result<OperationReply, Problem>) -> Self {
        let has_id = id.is_some();
        let (result, effect) = match result {
            Ok(OperationReply { body, effect, .. }) => (Ok(body), effect),
            Err(problem) => (Err(problem.into()), Effect::None),
        };
        let (running, lease) = match effect {
            // The end of a command is reported only if its start was.
            Effect::Running { ticket, .. } => (Some(ticket).filter(|_| has_id), None),
            Effect::Leased(lease) => (None, Some(lease)),
            Effect::None | Effect::Waiting => (None, None),
        };
        Self { answer: id.map(|id| RpcResponse::new(id, result)), running, lease, following: None }
    }
}

impl MessageResult {
    pub fn of(requests: usize, all: Vec<Answered>, is_batch: bool) -> Self {
        let mut done = Self { requests, ..Self::default() };
        let mut answers = Vec::new();
        for answered in all {
            answers.extend(answered.answer);
            done.running.extend(answered.running);
            done.leases.extend(answered.lease);
            done.following = answered.following.or(done.following);
        }
        let json = match answers.as_slice() {
            [] => return done,
            [answer] if !is_batch => serde_json::to_string(answer),
            answers => serde_json::to_string(answers),
        };
        done.answer = json.inspect_err(|error| tracing::error!(%error, "response could not be serialised")).ok();
        done
    }
}

/// Serialises the result of a request.
pub fn raw(body: &impl serde::Serialize) -> Result<Box<RawValue>, RpcError> {
    to_raw_value(body)
        .map_err(|error| Problem::new(Code::Internal, format!("response could not be serialised: {error}")).into())
}
