//! What clients are told of a gripper itself: its link, its FAST STOP, its newest state.

use std::sync::Arc;
use std::time::Instant;

use jiff::Timestamp;
use serde::{Deserialize, Serialize, Serializer};
use utoipa::ToSchema;

use super::{CommandId, FastStopId, Name, Reason};

/// How the link to the device is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, ToSchema, strum::Display)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum Link {
    /// Never yet connected.
    Connecting,
    /// Set up, and heard from.
    Connected,
    /// Up, but silent: motions are refused.
    Unresponsive,
    /// Lost, and being made again.
    Reconnecting,
}

/// Why a gripper is in FAST STOP.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, strum::IntoStaticStr, strum::VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum FastStopCause {
    /// A client of the gateway asked for it.
    Requested,
    /// The lease's holder was lost.
    ClientLost,
    /// The gateway's own connection ended unannounced.
    UnannouncedDisconnect,
    /// The temperature is critical (TEMP_FAULT).
    TemperatureFault,
    /// The power supply is outside its range (POWER_FAULT).
    PowerFault,
    /// The motor's thermal limit (CURR_FAULT).
    CurrentFault,
    /// A finger's fault (FINGER_FAULT).
    FingerFault,
    /// The fingers moved into a range that the soft limits forbid.
    SoftLimit,
    /// The device's flags don't say.
    Unknown,
}

/// A FAST STOP that holds until it is acknowledged by its id.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Latch {
    /// What an acknowledge has to name.
    pub id: FastStopId,
    /// Who asked for it; `device` where nobody here did.
    pub by: Arc<str>,
    /// Why, in the gateway's words.
    pub cause: FastStopCause,
    /// Why, in the client's words.
    pub reason: Reason,
    /// When it was asked for, or seen.
    pub at: Timestamp,
    /// Whether the device's flags showed it since.
    pub confirmed: bool,
}

/// The newest state of a gripper.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "link": "connected", "link_cause": null, "age_ms": 4, "seq": 51234, "state": "HOLDING",
    "state_code": 4, "flags": ["REFERENCED", "TARGET_POS_REACHED"], "flags_raw": 129, "referenced": true,
    "moving": false, "width_mm": 20.0, "speed_mm_s": 0.0, "force_n": 40.0, "temperature_c": 31.5,
    "fast_stop": false, "lease_holder": null, "lease_epoch": 0, "journal_cause": null, "command": null
}))]
pub struct State {
    /// The gripper's name.
    #[schema(value_type = String, max_length = 32)]
    pub gripper: Name,
    /// How the link to the device is.
    pub link: Link,
    /// Why it isn't connected; null while it is.
    #[schema(required)]
    pub link_cause: Option<String>,
    /// The age of the newest update; null before the first.
    #[serde(rename = "age_ms", serialize_with = "age_ms")]
    #[schema(value_type = Option<u64>, required, minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub updated_at: Option<Instant>,
    /// Counts the changes of this state.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub seq: u64,
    /// The gripper state, by the manual's noun; null before the first update.
    #[schema(required)]
    pub state: Option<&'static str>,
    /// The same, by its number.
    #[schema(required, minimum = 0, maximum = 255)]
    pub state_code: Option<u8>,
    /// The system state flags that are set.
    pub flags: Vec<&'static str>,
    /// All 32 of them as a number; null before the first update.
    #[schema(required, format = Int64, minimum = 0, maximum = 4_294_967_295_i64)]
    pub flags_raw: Option<u32>,
    /// Whether the fingers are referenced; null before the first update.
    #[schema(required)]
    pub referenced: Option<bool>,
    /// Whether the fingers are moving; null before the first update.
    #[schema(required)]
    pub moving: Option<bool>,
    /// The opening width in mm; null until referenced.
    #[schema(required, minimum = -1000, maximum = 1000)]
    pub width_mm: Option<f32>,
    /// The speed of the fingers relative to each other, in mm/s.
    #[schema(required, minimum = -10000, maximum = 10000)]
    pub speed_mm_s: Option<f32>,
    /// The gripping force in N, the sum over the fingers.
    #[schema(required, minimum = -10000, maximum = 10000)]
    pub force_n: Option<f32>,
    /// The device's temperature in °C; null where it has none to tell (fw2).
    #[schema(required, minimum = -3276.8, maximum = 3276.7)]
    pub temperature_c: Option<f32>,
    /// Whether a FAST STOP holds; null until the first connect.
    #[schema(required)]
    pub fast_stop: Option<bool>,
    /// The FAST STOP that holds; only while one does.
    #[serde(flatten)]
    #[schema(value_type = LatchFields)]
    pub latch: Option<LatchFields>,
    /// Who holds the lease; null while nobody does.
    #[schema(value_type = Option<String>, required)]
    pub lease_holder: Option<Arc<str>>,
    /// Counts the leases.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub lease_epoch: u64,
    /// Why nothing can be written down in the journal; null while it can.
    #[schema(required)]
    pub journal_cause: Option<String>,
    /// The running command's id; null while none runs.
    #[schema(value_type = Option<Uuid>, required)]
    pub command: Option<CommandId>,
}

impl State {
    /// Of a gripper that was not reached yet.
    #[must_use]
    pub fn unknown(gripper: Name) -> Self {
        Self {
            gripper,
            link: Link::Connecting,
            link_cause: None,
            updated_at: None,
            seq: 0,
            state: None,
            state_code: None,
            flags: Vec::new(),
            flags_raw: None,
            referenced: None,
            moving: None,
            width_mm: None,
            speed_mm_s: None,
            force_n: None,
            temperature_c: None,
            fast_stop: None,
            latch: None,
            lease_holder: None,
            lease_epoch: 0,
            journal_cause: None,
            command: None,
        }
    }
}

/// The measured values of a [`State`] alone.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Telemetry {
    /// The gripper's name.
    #[schema(value_type = String, max_length = 32)]
    pub gripper: Name,
    /// The state's.
    pub seq: u64,
    /// When the gateway had it.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// The opening width in mm; null until referenced.
    pub width_mm: Option<f32>,
    /// The speed of the fingers relative to each other, in mm/s.
    pub speed_mm_s: Option<f32>,
    /// The gripping force in N.
    pub force_n: Option<f32>,
    /// The gripper state, by the manual's noun.
    pub state: Option<&'static str>,
    /// All 32 system state flags as a number.
    pub flags_raw: Option<u32>,
}

impl State {
    /// Its measured values.
    #[must_use]
    pub fn telemetry(&self, at: Timestamp) -> Telemetry {
        Telemetry {
            gripper: self.gripper.clone(),
            seq: self.seq,
            at,
            width_mm: self.width_mm,
            speed_mm_s: self.speed_mm_s,
            force_n: self.force_n,
            state: self.state,
            flags_raw: self.flags_raw,
        }
    }
}

/// What a [`State`] has in addition while a FAST STOP holds.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LatchFields {
    /// What an acknowledge has to name.
    #[schema(value_type = Uuid, required = false)]
    pub fast_stop_id: FastStopId,
    /// Who asked for it; `device` where nobody here did.
    #[schema(value_type = String, required = false)]
    pub fast_stop_by: Arc<str>,
    /// Why, in the gateway's words.
    #[schema(required = false)]
    pub fast_stop_cause: FastStopCause,
    /// Why, in the client's words.
    #[schema(value_type = String, required = false, max_length = 64)]
    pub fast_stop_reason: Reason,
    /// When it was asked for, or seen.
    #[schema(value_type = String, required = false, format = DateTime)]
    pub fast_stop_at: Timestamp,
    /// Whether the device's flags showed it since.
    #[schema(required = false)]
    pub fast_stop_confirmed: bool,
    /// Counts the FAST STOPs: a later one has a higher number, whatever the clock says.
    #[serde(skip)]
    #[schema(ignore)]
    pub epoch: u64,
}

impl LatchFields {
    /// As clients are told of it.
    #[must_use]
    pub fn of(latch: &Latch, epoch: u64) -> Self {
        Self {
            epoch,
            fast_stop_id: latch.id,
            fast_stop_by: latch.by.clone(),
            fast_stop_cause: latch.cause,
            fast_stop_reason: latch.reason.clone(),
            fast_stop_at: latch.at,
            fast_stop_confirmed: latch.confirmed,
        }
    }
}

#[allow(clippy::ref_option, reason = "serde's signature")]
fn age_ms<S: Serializer>(updated_at: &Option<Instant>, serializer: S) -> Result<S::Ok, S::Error> {
    updated_at.map(|at| at.elapsed().as_millis() as u64).serialize(serializer)
}
