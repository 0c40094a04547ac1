//! A request of the protocol, by its id and bytes. What the manuals know takes the typed path, with all its checks.

use axum::Json;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::body::Body;
use super::commands::{self, Wait};
use super::errors::Problem;
use super::extract::{Gripper, GripperPath, KeyHeaders, Keys, WaitQuery};
use super::responses::DeviceProblem;
use super::values::{bytes, integer};
use crate::gripper::model::{Action, Command, CommandId, FastStopId, Motion, Outcome, Phase, Reason};
use crate::gripper::{FastStop, Handle};
use crate::wsg::id::MAX_OPAQUE_BYTES;
use crate::wsg::{self, Status, Updates};

/// A request of the protocol.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"id": 83}))]
pub struct Raw {
    /// The command's id.
    #[schema(value_type = u8, minimum = 0, maximum = 255)]
    id: f64,
    /// Its parameters as hex: at most 4096 bytes.
    #[serde(default)]
    #[schema(default = "", max_length = 8192, pattern = "^([0-9a-fA-F]{2})*$")]
    payload: String,
    /// Makes a motion safe to repeat: the same id gives the same command for 10 minutes. At most 64 bytes; empty
    /// is none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    request_id: Option<String>,
    /// The lease's token of at most 64 bytes, while somebody holds one; empty is none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    lease: Option<String>,
}

/// The device's answer to it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "id": 49, "name": "GetAcceleration", "status": "E_SUCCESS", "status_code": 0,
    "payload": "00001643", "command_id": null, "outcome": null
}))]
pub struct RawAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// The command's id.
    #[schema(minimum = 0, maximum = 255)]
    id: u8,
    /// The manual's name for it; null for a custom command.
    #[schema(required)]
    name: Option<&'static str>,
    /// The device's last status, by its symbol; null where it gave none.
    #[schema(required)]
    status: Option<String>,
    /// The same, by its number.
    #[schema(required, minimum = 0, maximum = 65535)]
    status_code: Option<u16>,
    /// What came with the status, as hex.
    #[schema(max_length = 8192)]
    payload: String,
    /// The command that it became; null unless it moves the fingers, may move them, or stops them.
    #[schema(value_type = Option<uuid::Uuid>, required)]
    command_id: Option<CommandId>,
    /// How that ended.
    #[schema(required)]
    outcome: Option<Outcome>,
    /// What an acknowledge has to name; only of a FAST STOP.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<uuid::Uuid>, nullable = false)]
    fast_stop_id: Option<FastStopId>,
}

impl RawAnswer {
    fn new(gripper: String, id: u8, status: Option<Status>) -> Self {
        Self {
            gripper,
            id,
            name: wsg::id::name(id),
            status: status.map(|status| status.to_string()),
            status_code: status.map(Status::code),
            payload: String::new(),
            command_id: None,
            outcome: None,
            fast_stop_id: None,
        }
    }
}

/// What becomes of a request.
enum Path {
    Command(Action),
    FastStop,
    Exchange(wsg::Command),
}

/// A raw request
///
/// Ids that the manuals know take the same path as the other operations, with the same checks; 07h, 24h and automatic
/// updates are the gateway's own, and refused. Other ids are custom commands: they count as motions, and are written
/// down as such, unless the configuration has them among its `read_ids`. Those among its `stream_ids` are motions that
/// come many times a second: they wait for no pause, and are counted in the journal by the second.
#[utoipa::path(
    post, path = "/grippers/{gripper}/raw", operation_id = "raw", tag = "device",
    params(GripperPath, WaitQuery, KeyHeaders),
    request_body = Raw,
    responses(
        (status = 200, description = "The device's answer", body = RawAnswer),
        (status = 202, description = "The command, still running after `wait_ms`", body = Command,
            headers(("Location" = String, description = "Where to ask for it"))),
        DeviceProblem,
    )
)]
pub async fn raw(gripper: Gripper, wait: Wait, keys: Keys, Body(body): Body<Raw>) -> Result<Response, Problem> {
    // At most 255, so nothing is lost.
    let id = integer("id", body.id, 0..=u64::from(u8::MAX))? as u8;
    let keys = keys.or_body(body.request_id.as_deref(), body.lease.as_deref())?;
    let payload = bytes("payload", &body.payload, MAX_OPAQUE_BYTES)?;
    let command = wsg::Command::parse(id, &payload).map_err(|error| match error {
        wsg::InvalidRequest::Custom(..) => Problem::malformed("id", error.to_string()),
        _ => Problem::malformed("payload", error.to_string()),
    })?;
    let name = gripper.name();
    match path(command, &gripper.handle)? {
        Path::Command(action) => {
            let (command, ticket) = commands::run(gripper, keys, action, wait).await?;
            let has_ended = command.phase == Phase::Done;
            Ok(if has_ended { of_command(id, command) } else { commands::told((command, ticket)) })
        }
        Path::FastStop => {
            let FastStop { id: fast_stop_id, confirmed } =
                gripper.handle.fast_stop(FastStopId::generate(), gripper.client, Reason::truncated("raw")).await;
            let status = confirmed.then_some(Status::E_SUCCESS);
            let answer = RawAnswer { fast_stop_id: Some(fast_stop_id), ..RawAnswer::new(name, id, status) };
            Ok(Json(answer).into_response())
        }
        Path::Exchange(command) => {
            let gripper = gripper.with_lease(body.lease.as_deref())?;
            let mut payload = Vec::new();
            gripper.exchange(command).await?.of_reply(id).write(&mut payload);
            let payload = hex::encode(payload);
            Ok(Json(RawAnswer { payload, ..RawAnswer::new(name, id, Some(Status::E_SUCCESS)) }).into_response())
        }
    }
}

fn of_command(id: u8, command: Command) -> Response {
    let answer = RawAnswer {
        status: command.status,
        status_code: command.status_code,
        command_id: Some(command.id),
        outcome: command.outcome,
        payload: command.payload.as_deref().unwrap_or_default().to_owned(),
        ..RawAnswer::new(command.gripper.to_string(), id, None)
    };
    Json(answer).into_response()
}

fn path(command: wsg::Command, gripper: &Handle) -> Result<Path, Problem> {
    use wsg::Command as C;
    if let Some(action) = Action::of(&command) {
        return Ok(Path::Command(action));
    }
    // What moves or stops would be refused on the path of exchanges.
    Ok(match command {
        C::Custom(custom) if !gripper.only_reads(custom.id()) => Path::Command(Action::Motion(Motion::Custom(custom))),
        C::FastStop => Path::FastStop,
        C::DisconnectAnnouncement => {
            let detail = "07h would end the gateway's own session: leave the gripper out of its configuration instead";
            return Err(Problem::malformed("id", detail));
        }
        C::AcknowledgeFastStop => {
            let detail = "24h can't say which FAST STOP it means: POST to acknowledge with its fast_stop_id instead";
            return Err(Problem::malformed("id", detail));
        }
        C::GetSystemState(Updates::On { .. })
        | C::GetGripperState(Updates::On { .. })
        | C::GetWidth(Updates::On { .. })
        | C::GetSpeed(Updates::On { .. })
        | C::GetForce(Updates::On { .. }) => {
            let detail = "automatic updates are the gateway's own: GET state instead, or send 000000";
            return Err(Problem::malformed("payload", detail));
        }
        command => Path::Exchange(command),
    })
}
