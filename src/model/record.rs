//! Stored data of a gripper besides its events: measurements of motions, and state that outlives a restart.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Action, Code, CommandId, Kind, Name, Outcome, Parameters, PartId, RecipeFields, RequestId};

/// Result and measurements of a motion.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct GripRecord {
    /// Id of the command.
    pub id: CommandId,
    /// Name of the gateway. Absent from records of version 0.1.0.
    #[schema(required = false)]
    pub gateway: Name,
    /// Name of the gripper.
    pub gripper: Name,
    /// Serial number of the device; absent if it is unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false, format = Int64)]
    pub serial_number: Option<u32>,
    /// Kind of the command: `home`, `move`, `grip`, `reference` or `release`.
    pub kind: Kind,
    /// Name of the part; null if none was given.
    #[schema(required)]
    pub part_id: Option<PartId>,
    /// Result of the command.
    pub outcome: Outcome,
    /// Code of the problem that ended the motion as `BLOCKED`, `RANGE`, `TIMEOUT`, `FAILED` or `UNKNOWN`; otherwise
    /// absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub code: Option<Code>,
    /// Description of that problem and its remedy, for people.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub detail: Option<String>,
    /// Subject of the client that requested the command.
    pub subject: Arc<str>,
    #[serde(flatten)]
    pub requested: RequestedValues,
    /// Time of admission.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub started_at: Timestamp,
    /// Time from admission to end, in ms.
    #[schema(required)]
    pub duration_ms: Option<u64>,
    /// Opening width at the end, in mm.
    #[schema(required)]
    pub width_mm: Option<f32>,
    /// Gripping force at the end, in N.
    #[schema(required)]
    pub force_n: Option<f32>,
    /// Measured force with the greatest magnitude, in N.
    #[schema(required)]
    pub peak_force_n: Option<f32>,
    /// Distance that the fingers moved relative to each other, in mm. Absent from older records.
    #[schema(value_type = Option<f32>, nullable = false)]
    pub travel_mm: f32,
    /// Opening width at which the fingers met the part, in mm; only for a grip.
    #[schema(required)]
    pub contact_width_mm: Option<f32>,
    /// Time from the first sample to contact with the part, in ms; only for a grip.
    #[schema(required)]
    pub time_to_contact_ms: Option<u64>,
    /// Time at which the frame of the first sample arrived, in UTC with microseconds. Absent without samples, and from
    /// older records.
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "super::time::microseconds_or_null")]
    #[schema(nullable = false)]
    pub measured_at: Option<Timestamp>,
    /// Number of samples in the curve.
    pub samples: usize,
    /// Curve, stored and served separately from the record.
    #[serde(skip)]
    #[schema(ignore)]
    pub curve: Vec<Sample>,
}

/// Lease holder, request id and values of a request, copied into the records of its command. Values that do not apply
/// are absent.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct RequestedValues {
    /// Name of the lease holder, if the command was requested with the lease.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub holder: Option<Arc<str>>,
    /// Id that the client sent with the request, to repeat it safely.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub request_id: Option<RequestId>,
    /// Requested width in mm, or the requested offset of a relative move.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub requested_width_mm: Option<f32>,
    /// Requested speed in mm/s.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub requested_speed_mm_s: Option<f32>,
    /// Requested force limit in N.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub requested_force_n: Option<f32>,
    #[serde(flatten)]
    pub recipe: RecipeFields,
}

impl RequestedValues {
    #[must_use]
    pub fn of(action: &Action, request_id: Option<RequestId>) -> Self {
        Self { request_id, ..Self::from(&Parameters::from(action)) }
    }
}

impl From<&Parameters> for RequestedValues {
    fn from(parameters: &Parameters) -> Self {
        Self {
            holder: None,
            request_id: None,
            requested_width_mm: parameters.width_mm,
            requested_speed_mm_s: parameters.speed_mm_s,
            requested_force_n: parameters.force_n,
            recipe: parameters.recipe,
        }
    }
}

/// A point of a curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Sample {
    /// Time since the first sample, in ms.
    pub t_ms: u32,
    /// Opening width in mm.
    pub width_mm: f32,
    /// Speed of the fingers relative to each other, in mm/s.
    pub speed_mm_s: f32,
    /// Gripping force in N.
    pub force_n: f32,
}

/// State that outlives a restart of the gateway.
#[derive(Debug, Clone, PartialEq)]
pub struct PersistedState {
    /// Name of the gripper, webhook or gateway that the value belongs to.
    pub gripper: Name,
    pub key: PersistedKey,
    /// Value as JSON; `None` deletes the key.
    pub value: Option<String>,
}

/// Key of persisted state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PersistedKey {
    /// Settings made by clients, and the serial number of the device.
    Settings,
    /// The latched FAST STOP, or the epoch of the last one.
    Latch,
    /// Epoch and holder of the newest lease.
    Lease,
    /// Id of the grip that holds a part.
    Holding,
    /// Position of a webhook in the journal.
    Webhook,
    /// Number and result of the newest motion.
    LastCommand,
    /// Alarms that are active or not acknowledged, under the gateway's name.
    Alarms,
    /// Versions of the recipes, under the gateway's name.
    Recipes,
    /// Finger set, and drift of contact widths.
    Wear,
    /// Position of MQTT in the journal, under the gateway's name.
    Mqtt,
}

/// Treatment of motions while the journal cannot be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum OnJournalFailure {
    /// Motions are refused.
    #[default]
    Refuse,
    /// Motions continue without a durable record.
    Continue,
}
