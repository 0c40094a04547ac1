//! FAST STOP and its acknowledgement.
//!
//! A FAST STOP request always stops, even with invalid parameters: they only give a reason.

use serde::{Deserialize, Serialize};
use serde_json::json;
use tracing::Span;
use tracing::field::display;
use utoipa::openapi::schema::{ObjectBuilder, SchemaType};
use utoipa::openapi::{RefOr, Schema};
use utoipa::{PartialSchema, ToSchema};

use crate::access::Right;
use crate::gripper::FastStop;
use crate::model::{FastStopId, Reason, Urgency};
use crate::operations::calls::call::Call;
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::Json;
use crate::operations::parameters::values::LeaseField;
use crate::operations::problem::Problem;

operations! {
    /// FAST STOP a gripper
    ///
    /// Stops the gripper as fast as the device can and blocks all motion until the FAST STOP is acknowledged by its id.
    /// Needs no lease. The response comes once the device's flags confirm the FAST STOP, or after 250 ms, even when the
    /// link is down. The gateway repeats it until the device confirms it. FAST STOP is not a safety function in the
    /// sense of ISO 13850.
    ONE = POST "/grippers/{gripper}/fast-stop" as "fast-stop" {
        run: one, id: "fast_stop", tag: "fast stop", problems: FAST_STOP,
        answer: "The FAST STOP is latched",
    }.needs(Right::FastStop).urgent(Urgency::FastStop).despite_mistakes();

    /// FAST STOP all grippers
    ///
    /// Sends a FAST STOP to all grippers of this gateway at once. FAST STOP is not a safety function in the sense of
    /// ISO 13850.
    ALL = POST "/fast-stop" as "fast-stop" {
        run: all, id: "fast_stop_all", tag: "fast stop", problems: FAST_STOPS,
        answer: "All grippers are latched",
    }.needs(Right::FastStop).urgent(Urgency::FastStop).despite_mistakes();

    /// Acknowledge a FAST STOP or a fault
    ///
    /// Clears the FAST STOP with this id if it is the newest one and the device has confirmed it. Nothing moves.
    /// Without an id, acknowledges a fault of the device, such as the state `ERROR` or a fault flag, while no FAST STOP
    /// is latched. A request without an id needs the lease token if the gripper is leased.
    ACKNOWLEDGE = POST "/grippers/{gripper}/acknowledge" as "acknowledge" {
        run: acknowledge, id: "acknowledge", tag: "fast stop", problems: DEVICE,
        answer: "The FAST STOP is cleared, or the device accepted the acknowledgement",
    }.with_some_field();
}

/// Body of a FAST STOP request: an optional reason. The FAST STOP happens whatever the body, even if the body is empty
/// or invalid.
pub struct FastStopBody;

impl PartialSchema for FastStopBody {
    fn schema() -> RefOr<Schema> {
        let reason = ObjectBuilder::new().schema_type(SchemaType::AnyValue).description(Some(
            "Reason for the records. The first 64 bytes of a string are kept; other values are ignored.",
        ));
        ObjectBuilder::new()
            .schema_type(SchemaType::AnyValue)
            .description(Some(
                "Optional reason. The FAST STOP happens whatever the body; only a JSON object can give a reason.",
            ))
            .property("reason", reason)
            .examples([json!({"reason": "light curtain"})])
            .into()
    }
}

impl ToSchema for FastStopBody {}

/// Result of a FAST STOP of one gripper.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "fast_stop_confirmed": true
}))]
pub struct FastStopAnswer {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Id to name in the acknowledgement.
    fast_stop_id: FastStopId,
    /// Whether the device's flags showed the FAST STOP within 250 ms. If not, the gateway keeps repeating it.
    fast_stop_confirmed: bool,
}

/// Result of a FAST STOP of all grippers of this gateway.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "fast_stop_confirmed": false,
    "confirmed": ["left"], "unconfirmed": ["right"]
}))]
pub struct AllFastStopAnswer {
    /// Id to name in the acknowledgements: one for all grippers.
    fast_stop_id: FastStopId,
    /// Whether the flags of all grippers have shown the FAST STOP.
    fast_stop_confirmed: bool,
    /// Grippers whose flags have shown the FAST STOP.
    confirmed: Vec<String>,
    /// Grippers whose flags have not shown the FAST STOP yet. The gateway keeps repeating it to them.
    unconfirmed: Vec<String>,
}

/// Returns the reason of a FAST STOP, or an empty one if the parameters cannot be parsed.
pub(in crate::operations) fn reason<P>(call: &Call<P>) -> Reason {
    Reason::truncated(&call.lenient_text("reason").unwrap_or_default())
}

/// Adds the id of a FAST STOP to the log of its request.
pub(in crate::operations) fn log(id: FastStopId) {
    Span::current().record("fast_stop", display(id));
}

/// Splits grippers into confirmed and unconfirmed ones.
pub(in crate::operations) fn by_confirmation(stops: Vec<(impl ToString, bool)>) -> (Vec<String>, Vec<String>) {
    let mut confirmed = Vec::new();
    let mut unconfirmed = Vec::new();
    for (name, is_confirmed) in stops {
        let names = if is_confirmed { &mut confirmed } else { &mut unconfirmed };
        names.push(name.to_string());
    }
    (confirmed, unconfirmed)
}

async fn one(call: Call<FastStopBody>) -> Result<Json<FastStopAnswer>, Problem> {
    let gripper = call.gripper_despite_mistakes()?;
    let client = gripper.client.clone();
    let FastStop { id, confirmed } = gripper.handle.fast_stop(FastStopId::generate(), client, reason(&call)).await;
    log(id);
    Ok(Json(FastStopAnswer { gripper: gripper.name(), fast_stop_id: id, fast_stop_confirmed: confirmed }))
}

async fn all(call: Call<FastStopBody>) -> Result<Json<AllFastStopAnswer>, Problem> {
    let (id, stops) = call.gateway.grippers.fast_stop(&call.caller.client, &reason(&call)).await;
    log(id);
    let (confirmed, unconfirmed) = by_confirmation(stops);
    Ok(Json(AllFastStopAnswer {
        fast_stop_id: id,
        fast_stop_confirmed: unconfirmed.is_empty(),
        confirmed,
        unconfirmed,
    }))
}

/// The FAST STOP to acknowledge, or a fault of the device.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f"}))]
pub struct Acknowledge {
    /// Id of the FAST STOP, as in the gripper's state. Required while a FAST STOP is latched. Without an id, a fault of
    /// the device is acknowledged.
    #[schema(value_type = Option<uuid::Uuid>)]
    fast_stop_id: Option<String>,
    /// Lease token; the request renews the lease. Required without `fast_stop_id` if the gripper is leased. Empty means
    /// none.
    lease: Option<LeaseField>,
}

/// An acknowledged FAST STOP or fault.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "fast_stop": false
}))]
pub struct Acknowledged {
    /// The gripper's name.
    #[schema(max_length = 32)]
    gripper: String,
    /// Id of the acknowledged FAST STOP; null if the request named none.
    #[schema(required)]
    fast_stop_id: Option<FastStopId>,
    /// Whether a FAST STOP is latched: always false after an acknowledgement.
    fast_stop: bool,
}

async fn acknowledge(call: Call<Acknowledge>) -> Result<Json<Acknowledged>, Problem> {
    let (gripper, body): (_, Acknowledge) = call.gripper_and_fields()?;
    let id = body.fast_stop_id.map(parse_id).transpose()?;
    let gripper = gripper.with_lease(body.lease.as_deref())?;
    let client = gripper.client.clone();
    match id {
        Some(id) => gripper.handle.acknowledge(id, client).await?,
        None => gripper.handle.acknowledge_fault(client, gripper.token()).await?,
    }
    Ok(Json(Acknowledged { gripper: gripper.name(), fast_stop_id: id, fast_stop: false }))
}

fn parse_id(id: String) -> Result<FastStopId, Problem> {
    id.parse::<FastStopId>().map_err(|error| {
        let detail = format!("fast_stop_id is not a UUID: {error}");
        Problem::malformed("fast_stop_id", detail).value(Some(id.into()))
    })
}
