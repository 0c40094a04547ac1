//! The alarms, and their acknowledgement.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::calls::call::{Call, NoFields};
use super::calls::operation::operations;
use super::calls::reply::Json;
use super::parameters::values::shortened;
use super::problem::Problem;
use crate::alarms::AlarmReport;
use crate::model::{Alarm, AlarmId};

operations! {
    /// List the alarms
    ///
    /// Lists the alarms of this gateway's grippers and of the gateway itself that are active, or that nobody has
    /// acknowledged. All clients share them, and they survive a restart. `GET /events?kind=alarm` has their history.
    LIST = GET "/alarms" as "alarms" {
        run: list, id: "alarms", tag: "alarms", problems: ANY,
        answer: "The alarms",
    };

    /// Acknowledge alarms
    ///
    /// Acknowledges the alarms with these ids: one, some, or all that the client has listed. An alarm that has ended is
    /// not listed any more; an active one stays listed until it ends.
    ///
    /// This changes nothing at the device, and clears no FAST STOP: `POST /grippers/{gripper}/acknowledge` does, and
    /// also acknowledges the alarm.
    ACKNOWLEDGE = POST "/alarms/acknowledge" as "alarms.acknowledge" {
        run: acknowledge, id: "acknowledge_alarms", tag: "alarms", problems: COMMAND,
        answer: "The alarms are acknowledged",
    };
}

/// Most alarms that one request acknowledges: all that can be listed.
const MAX_IDS: usize = 1024;

fn list(call: &Call<NoFields>) -> Result<Json<AlarmReport>, Problem> {
    let NoFields {} = call.fields()?;
    Ok(Json(call.gateway.alarms.read().1))
}

/// The alarms to acknowledge.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"ids": ["019aa5c8-5a71-7d02-8c11-5b6f0e2d9a34"]}))]
pub struct AcknowledgeAlarms {
    /// Ids of the alarms, as listed.
    #[schema(value_type = Vec<uuid::Uuid>, min_items = 1, max_items = 1024)]
    ids: Vec<String>,
}

/// Result of an acknowledgement of alarms.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"acknowledged": [], "unknown": ["019aa5c8-5a71-7d02-8c11-5b6f0e2d9a34"]}))]
pub struct AlarmsAcknowledged {
    /// The alarms after their acknowledgement. Those that have ended are not listed any more.
    acknowledged: Vec<Alarm>,
    /// Ids of no listed alarm: it was acknowledged before, or has occurred again with another id.
    unknown: Vec<AlarmId>,
}

fn acknowledge(call: &Call<AcknowledgeAlarms>) -> Result<Json<AlarmsAcknowledged>, Problem> {
    let AcknowledgeAlarms { ids } = call.fields()?;
    if !(1..=MAX_IDS).contains(&ids.len()) {
        return Err(Problem::malformed("ids", format!("ids must have 1 to {MAX_IDS} ids")));
    }
    let mut ids: BTreeSet<AlarmId> = ids.iter().map(|id| parse_id(id)).collect::<Result<_, _>>()?;
    let acknowledged = call.gateway.alarms.acknowledge(&ids, &call.caller.client);
    for alarm in &acknowledged {
        ids.remove(&alarm.id);
    }
    Ok(Json(AlarmsAcknowledged { acknowledged, unknown: ids.into_iter().collect() }))
}

fn parse_id(id: &str) -> Result<AlarmId, Problem> {
    id.parse::<AlarmId>().map_err(|error| {
        let id = shortened(id);
        Problem::malformed("ids", format!("ids has {id:?}, which is not a UUID: {error}"))
    })
}
