//! Raw requests in the device's protocol, given by id and bytes. Commands in the manuals take the typed path, with all
//! its checks.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::commands;
use crate::access::Right;
use crate::gripper::{FastStop, Handle, Rejection};
use crate::model::{Action, CommandId, CommandReport, FastStopId, Motion, Outcome, Phase, Reason};
use crate::operations::calls::call::Call;
use crate::operations::calls::caller::DEFAULT_WAIT_MS;
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::OrRunning;
use crate::operations::parameters::values::{LeaseField, RequestIdText, Whole, bytes};
use crate::operations::problem::Problem;
use crate::wsg::id::MAX_OPAQUE_BYTES;
use crate::wsg::{self, Status, Updates};

operations! {
    /// Send a raw request
    ///
    /// Ids from the manuals take the same path as the typed operations, with the same checks. 07h, 24h and automatic
    /// updates are reserved for the gateway and are refused.
    ///
    /// Other ids are custom commands. They count as motions and are recorded as motions, unless the configuration lists
    /// them in `read_ids`. Ids in `stream_ids` are motions that come many times a second: they skip the pause between
    /// motions, and the journal counts them each second instead of recording every one.
    RAW = POST "/grippers/{gripper}/raw" as "raw" {
        run: raw, id: "raw", tag: "device", problems: DEVICE,
        answer: "The device's reply",
    }.command().needs(Right::Supervise);
}

/// A raw request in the device's protocol.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"id": 83}))]
pub struct Raw {
    /// Command id.
    id: Byte,
    /// Parameters as hex: at most 4096 bytes.
    #[serde(default)]
    #[schema(default = "", max_length = 8192, pattern = "^([0-9a-fA-F]{2})*$")]
    payload: String,
    /// Whether to send exactly these bytes, valid or not, so that the device itself judges them. Possible for commands
    /// of the manuals that neither move nor stop, and have no automatic updates.
    #[serde(default)]
    #[schema(default = false)]
    exact: bool,
    /// Id that makes the request safe to repeat: for 10 minutes, the same id returns the same command. Only a Stop
    /// is sent again while the fingers move. At most 64 bytes, or a whole number, which is treated as text;
    /// empty means none.
    request_id: Option<RequestIdText>,
    lease: Option<LeaseField>,
}

type Byte = Whole<0, 255>;

/// The device's reply to a raw request.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "id": 49, "name": "GetAcceleration", "status": "E_SUCCESS", "status_code": 0,
    "payload": "00001643", "command_id": null, "outcome": null
}))]
pub struct RawAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Command id.
    #[schema(minimum = 0, maximum = 255)]
    id: u8,
    /// Name of the command in the manual; null for a custom command.
    #[schema(required)]
    name: Option<&'static str>,
    /// Symbol of the device's last status; null if the device sent none.
    #[schema(required)]
    status: Option<String>,
    /// The same status as a number.
    #[schema(required, minimum = 0, maximum = 65535)]
    status_code: Option<u16>,
    /// Data that came with the status, as hex.
    #[schema(max_length = 8192)]
    payload: String,
    /// Id of the resulting command; null if the request neither stops the fingers nor could move them.
    #[schema(required)]
    command_id: Option<CommandId>,
    /// Outcome of that command.
    #[schema(required)]
    outcome: Option<Outcome>,
    /// Id to name in the acknowledgement; only for a FAST STOP.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
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

/// The way in which a raw request is carried out.
enum RawPath {
    Command(Action),
    FastStop,
    Exchange(wsg::Command),
}

async fn raw(call: Call<Raw>) -> Result<OrRunning<RawAnswer>, Problem> {
    let gripper = call.gripper()?;
    let wait = call.wait(DEFAULT_WAIT_MS)?;
    let keys = call.keys()?;
    let body = call.fields()?;
    // At most 255, so the cast loses nothing.
    let id = body.id.checked("id")? as u8;
    let request_id = body.request_id.as_ref().map(ToString::to_string);
    let keys = keys.or_fields(request_id.as_deref(), body.lease.as_deref())?;
    let payload = bytes("payload", &body.payload, MAX_OPAQUE_BYTES)?;
    let command = if body.exact { verbatim(id, payload)? } else { parsed(id, &payload)? };
    let name = gripper.name();
    match path(command, &gripper.handle)? {
        RawPath::Command(action) => {
            let (command, ticket) = commands::submit(gripper, keys, action, &wait).await?;
            match command.phase {
                Phase::Done => of_command(id, command),
                Phase::Running => OrRunning::running(&command, ticket),
            }
        }
        RawPath::FastStop => {
            let FastStop { id: fast_stop_id, confirmed } =
                gripper.handle.fast_stop(FastStopId::generate(), gripper.client, Reason::truncated("raw")).await;
            let status = confirmed.then_some(Status::E_SUCCESS);
            let answer = RawAnswer { fast_stop_id: Some(fast_stop_id), ..RawAnswer::new(name, id, status) };
            OrRunning::ended(&answer)
        }
        RawPath::Exchange(command) => {
            let gripper = gripper.with_lease(body.lease.as_deref())?;
            let mut payload = Vec::new();
            let status = match gripper.exchange(command).await {
                Ok(data) => {
                    data.of_reply(id).write(&mut payload);
                    Status::E_SUCCESS
                }
                // The client asked for the device's own judgement.
                Err(Rejection::Device(refusal)) if body.exact => refusal.status,
                Err(rejection) => return Err(rejection.into()),
            };
            let payload = hex::encode(payload);
            let answer = RawAnswer { payload, ..RawAnswer::new(name, id, Some(status)) };
            OrRunning::ended(&answer)
        }
    }
}

fn parsed(id: u8, payload: &[u8]) -> Result<wsg::Command, Problem> {
    wsg::Command::parse(id, payload).map_err(|error| match error {
        wsg::InvalidRequest::Custom(..) => Problem::malformed("id", error.to_string()),
        _ => Problem::malformed("payload", error.to_string()),
    })
}

/// Returns a command with exactly this payload. A custom command has no other.
fn verbatim(id: u8, payload: Vec<u8>) -> Result<wsg::Command, Problem> {
    if wsg::id::describe(id).is_none() {
        return parsed(id, &payload);
    }
    let Some(command) = wsg::VerbatimCommand::new(id, payload) else {
        let detail = format!(
            "{id:02X}h cannot be sent with `exact`: it moves, stops, acknowledges, disconnects, or has automatic updates"
        );
        return Err(Problem::malformed("id", detail));
    };
    Ok(wsg::Command::Verbatim(command))
}

fn of_command(id: u8, command: CommandReport) -> Result<OrRunning<RawAnswer>, Problem> {
    let answer = RawAnswer {
        status: command.status,
        status_code: command.status_code,
        command_id: Some(command.id),
        outcome: command.outcome,
        payload: command.payload.as_deref().unwrap_or_default().to_owned(),
        ..RawAnswer::new(command.gripper.to_string(), id, None)
    };
    OrRunning::ended(&answer)
}

fn path(command: wsg::Command, gripper: &Handle) -> Result<RawPath, Problem> {
    use wsg::Command as C;
    if let Some(action) = Action::of(&command) {
        return Ok(RawPath::Command(action));
    }
    // An exchange would refuse commands that move or stop.
    Ok(match command {
        C::Custom(custom) if !gripper.only_reads(custom.id()) => {
            RawPath::Command(Action::Motion(Motion::Custom(custom)))
        }
        C::FastStop => RawPath::FastStop,
        C::DisconnectAnnouncement => {
            let detail = "07h would end the gateway's session: remove the gripper from the configuration instead";
            return Err(Problem::malformed("id", detail));
        }
        C::AcknowledgeFastStop => {
            let detail =
                "24h cannot name the FAST STOP that it acknowledges: POST its fast_stop_id to acknowledge instead";
            return Err(Problem::malformed("id", detail));
        }
        C::GetSystemState(Updates::On { .. })
        | C::GetGripperState(Updates::On { .. })
        | C::GetWidth(Updates::On { .. })
        | C::GetSpeed(Updates::On { .. })
        | C::GetForce(Updates::On { .. }) => {
            let detail = "the gateway controls automatic updates: GET state instead, or send payload 000000";
            return Err(Problem::malformed("payload", detail));
        }
        command => RawPath::Exchange(command),
    })
}
