//! The grippers of all gateways on the Zenoh network, their FAST STOP and its acknowledgement.

use std::collections::BTreeSet;

use futures_util::StreamExt as _;
use futures_util::stream::iter;
use serde::{Deserialize, Serialize};
use serde_json::json;
use serde_json::value::{RawValue, to_raw_value};
use utoipa::ToSchema;

use super::calls::call::{Call, NoFields};
use super::calls::operation::operations;
use super::calls::reply::Json;
use super::gripper::fast_stop::{ACKNOWLEDGE as ACKNOWLEDGE_ONE, FastStopBody, by_confirmation, log, reason};
use super::problem::{Members, Problem};
use crate::access::Right;
use crate::fleet::{FleetGripper, FleetStop, NoAnswer, PeerRequest};
use crate::model::{Code, FastStopId, Name, Urgency};

operations! {
    /// List the fleet
    ///
    /// Lists all grippers of all gateways on the Zenoh network, including this gateway's own. A gateway that vanishes
    /// is marked `gone` within 2 s. Each gripper operation is also available below
    /// `/fleet/{gateway}/grippers/{gripper}/…`, with the same fields, responses and problems. The gateway that owns the
    /// gripper decides.
    ///
    /// `gateway_gone` means that nothing was sent to that gateway. `gateway_timeout` means that the outcome is unknown:
    /// repeat the request with the same `request_id`.
    LIST = GET "/fleet" as "fleet" {
        run: list, id: "fleet", tag: "fleet", problems: ANY,
        answer: "All grippers of all gateways",
    };

    /// FAST STOP the fleet
    ///
    /// Sends a FAST STOP to all grippers of all gateways. The response comes once all grippers of live gateways have
    /// confirmed it, or after 500 ms. FAST STOP is not a safety function in the sense of ISO 13850.
    FAST_STOP = POST "/fleet/fast-stop" as "fleet.fast-stop" {
        run: fast_stop, id: "fleet_fast_stop", tag: "fleet", problems: FAST_STOPS,
        answer: "The FAST STOP was sent to the fleet",
    }.needs(Right::FastStop).urgent(Urgency::FastStop).despite_mistakes();

    /// Acknowledge FAST STOPs of the fleet
    ///
    /// Acknowledges each gripper of any gateway whose latched FAST STOP is named. A gripper that cannot be acknowledged
    /// has a problem, and does not prevent the others. Acknowledging moves nothing.
    ACKNOWLEDGE = POST "/fleet/acknowledge" as "fleet.acknowledge" {
        run: acknowledge, id: "fleet_acknowledge", tag: "fleet", problems: COMMAND,
        answer: "The acknowledgements were sent",
    };
}

/// Most FAST STOPs that one request acknowledges.
const MAX_IDS: usize = 256;

/// Most grippers that are acknowledged at the same time.
const MAX_AT_ONCE: usize = 16;

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
    fast_stop_id: FastStopId,
    /// Whether all grippers have confirmed. `false` as well while this gateway is not connected to the Zenoh network as
    /// configured, or another gateway has not reported its grippers yet.
    fast_stop_confirmed: bool,
    /// Grippers whose flags have shown the FAST STOP, as gateway/gripper.
    confirmed: Vec<String>,
    /// Grippers that are not known to have stopped yet. Their gateways repeat the FAST STOP until it is confirmed. A
    /// gateway that comes back within a minute and has missed the FAST STOP is sent it again.
    unconfirmed: Vec<String>,
}

fn list(call: &Call<NoFields>) -> Result<Json<FleetList>, Problem> {
    let NoFields {} = call.fields()?;
    Ok(Json(FleetList { grippers: call.gateway.peers.grippers() }))
}

async fn fast_stop(call: Call<FastStopBody>) -> Result<Json<FleetFastStopAnswer>, Problem> {
    let FleetStop { id, stops, is_complete } = call.gateway.peers.fast_stop(&call.caller.client, &reason(&call)).await;
    log(id);
    let (confirmed, unconfirmed) = by_confirmation(stops);
    Ok(Json(FleetFastStopAnswer {
        fast_stop_id: id,
        fast_stop_confirmed: unconfirmed.is_empty() && is_complete,
        confirmed,
        unconfirmed,
    }))
}

/// The FAST STOPs to acknowledge.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"fast_stop_ids": ["019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f"]}))]
pub struct FleetAcknowledge {
    /// Ids of the FAST STOPs, as in the list of the fleet.
    #[schema(value_type = Vec<uuid::Uuid>, min_items = 1, max_items = 256)]
    fast_stop_ids: Vec<String>,
}

/// Result of an acknowledgement at all gateways.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"acknowledged": ["cell-7/left"], "failed": []}))]
pub struct FleetAcknowledged {
    /// Grippers whose FAST STOP was cleared, as gateway/gripper.
    acknowledged: Vec<String>,
    /// Grippers whose FAST STOP was not cleared.
    failed: Vec<FailedAcknowledge>,
}

/// A failed acknowledgement.
#[derive(Debug, Serialize, ToSchema)]
pub struct FailedAcknowledge {
    /// The gripper, as gateway/gripper.
    gripper: String,
    /// Reason for the failure.
    #[schema(value_type = Members)]
    problem: Box<RawValue>,
}

async fn acknowledge(call: Call<FleetAcknowledge>) -> Result<Json<FleetAcknowledged>, Problem> {
    let FleetAcknowledge { fast_stop_ids } = call.fields()?;
    if !(1..=MAX_IDS).contains(&fast_stop_ids.len()) {
        return Err(Problem::malformed("fast_stop_ids", format!("fast_stop_ids must have 1 to {MAX_IDS} ids")));
    }
    let ids: BTreeSet<String> = fast_stop_ids.iter().map(|id| normalized(id)).collect::<Result<_, _>>()?;
    let latched = call.gateway.peers.grippers().into_iter().filter_map(|gripper| {
        let id = gripper.fast_stop_id().filter(|id| ids.contains(&id.to_string()))?;
        Some((gripper.name(), id))
    });
    let acknowledged = iter(latched.collect::<Vec<_>>())
        .map(|((gateway, gripper), id)| {
            let call = &call;
            async move { (format!("{gateway}/{gripper}"), acknowledge_one(call, &gateway, &gripper, id).await) }
        })
        .buffered(MAX_AT_ONCE)
        .collect::<Vec<_>>()
        .await;
    let mut answer = FleetAcknowledged { acknowledged: Vec::new(), failed: Vec::new() };
    for (gripper, result) in acknowledged {
        match result {
            Ok(()) => answer.acknowledged.push(gripper),
            Err(problem) => answer.failed.push(FailedAcknowledge { gripper, problem }),
        }
    }
    Ok(Json(answer))
}

/// Returns a FAST STOP's id in the form in which the gateways write it.
fn normalized(id: &str) -> Result<String, Problem> {
    match id.parse::<FastStopId>() {
        Ok(id) => Ok(id.to_string()),
        Err(error) => {
            let detail = format!("fast_stop_ids has {id:?}, which is not a UUID: {error}");
            Err(Problem::malformed("fast_stop_ids", detail))
        }
    }
}

async fn acknowledge_one<P>(call: &Call<P>, gateway: &str, gripper: &str, id: FastStopId) -> Result<(), Box<RawValue>> {
    let client = call.caller.client.clone();
    let gateway: Name = gateway.parse().map_err(|_| no_gripper())?;
    let gripper: Name = gripper.parse().map_err(|_| no_gripper())?;
    if call.gateway.peers.is_own(&gateway) {
        let handle = call.gateway.grippers.get(&gripper).ok_or_else(no_gripper)?;
        return handle.acknowledge(id, client).await.map_err(|rejection| raw(&Problem::from(rejection)));
    }
    let ask = PeerRequest {
        gateway: gateway.clone(),
        gripper: Some(gripper),
        method: ACKNOWLEDGE_ONE.name,
        params: json!({"fast_stop_id": id}),
        wait: None,
        aside: Vec::new(),
        client,
        urgency: Urgency::None,
    };
    match call.gateway.peers.ask(ask).await {
        Ok(Ok(_)) => Ok(()),
        Ok(Err((_, problem))) => Err(problem),
        Err(why) => Err(raw(&no_answer(&gateway, why))),
    }
}

fn no_gripper() -> Box<RawValue> {
    raw(&Problem::not_found("gripper with this name"))
}

fn raw(problem: &Problem) -> Box<RawValue> {
    to_raw_value(problem.members()).unwrap_or_default()
}

/// The problem of a gateway that did not answer.
pub fn no_answer(gateway: &Name, why: NoAnswer) -> Problem {
    match why {
        NoAnswer::Unknown => Problem::not_found(format!("gateway {gateway} on the Zenoh network: /fleet lists all")),
        NoAnswer::Gone => {
            let detail = format!("gateway {gateway} is gone from the Zenoh network: nothing was sent to it");
            Problem::new(Code::GatewayGone, detail)
        }
        NoAnswer::TooMany => {
            Problem::new(Code::Overloaded, "too many requests to other gateways are in progress: try again later")
        }
        NoAnswer::TooLarge => {
            let detail = format!(
                "the answer of gateway {gateway} is too large to be collected beside those of others: ask for fewer \
                 records, or add the parameter gateway={gateway}"
            );
            Problem::new(Code::Overloaded, detail)
        }
        NoAnswer::None => {
            let detail = format!(
                "gateway {gateway} did not answer: the outcome is unknown. Check the gripper's state, or repeat the \
                 request with the same request_id, which moves nothing twice"
            );
            Problem::new(Code::GatewayTimeout, detail)
        }
    }
}
