//! The state of a gripper: its link, its FAST STOP and its newest values.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize, Serializer};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::values::{MeasuredFields, Values};
use super::{CommandId, FastStopCause, FastStopId, Fault, Name, Outcome, Reason, ServoReport};
use crate::Now;

/// Connection state of the device link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, ToSchema, strum::Display, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
#[strum(serialize_all = "lowercase")]
pub enum Link {
    /// Not connected yet since the gateway started.
    Connecting,
    /// Set up, and the device responds.
    Connected,
    /// Open, but the device is silent; motions are refused.
    Unresponsive,
    /// Lost; the gateway is connecting or setting up again.
    Reconnecting,
    /// Closed by a `disconnect` request; the gateway connects again after a `connect` request.
    Released,
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
    "gripper": "left", "link": "connected", "link_cause": null, "age_ms": 4,
    "measured_at": "2026-11-29T10:30:00.123456Z", "state": "HOLDING", "state_code": 4, "flags": ["REFERENCED", "TARGET_POS_REACHED"], "flags_raw": 129, "referenced": true,
    "moving": false, "width_mm": 20.0, "speed_mm_s": 0.0, "force_n": 40.0, "temperature_c": 31.5,
    "stale": [], "seq": 51234, "fault": false, "fault_code": 0, "fast_stop": false, "lease_holder": null, "reserved_for": null, "lease_epoch": 0, "journal_cause": null,
    "command_id": null, "command": null, "last_command": 17, "last_outcome_code": 2
}))]
pub struct State {
    /// Name of the gripper.
    pub gripper: Name,
    /// Connection state of the device link.
    pub link: Link,
    /// Reason that the link is not connected; null while it is.
    #[schema(required)]
    pub link_cause: Option<String>,
    /// Values of the device, each with its age.
    #[serde(flatten)]
    #[schema(value_type = MeasuredFields)]
    pub values: Values,
    /// Number of changes to this state so far. A newer update with the same values does not count.
    pub seq: u64,
    /// Number of updates to this state so far, including those that changed only the age.
    #[serde(skip)]
    #[schema(ignore)]
    pub update: u64,
    /// Whether a person or a program has to do something before the next motion, such as acknowledging a FAST STOP.
    pub fault: bool,
    /// Number of the fault that matters most; 0 without a fault:
    ///
    /// - 1: the link is not connected
    /// - 2: the journal is unavailable, and motions are refused
    /// - 3: the device lost settings that could not be restored
    /// - 4: a value of the device is not known; `stale` names it
    /// - 10 to 18: a FAST STOP is latched; its causes are, in this order, `requested`, `client_lost`,
    ///   `unannounced_disconnect`, `temperature_fault`, `power_fault`, `current_fault`, `finger_fault`, `soft_limit`,
    ///   `unknown`
    /// - 20 to 23: `TEMP_FAULT`, `POWER_FAULT`, `CURR_FAULT` or `FINGER_FAULT` is set
    /// - 30: the device reports an error (`ERROR`) that does not come from an acknowledged FAST STOP
    pub fault_code: u16,
    /// Whether a FAST STOP is latched; null while no FAST STOP is latched and the flags of the device are unknown.
    #[schema(required)]
    pub fast_stop: Option<bool>,
    /// The latched FAST STOP; absent if `fast_stop` is not true.
    #[serde(flatten)]
    #[schema(value_type = LatchFields)]
    pub latch: Option<LatchFields>,
    /// Name of the lease holder; null while the lease is free.
    #[schema(required)]
    pub lease_holder: Option<Arc<str>>,
    /// Name of a lease holder that was lost while a part was held or a motion continued. Only this client or a
    /// supervisor can take the lease. Null if the gripper is not reserved.
    #[schema(required)]
    pub reserved_for: Option<Arc<str>>,
    /// Number of the newest lease.
    pub lease_epoch: u64,
    /// Reason that the journal is unavailable; null while it works.
    #[schema(required)]
    pub journal_cause: Option<String>,
    /// Id of the running command; null while none runs.
    #[schema(required)]
    pub command_id: Option<CommandId>,
    /// Same as `command_id`.
    #[schema(value_type = Option<uuid::Uuid>, required, deprecated)]
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
    /// The servo session that is open, or the last one; `None` before the first since the gateway started.
    #[serde(skip)]
    #[schema(ignore)]
    pub servo: Option<Arc<ServoReport>>,
}

impl State {
    /// State of a gripper that has not been reached yet.
    #[must_use]
    pub fn unknown(gripper: Name) -> Self {
        Self {
            gripper,
            link: Link::Connecting,
            link_cause: None,
            values: Values::default(),
            seq: 0,
            update: 0,
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
            servo: None,
        }
    }
}

impl State {
    /// Whether both states say the same. The times of their values can differ.
    #[must_use]
    pub fn is_like(&self, other: &Self) -> bool {
        let Self { values, seq, update, .. } = *other;
        // Copying is cheap: a state has few strings, and they are short.
        self.values.is_like(&values) && Self { values, seq, update, ..self.clone() } == *other
    }
}

/// Measured values of a `State`.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Telemetry {
    /// Name of the gripper.
    pub gripper: Name,
    /// Sequence number of the state.
    pub seq: u64,
    /// Time at which the gateway published the values.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub at: Timestamp,
    /// Time at which the newest frame arrived whose value is known, in UTC with microseconds; null while no value is
    /// known.
    #[serde(serialize_with = "super::time::microseconds_or_null")]
    #[schema(required)]
    pub measured_at: Option<Timestamp>,
    /// Opening width in mm; null while unknown, and until the fingers are referenced.
    pub width_mm: Option<f32>,
    /// Speed of the fingers relative to each other, in mm/s; null while unknown.
    pub speed_mm_s: Option<f32>,
    /// Gripping force in N; null while unknown.
    pub force_n: Option<f32>,
    /// Name of the gripper state, as in the manual; null while unknown. `state_code` of the state lists all names.
    pub state: Option<&'static str>,
    /// All 32 system state flags as a number; null while unknown.
    pub flags_raw: Option<u32>,
    /// The servo session; absent unless one is open.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub servo: Option<Arc<ServoReport>>,
}

impl State {
    /// The values that are known now.
    #[must_use]
    pub fn telemetry(&self, now: Now) -> Telemetry {
        let values = &self.values;
        Telemetry {
            gripper: self.gripper.clone(),
            seq: self.seq,
            at: now.wall,
            measured_at: values.measured_at(now.instant),
            width_mm: values.width_mm(now.instant),
            speed_mm_s: values.speed_mm_s(now.instant),
            force_n: values.force_n(now.instant),
            state: values.state_name(now.instant),
            flags_raw: values.flags(now.instant).map(|flags| flags.bits()),
            servo: self.servo.clone().filter(|servo| servo.open),
        }
    }
}

/// Additional fields of a `State` while a FAST STOP is latched.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LatchFields {
    /// Id that an acknowledgement has to name.
    #[schema(required = false)]
    pub fast_stop_id: FastStopId,
    /// Subject of the client that requested the FAST STOP, or `device` if no client did.
    #[schema(required = false)]
    pub fast_stop_by: Arc<str>,
    /// Cause of the FAST STOP.
    #[schema(required = false)]
    pub fast_stop_cause: FastStopCause,
    /// Reason given by the client; may be empty.
    #[schema(required = false)]
    pub fast_stop_reason: Reason,
    /// Time at which the FAST STOP was requested or first seen.
    #[serde(serialize_with = "super::time::milliseconds")]
    #[schema(required = false)]
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

#[allow(clippy::ref_option, clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn outcome_code<S: Serializer>(outcome: &Option<Outcome>, serializer: S) -> Result<S::Ok, S::Error> {
    outcome.map_or(0, Outcome::code).serialize(serializer)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::super::values::LinkClock;
    use super::*;
    use wsg::{Force, GripperState, Speed, SystemState, Temperature, Width};

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
            values: longest_values(),
            seq: 9_007_199_254_740_991,
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

    fn longest_values() -> Values {
        let now = crate::clock::instant();
        let good_for = Duration::from_mins(1);
        let clock = Some(LinkClock { instant: now, wall: Timestamp::UNIX_EPOCH });
        let mut values = Values { clock, ..Values::default() };
        values.flags.take(now, SystemState::from_bits_retain(u32::MAX), good_for);
        values.state.take(now, GripperState::Positioning, good_for);
        values.width.take(now, Width::new(-109.123_45).unwrap(), good_for);
        values.speed.take(now, Speed::new(-419.123_45).unwrap(), good_for);
        values.force.take(now, Force::new(-119.123_45).unwrap(), good_for);
        values.temperature.take(now, Temperature(-105), good_for);
        values
    }

    #[test]
    fn guide_gives_the_size_of_the_largest_state() {
        let size = serde_json::to_string(&longest()).unwrap().len();
        assert!((LARGEST_BYTES - 100..=LARGEST_BYTES).contains(&size), "{size} bytes");
        let guide = include_str!("../../deploy/guide/plc.md");
        assert!(guide.contains(&format!("It has at most {LARGEST_BYTES} bytes")), "the guide lacks the size");
    }
}
