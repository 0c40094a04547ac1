//! The result of an operation.

use std::marker::PhantomData;
use std::sync::Arc;

use serde::Serialize;
use serde_json::value::{RawValue, to_raw_value};
use utoipa::ToSchema;

use super::connection_lease::ConnectionLease;
use super::contract::{Answer, Schemas};
use crate::gripper::Ticket;
use crate::model::{Code, CommandReport, Name};
use crate::operations::problem::Problem;

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

/// A result without an effect, which others use too.
#[derive(Debug)]
pub struct SharedJson<T>(pub Arc<T>);

/// A result with its version, which a later change can require.
#[derive(Debug)]
pub struct Versioned<T> {
    pub version: u64,
    /// Whether the operation created the result.
    pub is_new: bool,
    pub result: Arc<T>,
}

/// A result, or the command that is still running.
#[derive(Debug)]
pub struct OrRunning<T> {
    reply: OperationReply,
    result: PhantomData<fn() -> T>,
}

/// A result, or its present state while the client has to wait for another one.
#[derive(Debug)]
pub struct OrWaiting<T> {
    reply: OperationReply,
    result: PhantomData<fn() -> T>,
}

impl<T: Serialize> OrRunning<T> {
    /// The result.
    pub(in crate::operations) fn ended(result: &T) -> Result<Self, Problem> {
        Ok(Self { reply: OperationReply::new(result, Effect::None)?, result: PhantomData })
    }

    /// The running command.
    pub(in crate::operations) fn running(command: &CommandReport, ticket: Ticket) -> Result<Self, Problem> {
        let effect = Effect::Running { gripper: command.gripper.clone(), ticket };
        Ok(Self { reply: OperationReply::new(command, effect)?, result: PhantomData })
    }
}

impl<T: Serialize> OrWaiting<T> {
    pub(in crate::operations) fn new(result: &T, effect: Effect) -> Result<Self, Problem> {
        Ok(Self { reply: OperationReply::new(result, effect)?, result: PhantomData })
    }
}

/// A result that the function of an operation can return.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not the result of an operation",
    note = "return `Json`, `SharedJson`, `Versioned`, `OrRunning` or `OrWaiting` of a type that is `Serialize` and `ToSchema`"
)]
pub trait IntoReply {
    fn into_reply(self) -> Result<OperationReply, Problem>;

    /// Describes the successful answers, and adds their schemas.
    fn answers(schemas: &mut Schemas) -> Vec<Answer>;
}

impl<T: Serialize + ToSchema> IntoReply for Json<T> {
    fn into_reply(self) -> Result<OperationReply, Problem> {
        OperationReply::new(&self.0, Effect::None)
    }

    fn answers(schemas: &mut Schemas) -> Vec<Answer> {
        vec![Answer::of::<T>(200, schemas)]
    }
}

impl<T: Serialize + ToSchema> IntoReply for SharedJson<T> {
    fn into_reply(self) -> Result<OperationReply, Problem> {
        OperationReply::new(&*self.0, Effect::None)
    }

    fn answers(schemas: &mut Schemas) -> Vec<Answer> {
        Json::<T>::answers(schemas)
    }
}

impl<T: Serialize + ToSchema> IntoReply for Versioned<T> {
    fn into_reply(self) -> Result<OperationReply, Problem> {
        let reply = OperationReply::new(&*self.result, Effect::None)?;
        Ok(OperationReply { version: Some(self.version), is_new: self.is_new, ..reply })
    }

    fn answers(schemas: &mut Schemas) -> Vec<Answer> {
        let header = Some(("ETag", "The version, for `If-Match`"));
        vec![Answer { header, ..Answer::of::<T>(200, schemas) }]
    }
}

impl<T: Serialize + ToSchema> IntoReply for OrRunning<T> {
    fn into_reply(self) -> Result<OperationReply, Problem> {
        Ok(self.reply)
    }

    fn answers(schemas: &mut Schemas) -> Vec<Answer> {
        let running = Answer {
            description: Some("The command, still running after `wait_ms`"),
            header: Some(("Location", "Path of the command")),
            ..Answer::of::<CommandReport>(202, schemas)
        };
        vec![Answer::of::<T>(200, schemas), running]
    }
}

impl<T: Serialize + ToSchema> IntoReply for OrWaiting<T> {
    fn into_reply(self) -> Result<OperationReply, Problem> {
        Ok(self.reply)
    }

    fn answers(schemas: &mut Schemas) -> Vec<Answer> {
        let description = Some("The hand-over is requested: the current lease, with the `place` of the request");
        vec![Answer::of::<T>(200, schemas), Answer { description, ..Answer::of::<T>(202, schemas) }]
    }
}

impl OperationReply {
    pub(in crate::operations) fn new(result: &impl Serialize, effect: Effect) -> Result<Self, Problem> {
        let body = to_raw_value(result)
            .map_err(|error| Problem::new(Code::Internal, format!("the result could not be serialised: {error}")))?;
        Ok(Self { body, effect, version: None, is_new: false })
    }
}
