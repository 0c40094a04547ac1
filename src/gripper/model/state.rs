//! The state of a gripper: its link, its FAST STOP and its newest values.

use std::sync::Arc;
use std::time::Instant;

use jiff::Timestamp;
use serde::{Deserialize, Serialize, Serializer};
use utoipa::ToSchema;

use super::{CommandId, FastStopId, Fault, Name, Outcome, Reason};

/// Connection state of the device link.
///
/// - `connecting`: not connected yet since the gateway started
/// - `connected`: set up, and the device responds
/// - `unresponsive`: open, but the device is silent; motions are refused
/// - `reconnecting`: lost; the gateway is connecting or setting up again
/// - `released`: closed by a `disconnect` request; the gateway connects again after a `connect` request
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, ToSchema, strum::Display)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum Link {
    Connecting,
    Connected,
    Unresponsive,
    Reconnecting,
    Released,
}

/// Cause of a FAST STOP.
///
/// - `requested`: a client requested it
/// - `client_lost`: the lease holder was lost
/// - `unannounced_disconnect`: the gateway's own connection to the device ended without an announcement
/// - `temperature_fault`: the temperature is critical (`TEMP_FAULT`)
/// - `power_fault`: the supply voltage is out of range (`POWER_FAULT`)
/// - `current_fault`: the motor reached its thermal limit (`CURR_FAULT`)
/// - `finger_fault`: a finger reported a fault (`FINGER_FAULT`)
/// - `soft_limit`: the fingers moved into a range that the soft limits forbid
/// - `unknown`: the device is in FAST STOP, and its flags do not show why
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, strum::IntoStaticStr, strum::VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum FastStopCause {
    Requested,
    ClientLost,
    UnannouncedDisconnect,
    TemperatureFault,
    PowerFault,
    CurrentFault,
    FingerFault,
    SoftLimit,
    Unknown,
}

/// A FAST STOP that stays latched until it is acknowledged by its id.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Latch {
    /// Id that an acknowledgement has to name.
    pub id: FastStopId,
    /// Subject of the client that requested the FAST STOP, or `device` if no client did.
    pub by: Arc<str>,
    pub cause: FastStopCause,
    pub reason: Reason,
    /// Time at which the FAST STOP was requested or first seen.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub at: Timestamp,
    /// Whether the device's flags have shown the FAST STOP since.
    pub confirmed: bool,
}

/// Newest state of a gripper.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = GripperState, example = json!({
    "gripper": "left", "link": "connected", "link_cause": null, "age_ms": 4, "seq": 51234, "state": "HOLDING",
    "state_code": 4, "flags": ["REFERENCED", "TARGET_POS_REACHED"], "flags_raw": 129, "referenced": true,
    "moving": false, "width_mm": 20.0, "speed_mm_s": 0.0, "force_n": 40.0, "temperature_c": 31.5,
    "fault": false, "fault_code": 0, "fast_stop": false, "lease_holder": null, "reserved_for": null, "lease_epoch": 0, "journal_cause": null,
    "command_id": null, "command": null, "last_command": 17, "last_outcome_code": 2
}))]
pub struct State {
    /// Name of the gripper.
    #[schema(value_type = String, max_length = 32)]
    pub gripper: Name,
    /// Connection state of the device link.
    pub link: Link,
    /// Reason that the link is not connected; null while it is.
    #[schema(required)]
    pub link_cause: Option<String>,
    /// Age of the newest update from the device, in ms; null before the first update.
    #[serde(rename = "age_ms", serialize_with = "age_ms")]
    #[schema(value_type = Option<u64>, required, minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub updated_at: Option<Instant>,
    /// Number of changes to this state so far. A newer update with the same values does not count.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub seq: u64,
    /// Number of updates to this state so far, including those that changed only the age.
    #[serde(skip)]
    #[schema(ignore)]
    pub update: u64,
    /// Name of the gripper state, as in the manual; null before the first update. `state_code` lists all names.
    #[schema(required)]
    pub state: Option<&'static str>,
    /// Number of the gripper state; null before the first update.
    ///
    /// - 0 `IDLE`: waiting for a command
    /// - 1 `GRASPING`: the fingers are closing on a part
    /// - 2 `NO_PART`: the grip found no part; lasts until the next motion
    /// - 3 `PART_LOST`: a gripped part was lost; lasts until the next motion
    /// - 4 `HOLDING`: a part is held with the gripping force
    /// - 5 `RELEASING`: the fingers are opening to release a part
    /// - 6 `POSITIONING`: pre-positioning, or homing (firmware 4)
    /// - 7 `ERROR`: an error or a FAST STOP (firmware 4; reserved in firmware 2)
    /// - 8 and up `RESERVED`: not defined by the manuals
    #[schema(required, minimum = 0, maximum = 255)]
    pub state_code: Option<u8>,
    /// Names of the system state flags that are set.
    pub flags: Vec<&'static str>,
    /// All 32 system state flags as a number; null before the first update.
    #[schema(required, format = Int64, minimum = 0, maximum = 4_294_967_295_i64)]
    pub flags_raw: Option<u32>,
    /// Whether the fingers are referenced; null before the first update.
    #[schema(required)]
    pub referenced: Option<bool>,
    /// Whether the fingers are moving; null before the first update.
    #[schema(required)]
    pub moving: Option<bool>,
    /// Opening width in mm; null until the fingers are referenced.
    #[schema(required, minimum = -1000, maximum = 1000)]
    pub width_mm: Option<f32>,
    /// Speed of the fingers relative to each other, in mm/s.
    #[schema(required, minimum = -10000, maximum = 10000)]
    pub speed_mm_s: Option<f32>,
    /// Gripping force in N, summed over the fingers.
    #[schema(required, minimum = -10000, maximum = 10000)]
    pub force_n: Option<f32>,
    /// Temperature of the device in °C; null if the firmware does not report it (firmware 2).
    #[schema(required, minimum = -3276.8, maximum = 3276.7)]
    pub temperature_c: Option<f32>,
    /// Whether a person or a program has to do something before the next motion, such as acknowledging a FAST STOP.
    pub fault: bool,
    /// Number of the fault that matters most; 0 without a fault:
    ///
    /// - 1: the link is not connected
    /// - 2: the journal is unavailable, and motions are refused
    /// - 3: the device lost settings that could not be restored
    /// - 10 to 18: a FAST STOP is latched; its causes are, in this order, `requested`, `client_lost`,
    ///   `unannounced_disconnect`, `temperature_fault`, `power_fault`, `current_fault`, `finger_fault`, `soft_limit`,
    ///   `unknown`
    /// - 20 to 23: `TEMP_FAULT`, `POWER_FAULT`, `CURR_FAULT` or `FINGER_FAULT` is set
    /// - 30: the device reports an error (`ERROR`) that does not come from an acknowledged FAST STOP
    pub fault_code: u16,
    /// Whether a FAST STOP is latched; null until the first connection.
    #[schema(required)]
    pub fast_stop: Option<bool>,
    /// The latched FAST STOP; absent if `fast_stop` is not true.
    #[serde(flatten)]
    #[schema(value_type = LatchFields)]
    pub latch: Option<LatchFields>,
    /// Name of the lease holder; null while the lease is free.
    #[schema(value_type = Option<String>, required)]
    pub lease_holder: Option<Arc<str>>,
    /// Name of a lease holder that was lost while a part was held or a motion continued. Only this client or a
    /// supervisor can take the lease. Null if the gripper is not reserved.
    #[schema(value_type = Option<String>, required)]
    pub reserved_for: Option<Arc<str>>,
    /// Number of the newest lease.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub lease_epoch: u64,
    /// Reason that the journal is unavailable; null while it works.
    #[schema(required)]
    pub journal_cause: Option<String>,
    /// Id of the running command; null while none runs.
    #[schema(value_type = Option<Uuid>, required)]
    pub command_id: Option<CommandId>,
    /// Same as `command_id`.
    #[schema(value_type = Option<Uuid>, required, deprecated)]
    pub command: Option<CommandId>,
    /// Number of the newest motion, as in `number` of the command; 0 before the first. It survives restarts of the
    /// gateway, and 1 follows 4294967295.
    #[schema(format = Int64, minimum = 0, maximum = 4_294_967_295_i64)]
    pub last_command: u32,
    /// `outcome_code` of the newest motion; 0 while it runs, and before the first.
    #[serde(rename = "last_outcome_code", serialize_with = "outcome_code")]
    #[schema(value_type = u8, minimum = 0, maximum = 255)]
    pub last_outcome: Option<Outcome>,
    /// Id of the newest motion.
    #[serde(skip)]
    #[schema(ignore)]
    pub last_command_id: Option<CommandId>,
}

impl State {
    /// State of a gripper that has not been reached yet.
    #[must_use]
    pub fn unknown(gripper: Name) -> Self {
        Self {
            gripper,
            link: Link::Connecting,
            link_cause: None,
            updated_at: None,
            seq: 0,
            update: 0,
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
            fault: true,
            fault_code: Fault::LinkDown.code(),
            fast_stop: None,
            latch: None,
            lease_holder: None,
            reserved_for: None,
            lease_epoch: 0,
            journal_cause: None,
            command_id: None,
            command: None,
            last_command: 0,
            last_outcome: None,
            last_command_id: None,
        }
    }
}

impl State {
    /// Whether both states have the same values. Their ages can differ.
    #[must_use]
    pub fn is_like(&self, other: &Self) -> bool {
        let Self { updated_at, seq, update, .. } = *other;
        // Copying is cheap: a state has few strings, and they are short.
        Self { updated_at, seq, update, ..self.clone() } == *other
    }
}

/// Measured values of a `State`.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Telemetry {
    /// Name of the gripper.
    #[schema(value_type = String, max_length = 32)]
    pub gripper: Name,
    /// Sequence number of the state.
    pub seq: u64,
    /// Time at which the gateway published the values.
    #[serde(serialize_with = "super::time::milliseconds")]
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// Opening width in mm; null until the fingers are referenced.
    pub width_mm: Option<f32>,
    /// Speed of the fingers relative to each other, in mm/s.
    pub speed_mm_s: Option<f32>,
    /// Gripping force in N.
    pub force_n: Option<f32>,
    /// Name of the gripper state, as in the manual; `state_code` of the state lists all names.
    pub state: Option<&'static str>,
    /// All 32 system state flags as a number.
    pub flags_raw: Option<u32>,
}

impl State {
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

/// Additional fields of a `State` while a FAST STOP is latched.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LatchFields {
    /// Id that an acknowledgement has to name.
    #[schema(value_type = Uuid, required = false)]
    pub fast_stop_id: FastStopId,
    /// Subject of the client that requested the FAST STOP, or `device` if no client did.
    #[schema(value_type = String, required = false)]
    pub fast_stop_by: Arc<str>,
    /// Cause of the FAST STOP.
    #[schema(required = false)]
    pub fast_stop_cause: FastStopCause,
    /// Reason given by the client; may be empty.
    #[schema(value_type = String, required = false, max_length = 64)]
    pub fast_stop_reason: Reason,
    /// Time at which the FAST STOP was requested or first seen.
    #[serde(serialize_with = "super::time::milliseconds")]
    #[schema(value_type = String, required = false, format = DateTime)]
    pub fast_stop_at: Timestamp,
    /// Whether the device's flags have shown the FAST STOP since.
    #[schema(required = false)]
    pub fast_stop_confirmed: bool,
    /// Number of the FAST STOP. A later one has a higher number, whatever the clock says.
    #[serde(skip)]
    #[schema(ignore)]
    pub epoch: u64,
}

impl LatchFields {
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

#[allow(clippy::ref_option, clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn outcome_code<S: Serializer>(outcome: &Option<Outcome>, serializer: S) -> Result<S::Ok, S::Error> {
    outcome.map_or(0, Outcome::code).serialize(serializer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wsg::SystemState;

    /// Bytes of the largest state, as in the guide, with some room for further fields.
    const LARGEST_BYTES: usize = 1400;

    /// A state with all flags, and with values and texts of clients that are as long as possible.
    fn longest() -> State {
        let (name, id) = ("n".repeat(32), CommandId::generate());
        // A client of another gateway.
        let subject = format!("zenoh:{name}/http:2001:db8:1111:2222:3333:4444:5555:6666");
        let at = Timestamp::UNIX_EPOCH;
        let latch = LatchFields {
            fast_stop_id: FastStopId::generate(),
            fast_stop_by: subject.as_str().into(),
            fast_stop_cause: FastStopCause::UnannouncedDisconnect,
            fast_stop_reason: Reason::truncated(&"r".repeat(64)),
            fast_stop_at: at,
            fast_stop_confirmed: false,
            epoch: 1,
        };
        State {
            link: Link::Connected,
            updated_at: Some(Instant::now()),
            seq: 9_007_199_254_740_991,
            state: Some("POSITIONING"),
            state_code: Some(6),
            flags: SystemState::from_bits_retain(u32::MAX).names().collect(),
            flags_raw: Some(u32::MAX),
            referenced: Some(false),
            moving: Some(false),
            width_mm: Some(-109.123_45),
            speed_mm_s: Some(-419.123_45),
            force_n: Some(-119.123_45),
            temperature_c: Some(-10.5),
            fault_code: 18,
            fast_stop: Some(false),
            latch: Some(latch),
            lease_holder: Some(subject.into()),
            lease_epoch: 9_007_199_254_740_991,
            command_id: Some(id),
            command: Some(id),
            last_command: u32::MAX,
            last_outcome: Some(Outcome::Unknown),
            ..State::unknown(name.parse().unwrap())
        }
    }

    #[test]
    fn guide_gives_the_size_of_the_largest_state() {
        let size = serde_json::to_string(&longest()).unwrap().len();
        assert!((LARGEST_BYTES - 100..=LARGEST_BYTES).contains(&size), "{size} bytes");
        let guide = include_str!("../../../deploy/guide/plc.md");
        assert!(guide.contains(&format!("It has at most {LARGEST_BYTES} bytes")), "the guide lacks the size");
    }
}
