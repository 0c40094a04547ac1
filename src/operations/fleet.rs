//! The grippers of all gateways on the Zenoh network, and their FAST STOP.

use http::Method as Verb;
use serde::Serialize;
use utoipa::ToSchema;

use super::call::{Call, NoFields};
use super::fast_stop::{by_confirmation, log, reason};
use super::operation::{Operation, Role, ready, reply};
use super::problem::Problem;
use super::reply::Json;
use crate::fleet::{FleetGripper, FleetStop};
use crate::gripper::model::{FastStopId, Urgency};

pub const LIST: Operation = Operation::read("fleet", "/fleet", |call| ready(list(&call)));
pub const FAST_STOP: Operation =
    Operation::change("fleet.fast-stop", &Verb::POST, "/fleet/fast-stop", |call| reply(fast_stop(call)))
        .needs(Role::Stop)
        .urgent(Urgency::FastStop);

/// The grippers of all gateways.
#[derive(Debug, Serialize, ToSchema)]
pub struct FleetList {
    /// The grippers, sorted by gateway and name.
    grippers: Vec<FleetGripper>,
}

/// Result of a FAST STOP of all gateways.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "fast_stop_confirmed": false,
    "confirmed": ["cell-7/left"], "unconfirmed": ["cell-8/left"]
}))]
pub struct FleetFastStopAnswer {
    /// Id to name in the acknowledgements of this gateway's own grippers. The fleet's list has the ids of the others.
    #[schema(value_type = uuid::Uuid)]
    fast_stop_id: FastStopId,
    /// Whether all grippers have confirmed.
    fast_stop_confirmed: bool,
    /// Grippers whose flags have shown the FAST STOP, as gateway/gripper.
    confirmed: Vec<String>,
    /// Grippers that are not known to have stopped yet. Their gateways repeat the FAST STOP until it is confirmed. A
    /// gateway that comes back within a minute and has missed the FAST STOP is sent it again.
    unconfirmed: Vec<String>,
}

fn list(call: &Call) -> Result<Json<FleetList>, Problem> {
    let NoFields {} = call.fields()?;
    Ok(Json(FleetList { grippers: call.gateway.peers.grippers() }))
}

async fn fast_stop(call: Call) -> Result<Json<FleetFastStopAnswer>, Problem> {
    let FleetStop { id, stops } = call.gateway.peers.fast_stop(&call.caller.client, &reason(&call)).await;
    log(id);
    let (confirmed, unconfirmed) = by_confirmation(stops);
    Ok(Json(FleetFastStopAnswer {
        fast_stop_id: id,
        fast_stop_confirmed: unconfirmed.is_empty(),
        confirmed,
        unconfirmed,
    }))
}
