//! Commands: handed to the gripper, waited for, looked up, cancelled.

use std::sync::Arc;

use axum::extract::State as Shared;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use utoipa::IntoResponses;

use super::body::{Body, Leased};
use super::errors::Problem;
use super::extract::{
    CommandOf, CommandPath, DEFAULT_WAIT_MS, Gripper, GripperPath, Keys, LeaseHeader, NoWaitQuery, WaitMs, WaitQuery,
};
use super::responses::CommandProblem;
use super::{API, Context, watched};
use crate::gripper::Ticket;
use crate::gripper::model::{Action, Command, LeaseToken, Phase, Submission};

/// Submits a command, and waits for its end. What the device refused meanwhile is a problem, since its client still
/// listens.
pub async fn run(gripper: Gripper, keys: Keys, action: Action, wait: Wait) -> Result<(Command, Ticket), Problem> {
    let Keys { request_id, lease } = keys;
    let gripper = gripper.with_lease(lease.as_ref().map(LeaseToken::as_str))?;
    let submission = Submission { client: gripper.client.clone(), action, request_id, lease };
    // What keeps the lease meanwhile is the request.
    let mut ticket = gripper.handle.submit(submission).await?.watched();
    watched::note_command(ticket.id());
    let mut command = wait.until_ended(&mut ticket).await;
    match command.rejection.take() {
        Some(rejection) => Err(Problem::from(rejection).recorded()),
        None => Ok((command, ticket)),
    }
}

/// How long a command is waited for if its client doesn't say.
pub type Wait = WaitMs<DEFAULT_WAIT_MS>;

/// What [`told`] answers, for the document.
#[derive(IntoResponses)]
#[allow(dead_code, reason = "the document's words on what told answers")]
pub enum Told {
    /// The command, ended: `outcome` says how
    #[response(status = 200)]
    Ended(Command),
    /// The command, still running after `wait_ms`
    #[response(status = 202, headers(("Location" = String, description = "Where to ask for it")))]
    Running(Command),
}

/// 200 with the command where it has ended, else 202 and where to ask for it; who is in this process can wait by the
/// ticket.
pub fn told((command, ticket): (Command, Ticket)) -> Response {
    match command.phase {
        Phase::Done => Json(command).into_response(),
        Phase::Running => {
            let location = format!("{API}/grippers/{}/commands/{}", command.gripper, command.id);
            (StatusCode::ACCEPTED, [(header::LOCATION, location)], Extension(ticket), Json(command)).into_response()
        }
    }
}

fn known(ticket: Option<Ticket>) -> Result<Ticket, Problem> {
    ticket.ok_or_else(|| Problem::not_found("command of this id here: commands are kept for an hour"))
}

/// A command
///
/// As it is now, or when it has ended, if that is sooner than `wait_ms`.
#[utoipa::path(
    get,
    path = "/grippers/{gripper}/commands/{command}",
    operation_id = "get_command",
    tag = "commands",
    params(GripperPath, CommandPath, NoWaitQuery, LeaseHeader),
    responses((status = 200, description = "The command", body = Command), CommandProblem)
)]
pub async fn get(
    Shared(context): Shared<Arc<Context>>,
    gripper: Gripper,
    CommandOf(id): CommandOf,
    wait: WaitMs<0>,
) -> Result<Json<Command>, Problem> {
    let gripper = gripper.with_lease(None)?;
    if let Some(mut ticket) = gripper.handle.find(id).await? {
        return Ok(Json(wait.until_ended(&mut ticket).await));
    }
    let written_down = context.journal.command(gripper.handle.name().clone(), id).await?;
    written_down.map(Json).ok_or_else(|| Problem::not_found("command of this id"))
}

/// Cancel a command
///
/// Stops it if it still runs; one that has ended stays as it is.
#[utoipa::path(
    post,
    path = "/grippers/{gripper}/commands/{command}/cancel",
    operation_id = "cancel_command",
    tag = "commands",
    params(GripperPath, CommandPath, WaitQuery, LeaseHeader),
    request_body(content = Option<Leased>, description = "Nothing, or the lease's token"),
    responses(Told, CommandProblem)
)]
pub async fn cancel(
    gripper: Gripper,
    CommandOf(id): CommandOf,
    wait: Wait,
    Body(Leased { lease }): Body<Leased>,
) -> Result<Response, Problem> {
    let gripper = gripper.with_lease(lease.as_deref())?;
    let mut ticket = known(gripper.handle.cancel(id, gripper.client).await?)?;
    Ok(told((wait.until_ended(&mut ticket).await, ticket)))
}
