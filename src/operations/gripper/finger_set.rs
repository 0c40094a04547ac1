//! The finger set that is mounted on a gripper. The device does not know it, so a person or an MES names it.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::model::Name;
use crate::operations::calls::call::{Call, NoFields};
use crate::operations::calls::durable_changes::{check_journal, durable};
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::Json;
use crate::operations::parameters::values::{FingerSetText, Whole, part_id};
use crate::operations::problem::Problem;
use crate::wear::{FingerSet, MountRequest};

operations! {
    /// Get the finger set
    ///
    /// Returns the mounted finger set, and its use since it was mounted.
    GET = GET "/grippers/{gripper}/finger-set" as "finger-set" {
        run: get, id: "get_finger_set", tag: "grippers", problems: GRIPPER,
        answer: "The finger set",
    };

    /// Set the finger set
    ///
    /// Notes the mounted finger set and its maintenance limits. Nothing is sent to the device. With another id, counting
    /// starts from zero; with the same id only if `reset` is set.
    SET = PUT "/grippers/{gripper}/finger-set" as "finger-set.set" {
        run: set, id: "set_finger_set", tag: "grippers", problems: KNOWLEDGE,
        answer: "The finger set",
    };
}

/// Number of grips before a maintenance.
type Cycles = Whole<1, 1_000_000_000>;
/// Smallest and greatest distance before a maintenance, in m.
const MIN_TRAVEL_M: f64 = 0.001;
const MAX_TRAVEL_M: f64 = 1e9;

/// The finger set of a gripper. All fields except `gripper` are null if no finger set is known.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "id": "F-12", "mounted_at": "2026-11-21T09:00:00.250Z", "mounted_by": "http:127.0.0.1",
    "cycles": 1520, "travel_m": 91.4, "maintenance_cycles": 100_000, "maintenance_travel_m": null,
    "maintenance_due": false
}))]
pub struct FingerSetAnswer {
    /// The gripper's name.
    gripper: Name,
    /// Id of the finger set.
    #[schema(required, max_length = 48)]
    id: Option<String>,
    /// Time from which the use of the set is counted.
    #[serde(serialize_with = "crate::model::time::milliseconds_or_null")]
    #[schema(required)]
    mounted_at: Option<Timestamp>,
    /// Subject of the client that mounted the set or reset its counts.
    #[schema(required)]
    mounted_by: Option<String>,
    /// Number of grips since `mounted_at`, reference grips included, whatever their outcome.
    #[schema(required, minimum = 0)]
    cycles: Option<u64>,
    /// Distance that the fingers moved relative to each other since `mounted_at`, in m.
    #[schema(required, minimum = 0)]
    travel_m: Option<f64>,
    /// Number of grips after which the set needs maintenance; null without a limit.
    #[schema(required, minimum = 1, maximum = 1_000_000_000)]
    maintenance_cycles: Option<u64>,
    /// Distance after which the set needs maintenance, in m; null without a limit.
    #[schema(required, minimum = 0.001, maximum = 1_000_000_000)]
    maintenance_travel_m: Option<f64>,
    /// Whether `maintenance_cycles` or `maintenance_travel_m` is reached.
    #[schema(required)]
    maintenance_due: Option<bool>,
}

impl FingerSetAnswer {
    fn of(gripper: &Name, set: Option<&FingerSet>) -> Self {
        Self {
            gripper: gripper.clone(),
            id: set.map(|set| set.id.as_str().to_owned()),
            mounted_at: set.map(|set| set.mounted_at),
            mounted_by: set.map(|set| set.mounted_by.to_string()),
            cycles: set.map(|set| set.cycles),
            travel_m: set.map(|set| set.travel_mm.round() / 1000.0),
            maintenance_cycles: set.and_then(|set| set.maintenance_cycles),
            maintenance_travel_m: set.and_then(|set| set.maintenance_travel_m),
            maintenance_due: set.map(FingerSet::is_maintenance_due),
        }
    }
}

/// The finger set that is mounted, with its maintenance limits.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"id": "F-12", "maintenance_cycles": 100_000}))]
pub struct SetFingerSet {
    /// Id of the finger set: 1 to 48 bytes, or a whole number, which is stored as text.
    id: FingerSetText,
    /// Number of grips after which the set needs maintenance; unlimited if absent.
    maintenance_cycles: Option<Cycles>,
    /// Distance after which the set needs maintenance, in m; unlimited if absent.
    #[schema(minimum = 0.001, maximum = 1_000_000_000)]
    maintenance_travel_m: Option<f64>,
    /// Whether to count from zero although this set is already mounted, e.g. after maintenance.
    #[serde(default)]
    #[schema(default = false)]
    reset: bool,
}

fn get(call: &Call<NoFields>) -> Result<Json<FingerSetAnswer>, Problem> {
    let (gripper, NoFields {}) = call.gripper_and_fields()?;
    let name = gripper.handle.name();
    Ok(Json(FingerSetAnswer::of(name, call.gateway.wear.finger_set(name).as_ref())))
}

async fn set(call: Call<SetFingerSet>) -> Result<Json<FingerSetAnswer>, Problem> {
    let (gripper, SetFingerSet { id, maintenance_cycles, maintenance_travel_m, reset }) = call.gripper_and_fields()?;
    if let Some(travel_m) = maintenance_travel_m
        && !(MIN_TRAVEL_M..=MAX_TRAVEL_M).contains(&travel_m)
    {
        return Err(Problem::out_of_range("maintenance_travel_m", travel_m, MIN_TRAVEL_M, MAX_TRAVEL_M));
    }
    let mounted = MountRequest {
        id: part_id("id", &id.to_string())?,
        maintenance_cycles: maintenance_cycles.map(|cycles| cycles.checked("maintenance_cycles")).transpose()?,
        maintenance_travel_m,
        reset,
    };
    let name = gripper.handle.name();
    check_journal(&call, "the finger set was not changed")?;
    let (set, change) = call.gateway.wear.mount(name, mounted, &call.caller.client);
    durable(change).await?;
    Ok(Json(FingerSetAnswer::of(name, Some(&set))))
}
