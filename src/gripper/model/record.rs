//! What is kept of a gripper beside its events: the measurements of its motions, and what has to outlive a restart.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{CommandId, Kind, Name, Outcome, PartId};

/// What was measured during a motion, and what became of it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct GripRecord {
    /// The command's id.
    #[schema(value_type = uuid::Uuid)]
    pub id: CommandId,
    /// The gripper's name.
    #[schema(value_type = String, max_length = 32)]
    pub gripper: Name,
    /// `home`, `move`, `grip` or `release`.
    pub kind: Kind,
    /// The part's name.
    #[schema(value_type = Option<String>, required, max_length = 48)]
    pub part_id: Option<PartId>,
    /// How it ended.
    pub outcome: Outcome,
    /// Who asked.
    #[schema(value_type = String)]
    pub subject: Arc<str>,
    /// When it was admitted.
    #[schema(value_type = String, format = DateTime)]
    pub started_at: Timestamp,
    /// From its admission to its end.
    #[schema(required)]
    pub duration_ms: Option<u64>,
    /// The opening width at the end, in mm.
    #[schema(required)]
    pub width_mm: Option<f32>,
    /// The gripping force at the end, in N.
    #[schema(required)]
    pub force_n: Option<f32>,
    /// The greatest force that was measured, in N.
    #[schema(required)]
    pub peak_force_n: Option<f32>,
    /// The opening width where the fingers met the part, in mm.
    #[schema(required)]
    pub contact_width_mm: Option<f32>,
    /// From the first sample to that contact.
    #[schema(required)]
    pub time_to_contact_ms: Option<u64>,
    /// How many samples the curve has.
    pub samples: usize,
    /// The curve, which is kept and told beside the record.
    #[serde(skip)]
    #[schema(ignore)]
    pub curve: Vec<Sample>,
}

/// One point of a curve.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Sample {
    /// Since the first sample.
    pub t_ms: u32,
    /// The opening width in mm.
    pub width_mm: f32,
    /// The speed of the fingers relative to each other, in mm/s.
    pub speed_mm_s: f32,
    /// The gripping force in N.
    pub force_n: f32,
}

/// What has to outlive a restart of the gateway, by gripper and name.
#[derive(Debug, Clone, PartialEq)]
pub struct PersistedState {
    /// The gripper.
    pub gripper: Name,
    /// What it is.
    pub key: PersistedKey,
    /// Its value as JSON; none forgets it.
    pub value: Option<String>,
}

/// What can be remembered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PersistedKey {
    /// The settings that clients made, and on which device.
    Settings,
    /// The FAST STOP that holds.
    Latch,
    /// The newest lease's epoch and holder.
    Lease,
    /// The grip that holds a part.
    Holding,
}
