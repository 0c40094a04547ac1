//! FAST STOP and its acknowledge.
//!
//! Whoever asks for a FAST STOP gets it, whatever the body says and however long it takes to come: the body is only a
//! reason. So these handlers read it themselves, within [`REASON_TIME`], and a client that is gone before has stopped
//! its gripper all the same.

use std::sync::Arc;
use std::time::Duration;

use axum::Json;
use axum::body::{Body as Stream, Bytes};
use axum::extract::{Request, State};
use http_body_util::{BodyExt, Limited};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::time::timeout;
use utoipa::openapi::schema::{ObjectBuilder, SchemaType};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use super::body::{self, Body, MAX_BODY_BYTES};
use super::errors::{Code, Problem};
use super::extract::{Asker, Gripper, GripperPath, LeaseHeader};
use super::responses::{AnyProblem, DeviceProblem, GripperProblem};
use super::{Context, watched};
use crate::gripper::FastStop;
use crate::gripper::model::{FastStopId, Reason};

/// How long a FAST STOP waits for its reason. A client's header and body come in one packet or in two right after each
/// other, so it is there already; if it isn't, stopping is worth more than knowing why.
pub const REASON_TIME: Duration = Duration::from_millis(20);

/// How long the rest of a body is read while the FAST STOP is on its way: no longer than that takes.
const REST_TIME: Duration = crate::gripper::handle::FAST_STOP_WAIT;

/// Why. Anything is taken, and stops: nothing, and what is no JSON, is no reason.
pub struct FastStopBody;

impl PartialSchema for FastStopBody {
    fn schema() -> RefOr<Schema> {
        let reason = ObjectBuilder::new().schema_type(SchemaType::AnyValue).description(Some(
            "Why, for the records. Of a text the first 64 bytes are kept; of anything else nothing.",
        ));
        ObjectBuilder::new()
            .schema_type(SchemaType::AnyValue)
            .description(Some("Anything is taken, and stops: what is no object, or no JSON, has no reason."))
            .property("reason", reason)
            .examples([json!({"reason": "light curtain"})])
            .into()
    }
}

impl ToSchema for FastStopBody {}

/// A gripper's FAST STOP.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "fast_stop_confirmed": true
}))]
pub struct FastStopAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// What an acknowledge has to name.
    #[schema(value_type = uuid::Uuid)]
    fast_stop_id: FastStopId,
    /// Whether the device's flags have shown it. Where they haven't within 250 ms, it is being repeated.
    fast_stop_confirmed: bool,
}

/// All grippers' FAST STOP.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "fast_stop_confirmed": false,
    "confirmed": ["left"], "unconfirmed": ["right"]
}))]
pub struct AllFastStopAnswer {
    /// What the acknowledges have to name: one id for all.
    #[schema(value_type = uuid::Uuid)]
    fast_stop_id: FastStopId,
    /// Whether the flags of all of them have shown it.
    fast_stop_confirmed: bool,
    /// The grippers whose flags have shown it.
    confirmed: Vec<String>,
    /// The grippers whose flags haven't yet: to them it is being repeated.
    unconfirmed: Vec<String>,
}

/// FAST STOP
///
/// Stops the fastest way, needs no lease, and holds until it is acknowledged by its id: no motion until then. Answers
/// once the device's flags show it, or after 250 ms, also when the link is down; it is repeated until they do. It is
/// not a safety function in the sense of ISO 13850.
#[utoipa::path(
    post, path = "/grippers/{gripper}/fast-stop", operation_id = "fast_stop", tag = "fast stop",
    params(GripperPath),
    request_body = Option<FastStopBody>,
    responses((status = 200, description = "It is latched", body = FastStopAnswer), GripperProblem)
)]
pub async fn one(gripper: Gripper, request: Request) -> Result<Json<FastStopAnswer>, Problem> {
    let name = gripper.name();
    let stop =
        |reason| async move { gripper.handle.fast_stop(FastStopId::generate(), gripper.client.clone(), reason).await };
    let FastStop { id, confirmed } = with_reason(request, stop).await?;
    watched::note_fast_stop(id);
    Ok(Json(FastStopAnswer { gripper: name, fast_stop_id: id, fast_stop_confirmed: confirmed }))
}

/// FAST STOP of all grippers
///
/// The same for all grippers of this gateway at once.
#[utoipa::path(
    post, path = "/fast-stop", operation_id = "fast_stop_all", tag = "fast stop",
    request_body = Option<FastStopBody>,
    responses((status = 200, description = "All are latched", body = AllFastStopAnswer), AnyProblem)
)]
pub async fn all(
    State(context): State<Arc<Context>>,
    Asker(client): Asker,
    request: Request,
) -> Result<Json<AllFastStopAnswer>, Problem> {
    let stop = |reason| async move { context.fleet.fast_stop(&client, &reason).await };
    let (id, stops) = with_reason(request, stop).await?;
    watched::note_fast_stop(id);
    let (confirmed, unconfirmed): (Vec<_>, Vec<_>) = stops.into_iter().partition(|(_, confirmed)| *confirmed);
    let names = |stops: Vec<(_, bool)>| stops.into_iter().map(|(name, _)| ToString::to_string(&name)).collect();
    Ok(Json(AllFastStopAnswer {
        fast_stop_id: id,
        fast_stop_confirmed: unconfirmed.is_empty(),
        confirmed: names(confirmed),
        unconfirmed: names(unconfirmed),
    }))
}

/// Stops with the body's reason, if there is one by now. What is left of the body is read meanwhile, so that the
/// client sees its answer. On a task of its own, since a handler ends with its client's connection.
pub async fn with_reason<T, S, F>(request: Request, stop: S) -> Result<T, Problem>
where
    T: Send + 'static,
    S: FnOnce(Reason) -> F + Send + 'static,
    F: Future<Output = T> + Send,
{
    let stopping = tokio::spawn(async move {
        let mut stream = request.into_body();
        let reason = reason(&mut stream).await;
        let (stopped, _) = tokio::join!(stop(reason), timeout(REST_TIME, body::drain(stream)));
        stopped
    });
    stopping.await.map_err(|error| Problem::new(Code::Internal, format!("the FAST STOP was not answered: {error}")))
}

async fn reason(stream: &mut Stream) -> Reason {
    let bytes = match timeout(REASON_TIME, Limited::new(stream, MAX_BODY_BYTES).collect()).await {
        Ok(Ok(collected)) => collected.to_bytes(),
        _ => Bytes::new(),
    };
    let body: Value = serde_json::from_slice(&bytes).unwrap_or_default();
    Reason::truncated(body.get("reason").and_then(Value::as_str).unwrap_or_default())
}

/// What is acknowledged.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f"}))]
pub struct Acknowledge {
    /// The FAST STOP's id, as the state tells it.
    #[schema(value_type = uuid::Uuid)]
    fast_stop_id: String,
    /// The lease's token, which is used by this as by any request; empty is none.
    #[schema(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    lease: Option<String>,
}

/// An acknowledged FAST STOP.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "fast_stop": false
}))]
pub struct Acknowledged {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// What was acknowledged.
    #[schema(value_type = uuid::Uuid)]
    fast_stop_id: FastStopId,
    /// Whether a FAST STOP holds: no longer.
    fast_stop: bool,
}

/// Acknowledge a FAST STOP
///
/// Clears the FAST STOP of this id, if it is the newest, and confirmed by the device. Nothing moves.
#[utoipa::path(
    post, path = "/grippers/{gripper}/acknowledge", operation_id = "acknowledge", tag = "fast stop",
    params(GripperPath, LeaseHeader),
    request_body = Acknowledge,
    responses((status = 200, description = "The device's flags show that it is gone", body = Acknowledged), DeviceProblem)
)]
pub async fn acknowledge(gripper: Gripper, Body(body): Body<Acknowledge>) -> Result<Json<Acknowledged>, Problem> {
    let id: FastStopId = body.fast_stop_id.parse().map_err(|error| {
        Problem::malformed("fast_stop_id", format!("fast_stop_id is no UUID: {error}"))
            .value(Some(body.fast_stop_id.clone().into()))
    })?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    gripper.handle.acknowledge(id, gripper.client.clone()).await?;
    Ok(Json(Acknowledged { gripper: gripper.name(), fast_stop_id: id, fast_stop: false }))
}
