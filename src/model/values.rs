//! The measured values of a gripper. Everything that shows or uses one takes it from here, at a time.

use std::time::Instant;

use jiff::Timestamp;
use serde::{Serialize, Serializer};
use utoipa::ToSchema;

use super::measured::{Measured, Missing};
use wsg::{Force, GripperState, Speed, SystemState, Temperature, Width, id};

/// The newest values of a device.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Values {
    /// The system state flags (40h).
    pub flags: Measured<SystemState>,
    /// The gripper state (41h).
    pub state: Measured<GripperState>,
    /// The opening width (43h). Not expected before the fingers are referenced (`fw4-en 3.4.4`).
    pub width: Measured<Width>,
    /// The speed (44h).
    pub speed: Measured<Speed>,
    /// The gripping force (45h).
    pub force: Measured<Force>,
    /// The temperature (46h), which is polled. Not expected from firmware 2.
    pub temperature: Measured<Temperature>,
    /// Clock of the connection; `None` before the first.
    pub clock: Option<LinkClock>,
    /// Time at which the device last answered a request that can have changed its values; `None` before the first.
    pub changed_at: Option<Instant>,
}

/// Wall clock of one connection. It counts with the monotonic clock, so a step of the machine's clock moves no time of
/// measurement backwards.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LinkClock {
    /// Beginning of the connection.
    pub instant: Instant,
    /// The same time by the wall clock.
    pub wall: Timestamp,
}

impl LinkClock {
    /// Wall clock time of `instant`.
    #[must_use]
    pub fn time_of(self, instant: Instant) -> Timestamp {
        let since = match instant.checked_duration_since(self.instant) {
            Some(since) => self.wall.checked_add(since),
            None => self.wall.checked_sub(self.instant.duration_since(instant)),
        };
        since.unwrap_or(self.wall)
    }
}

/// The facts that are known of one value, whatever its type.
#[derive(Debug, Clone, Copy)]
struct Known {
    /// Name of the value, that of its field in JSON.
    name: &'static str,
    arrived_at: Option<Instant>,
    missing: Option<Missing>,
}

impl Known {
    fn of<T: Copy + PartialEq>(name: &'static str, value: &Measured<T>, now: Instant) -> Self {
        let arrived_at = value.at(now).and_then(|_| value.arrived_at());
        Self { name, arrived_at, missing: value.missing(now) }
    }
}

/// Name of the flags in `stale`.
pub const FLAGS: &str = "flags";

impl Values {
    /// The flags, unless they are unknown.
    #[must_use]
    pub fn flags(&self, now: Instant) -> Option<SystemState> {
        self.flags.at(now)
    }

    /// Names of the flags that are set, unless they are unknown.
    #[must_use]
    pub fn flag_names(&self, now: Instant) -> Option<Vec<&'static str>> {
        self.flags(now).map(|flags| flags.names().collect())
    }

    #[must_use]
    pub fn state_name(&self, now: Instant) -> Option<&'static str> {
        self.state(now).map(GripperState::name)
    }

    #[must_use]
    pub fn has(&self, flag: SystemState, now: Instant) -> Option<bool> {
        self.flags(now).map(|flags| flags.contains(flag))
    }

    #[must_use]
    pub fn state(&self, now: Instant) -> Option<GripperState> {
        self.state.at(now)
    }

    /// Whether the device reports a held part.
    #[must_use]
    pub fn is_holding(&self, now: Instant) -> bool {
        self.state(now) == Some(GripperState::Holding)
    }

    #[must_use]
    pub fn state_code(&self, now: Instant) -> Option<u8> {
        self.state(now).map(GripperState::code)
    }

    #[must_use]
    pub fn width_mm(&self, now: Instant) -> Option<f32> {
        self.width.at(now).map(Width::mm)
    }

    #[must_use]
    pub fn speed_mm_s(&self, now: Instant) -> Option<f32> {
        self.speed.at(now).map(Speed::mm_s)
    }

    #[must_use]
    pub fn force_n(&self, now: Instant) -> Option<f32> {
        self.force.at(now).map(Force::n)
    }

    #[must_use]
    pub fn temperature_c(&self, now: Instant) -> Option<f32> {
        self.temperature.at(now).map(Temperature::celsius)
    }

    /// Whether the newest value of a getter with automatic updates arrived after `then`, so that it was measured after
    /// a change that was answered then.
    #[must_use]
    pub fn is_newer_than(&self, id: u8, then: Instant) -> bool {
        let arrived_at = match id {
            id::GET_SYSTEM_STATE => self.flags.arrived_at(),
            id::GET_GRIPPER_STATE => self.state.arrived_at(),
            id::GET_WIDTH => self.width.arrived_at(),
            id::GET_SPEED => self.speed.arrived_at(),
            id::GET_FORCE => self.force.arrived_at(),
            _ => None,
        };
        arrived_at > Some(then)
    }

    /// Names of the values that should be known and are not, each with the reason.
    pub fn missing(&self, now: Instant) -> impl Iterator<Item = (&'static str, Missing)> {
        self.all(now).into_iter().filter_map(|known| Some((known.name, known.missing?)))
    }

    /// Whether the value with this name is known.
    #[must_use]
    pub fn is_known(&self, name: &str, now: Instant) -> bool {
        self.all(now).iter().any(|known| known.name == name && known.arrived_at.is_some())
    }

    /// Names of the values that should be known and are not.
    pub fn stale(&self, now: Instant) -> impl Iterator<Item = &'static str> {
        self.missing(now).map(|(name, _)| name)
    }

    /// Arrival of the newest frame whose value is known. The temperature does not count, because it is polled.
    #[must_use]
    pub fn newest(&self, now: Instant) -> Option<Instant> {
        self.updated(now).into_iter().filter_map(|known| known.arrived_at).max()
    }

    /// Arrival of the oldest frame whose value is known. The temperature does not count, because it is polled.
    #[must_use]
    pub fn oldest(&self, now: Instant) -> Option<Instant> {
        self.updated(now).into_iter().filter_map(|known| known.arrived_at).min()
    }

    /// Wall clock time at which the newest frame arrived whose value is known.
    #[must_use]
    pub fn measured_at(&self, now: Instant) -> Option<Timestamp> {
        Some(self.clock?.time_of(self.newest(now)?))
    }

    /// Time at which the next value becomes unknown without a further frame.
    #[must_use]
    pub fn ends_at(&self) -> Option<Instant> {
        let Self { flags, state, width, speed, force, temperature, .. } = self;
        let ends = [flags.ends_at(), state.ends_at(), width.ends_at(), speed.ends_at(), force.ends_at()];
        ends.into_iter().chain([temperature.ends_at()]).flatten().min()
    }

    /// Marks the values as missing that have not been renewed in time.
    pub fn expire(&mut self, now: Instant) {
        self.flags.expire(now);
        self.state.expire(now);
        self.width.expire(now);
        self.speed.expire(now);
        self.force.expire(now);
        self.temperature.expire(now);
    }

    /// Notes that the link is down, so that the device cannot report anything.
    pub fn forget(&mut self) {
        self.flags.forget();
        self.state.forget();
        self.width.forget();
        self.speed.forget();
        self.force.forget();
        self.temperature.forget();
    }

    /// Whether both have the same values. Their times can differ.
    #[must_use]
    pub fn is_like(&self, other: &Self) -> bool {
        self.flags.is_like(&other.flags)
            && self.state.is_like(&other.state)
            && self.width.is_like(&other.width)
            && self.speed.is_like(&other.speed)
            && self.force.is_like(&other.force)
            && self.temperature.is_like(&other.temperature)
    }

    fn updated(&self, now: Instant) -> [Known; 5] {
        [
            Known::of("state", &self.state, now),
            Known::of(FLAGS, &self.flags, now),
            Known::of("width_mm", &self.width, now),
            Known::of("speed_mm_s", &self.speed, now),
            Known::of("force_n", &self.force, now),
        ]
    }

    fn all(&self, now: Instant) -> [Known; 6] {
        let [state, flags, width, speed, force] = self.updated(now);
        [state, flags, width, speed, force, Known::of("temperature_c", &self.temperature, now)]
    }
}

/// Measured values of a `State`, as clients see them.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct MeasuredFields {
    /// Age of the oldest known value among state, flags, width, speed and force, in ms; null while none of them is
    /// known.
    #[schema(required, minimum = 0)]
    pub age_ms: Option<u64>,
    /// Time at which the newest frame arrived whose value is known, in UTC with microseconds; null while no value is
    /// known.
    #[serde(serialize_with = "super::time::microseconds_or_null")]
    #[schema(required)]
    pub measured_at: Option<Timestamp>,
    /// Name of the gripper state, as in the manual; null while unknown. `state_code` lists all names.
    #[schema(required)]
    pub state: Option<&'static str>,
    /// Number of the gripper state; null while unknown.
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
    /// Names of the system state flags that are set; empty while the flags are unknown.
    pub flags: Vec<&'static str>,
    /// All 32 system state flags as a number; null while unknown.
    #[schema(required, format = Int64, minimum = 0, maximum = 4_294_967_295_i64)]
    pub flags_raw: Option<u32>,
    /// Whether the fingers are referenced; null while unknown.
    #[schema(required)]
    pub referenced: Option<bool>,
    /// Whether the fingers are moving; null while unknown.
    #[schema(required)]
    pub moving: Option<bool>,
    /// Opening width in mm; null while unknown, and until the fingers are referenced.
    #[schema(required, minimum = -1000, maximum = 1000)]
    pub width_mm: Option<f32>,
    /// Speed of the fingers relative to each other, in mm/s; null while unknown.
    #[schema(required, minimum = -10000, maximum = 10000)]
    pub speed_mm_s: Option<f32>,
    /// Gripping force in N, summed over the fingers; null while unknown.
    #[schema(required, minimum = -10000, maximum = 10000)]
    pub force_n: Option<f32>,
    /// Temperature of the device in °C; null while unknown, and if the firmware does not report it (firmware 2).
    #[schema(required, minimum = -3276.8, maximum = 3276.7)]
    pub temperature_c: Option<f32>,
    /// Names of the values that should be known and are not, because the device does not send them, or sends an error
    /// or an impossible number: `state`, `flags`, `width_mm`, `speed_mm_s`, `force_n` or `temperature_c`. They are
    /// null. Empty as a rule, and while there is no link.
    #[schema(max_items = 6)]
    pub stale: Vec<&'static str>,
}

impl MeasuredFields {
    /// The values that are known at `now`.
    #[must_use]
    pub fn at(values: &Values, now: Instant) -> Self {
        let age = values.oldest(now).map(|oldest| now.saturating_duration_since(oldest));
        Self {
            age_ms: age.map(|age| age.as_millis() as u64),
            measured_at: values.measured_at(now),
            state: values.state_name(now),
            state_code: values.state_code(now),
            flags: values.flag_names(now).unwrap_or_default(),
            flags_raw: values.flags(now).map(|flags| flags.bits()),
            referenced: values.has(SystemState::REFERENCED, now),
            moving: values.has(SystemState::MOVING, now),
            width_mm: values.width_mm(now),
            speed_mm_s: values.speed_mm_s(now),
            force_n: values.force_n(now),
            temperature_c: values.temperature_c(now),
            stale: values.stale(now).collect(),
        }
    }
}

impl Serialize for Values {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        MeasuredFields::at(self, crate::clock::instant()).serialize(serializer)
    }
}

#[cfg(any(test, fuzzing, feature = "testing"))]
impl Values {
    /// Values for tests, which stay good for a day: width in mm, speed in mm/s, and force in N.
    #[must_use]
    pub fn fixed(flags: SystemState, state: GripperState, [width_mm, speed_mm_s, force_n]: [f32; 3]) -> Self {
        let now = crate::clock::instant();
        let good_for = std::time::Duration::from_hours(24);
        let mut values =
            Self { clock: Some(LinkClock { instant: now, wall: Timestamp::UNIX_EPOCH }), ..Self::default() };
        values.flags.take(now, flags, good_for);
        values.state.take(now, state, good_for);
        values.width.take(now, Width::new(width_mm).unwrap_or(Width::ZERO), good_for);
        values.speed.take(now, Speed::new(speed_mm_s).unwrap_or(Speed::ZERO), good_for);
        values.force.take(now, Force::new(force_n).unwrap_or(Force::ZERO), good_for);
        values
    }
}
