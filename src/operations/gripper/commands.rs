//! Submits, awaits, looks up and cancels commands.

use serde::Deserialize;
use tracing::Span;
use tracing::field::display;
use utoipa::ToSchema;

use crate::gripper::Ticket;
use crate::model::{Action, CommandId, CommandReport, LeaseToken, Phase, Submission, Urgency};
use crate::operations::calls::call::{Call, Gripper, Leased, NoFields};
use crate::operations::calls::caller::{CommandWait, DEFAULT_WAIT_MS, RequestKeys};
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::{Json, OrRunning};
use crate::operations::gateway::Gateway;
use crate::operations::parameters::values::RequestIdText;
use crate::operations::problem::Problem;

operations! {
    /// Get a command
    ///
    /// Waits up to `wait_ms` for the command to end, then returns it, ended or not.
    GET = GET "/grippers/{gripper}/commands/{command}" as "command" {
        run: get, id: "get_command", tag: "commands", problems: COMMAND,
        answer: "The command",
    }.waiting();

    /// Get the newest command
    ///
    /// Returns the newest motion of the gripper. With `request_id`, returns the newest command of this client with that
    /// id, which can also be a Stop. Waits up to `wait_ms` for the command to end.
    LATEST = GET "/grippers/{gripper}/commands/latest" as "command.latest" {
        run: latest, id: "get_latest_command", tag: "commands", problems: COMMAND,
        answer: "The command",
    }.waiting();

    /// Cancel a command
    ///
    /// Stops the command if it is still running. A command that has ended is returned unchanged.
    CANCEL = POST "/grippers/{gripper}/commands/{command}/cancel" as "cancel" {
        run: cancel, id: "cancel_command", tag: "commands", problems: COMMAND,
        answer: "The ended command, with its `outcome`",
    }.command().urgent(Urgency::Stop);
}

/// Submits a command, and waits for its end. A refusal by the device during the wait becomes a problem, since the
/// client still expects an answer.
pub(super) async fn submit(
    gripper: Gripper,
    keys: RequestKeys,
    action: Action,
    wait: &CommandWait,
) -> Result<(CommandReport, Ticket), Problem> {
    let RequestKeys { request_id, lease } = keys;
    let gripper = gripper.with_lease(lease.as_ref().map(LeaseToken::as_str))?;
    let lease = lease.filter(|_| gripper.keeps_lease);
    let submission = Submission { client: gripper.client.clone(), action, request_id, lease };
    // During the wait the request keeps the lease alive; the ticket does not.
    let mut ticket = gripper.handle.submit(submission).await?.watched();
    Span::current().record("command", display(ticket.id()));
    let mut command = wait.until_ended(&mut ticket).await;
    match command.rejection.take() {
        Some(rejection) => Err(Problem::from(rejection).recorded()),
        None => Ok((command, ticket)),
    }
}

/// Returns the reply of a command that may still run.
pub(super) fn reply_with(command: &CommandReport, ticket: Ticket) -> Result<OrRunning<CommandReport>, Problem> {
    match command.phase {
        Phase::Done => OrRunning::ended(command),
        Phase::Running => OrRunning::running(command, ticket),
    }
}

async fn get(call: Call<NoFields>) -> Result<Json<CommandReport>, Problem> {
    let gripper = call.gripper()?;
    let id = call.command_id()?;
    let wait = call.wait(0)?;
    let NoFields {} = call.fields()?;
    find(&call.gateway, &gripper, id, &wait).await.map(Json)
}

async fn find(
    gateway: &Gateway,
    gripper: &Gripper,
    id: CommandId,
    wait: &CommandWait,
) -> Result<CommandReport, Problem> {
    if let Some(mut ticket) = gripper.handle.find(id).await? {
        return Ok(wait.until_ended(&mut ticket).await);
    }
    let stored = gateway.journal.command(gripper.handle.name().clone(), id).await?;
    stored.ok_or_else(|| Problem::not_found("command with this id"))
}

/// Parameters of a look-up without a command's id.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LatestFields {
    /// Request id that this client sent with the command within the last 10 minutes.
    #[schema(value_type = Option<String>, max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$", example = "k3-17")]
    request_id: Option<RequestIdText>,
}

async fn latest(call: Call<LatestFields>) -> Result<Json<CommandReport>, Problem> {
    let gripper = call.gripper()?;
    let wait = call.wait(0)?;
    let LatestFields { request_id } = call.fields()?;
    let keys = call.keys()?.or_fields(request_id.as_ref().map(ToString::to_string).as_deref(), None)?;
    let Some(request_id) = keys.request_id else {
        let state = gripper.handle.state();
        let id = state.last_command_id.ok_or_else(|| Problem::not_found("motion of this gripper yet"))?;
        let command = find(&call.gateway, &gripper, id, &wait).await?;
        return Ok(Json(CommandReport { number: Some(state.last_command), ..command }));
    };
    let found = gripper.handle.find_request(gripper.client.subject.clone(), request_id).await?;
    let mut ticket = found.ok_or_else(|| {
        Problem::not_found("command of this client with this request id: ids are kept for 10 minutes")
            .field("request_id")
    })?;
    Ok(Json(wait.until_ended(&mut ticket).await))
}

async fn cancel(call: Call<Leased>) -> Result<OrRunning<CommandReport>, Problem> {
    let gripper = call.gripper()?;
    let id = call.command_id()?;
    let wait = call.wait(DEFAULT_WAIT_MS)?;
    let Leased { lease } = call.fields()?;
    let gripper = gripper.with_lease(lease.as_deref())?;
    let ticket = gripper.handle.cancel(id, gripper.client).await?;
    let mut ticket = ticket
        .ok_or_else(|| Problem::not_found("command with this id on this gripper: commands are kept for an hour"))?;
    let command = wait.until_ended(&mut ticket).await;
    reply_with(&command, ticket)
}
