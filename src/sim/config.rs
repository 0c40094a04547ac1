//! How a simulated device is built and set up: what a real one has on its type plate and on its web page, and a choice
//! wherever the manuals leave one.

use std::time::Duration;

use crate::wsg::{ChecksumEvaluation, DeviceTag, Firmware, SoftLimits, Status, SystemLimits};

use super::axis::Direction;
use super::models::Model;
use super::world::Part;

/// Which manual the firmware follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Generation {
    /// Firmware 2: no ERROR state, no temperature, no finger interface.
    Fw2,
    /// Firmware 4.
    Fw4,
}

/// What a request with a wrong checksum gets. The manuals don't say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum BadChecksum {
    /// Nothing.
    Silence,
    /// `E_CHECKSUM_ERROR`.
    Answer,
}

/// What is mounted on a base jaw.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum FingerConfig {
    /// Nothing, which can't be told from [`FingerConfig::Generic`].
    #[default]
    None,
    /// A finger without electronics of its own; its power can be switched.
    Generic,
    /// WSG-FMF: measures the force, its data being half of the gripping force as a float, in N.
    Fmf,
    /// WSG-DSA: tactile, its data being this frame.
    Dsa {
        /// What 63h or 73h returns.
        frame: Vec<u8>,
    },
}

/// A command that a script on the device adds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Script {
    /// An id that the manuals don't know, such as B0h.
    pub id: u8,
    /// What it answers.
    pub answer: ScriptAnswer,
}

/// What a script answers.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScriptAnswer {
    /// Its own parameters.
    Echo,
    /// These bytes.
    Bytes(Vec<u8>),
    /// The gripper state as a byte, then width in mm, speed in mm/s and force in N as floats: what the measuring
    /// scripts of the field do.
    Measurement,
    /// A status, without data.
    Status(u16),
}

/// How a device is built and set up.
#[derive(Debug, Clone)]
#[allow(clippy::struct_excessive_bools, reason = "each is a checkbox of its own")]
pub struct DeviceConfig {
    /// The model.
    pub model: Model,
    /// Which manual it follows.
    pub generation: Generation,
    /// The firmware version (50h).
    pub firmware: Firmware,
    /// The hardware revision (50h).
    pub hardware_revision: u8,
    /// The serial number (50h).
    pub serial_number: u32,
    /// The physical limits (53h).
    pub limits: SystemLimits,
    /// Where the jaws really stand when it is switched on, in mm, which the device doesn't know.
    pub start_width_mm: f64,
    /// The direction of homing where 20h says "default".
    pub homing: Direction,
    /// How far the fingers may go beyond a part's nominal width to build up force, in mm (`fw4-en 3.2.6`).
    pub clamping_travel_mm: f64,
    /// By how much a part may be met before its nominal width, in mm.
    pub part_width_tolerance_mm: f64,
    /// The acceleration after a start, in mm/s² (`fw4-en 3.3.1`).
    pub acceleration_mm_s2: f64,
    /// The force limit after a start, in N (`fw4-en 3.3.3`).
    pub force_limit_n: f64,
    /// Soft limits that are loaded at a start (fw2 3.3.5).
    pub soft_limits: Option<SoftLimits>,
    /// The device tag that it has from before.
    pub device_tag: Option<DeviceTag>,
    /// Whether it evaluates checksums (`fw4-en 1.4.1`).
    pub checksum_evaluation: ChecksumEvaluation,
    /// What a bad checksum gets.
    pub bad_checksum: BadChecksum,
    /// Whether the unannounced end of a TCP connection is a FAST STOP (`fw4-en 1.4.2`).
    pub fast_stop_on_disconnect: bool,
    /// What is mounted on the base jaws.
    pub fingers: [FingerConfig; 2],
    /// A force sensor of its own. A WSG-FMF finger is one too.
    pub force_sensor: bool,
    /// What that sensor shows without any load, in N, until it is tared (38h).
    pub force_sensor_offset_n: f64,
    /// Whether it has an Overdrive Mode (37h).
    pub overdrive: bool,
    /// The part between the jaws at the beginning.
    pub part: Option<Part>,
    /// Commands of scripts.
    pub scripts: Vec<Script>,
    /// Whether 43h tells a width before the first homing (fw4: 0, and no change messages).
    pub width_before_referencing: bool,
    /// Whether switching automatic updates on is itself answered. The manuals don't say.
    pub answers_update_requests: bool,
    /// Whether an `E_CMD_PENDING` comes before Loop's data (`fw4-en 3.1.1`).
    pub loop_is_pending: bool,
    /// Whether Stop's own answer comes before the stopped motion's. The manuals don't say.
    pub stop_answers_first: bool,
    /// Whether a Stop without a motion sets AXIS_STOPPED. Ruling: both are possible.
    pub stop_sets_flag_when_idle: bool,
    /// Whether a Stop while HOLDING ends the gripping force. The manuals don't say.
    pub stop_lets_go: bool,
    /// What an acknowledge gets while the fault is still there. Ruling: the FAST STOP stays; no status is named.
    pub early_acknowledge: Status,
    /// What a grip in the opposite direction, without a release between, gets. fw4 forbids it, and names no status.
    pub opposite_grip: Status,
    /// The temperature around it, in °C.
    pub ambient_c: f64,
    /// From here on there is a temperature warning, in °C.
    pub warning_c: f64,
    /// From here on there is a temperature fault, in °C.
    pub critical_c: f64,
    /// How long a partial request is waited for.
    pub partial_request_timeout: Duration,
}

impl DeviceConfig {
    /// A device of this model as it comes from the factory, with firmware 4.
    #[must_use]
    pub fn new(model: Model) -> Self {
        let limits = model.limits();
        Self {
            model,
            generation: Generation::Fw4,
            firmware: Firmware(0x4020),
            hardware_revision: 6,
            serial_number: 1001,
            limits,
            start_width_mm: f64::from(limits.stroke.mm()) / 2.0,
            homing: Direction::Opening,
            clamping_travel_mm: 3.0,
            part_width_tolerance_mm: 1.0,
            acceleration_mm_s2: f64::from(limits.max_acceleration.mm_s2()) / 2.0,
            force_limit_n: f64::from(limits.nominal_force.n()) / 2.0,
            soft_limits: None,
            device_tag: None,
            checksum_evaluation: ChecksumEvaluation::On,
            bad_checksum: BadChecksum::Silence,
            fast_stop_on_disconnect: true,
            fingers: [FingerConfig::None, FingerConfig::None],
            force_sensor: false,
            force_sensor_offset_n: 0.0,
            overdrive: model.has_overdrive(),
            part: None,
            scripts: Vec::new(),
            width_before_referencing: false,
            answers_update_requests: true,
            loop_is_pending: false,
            stop_answers_first: true,
            stop_sets_flag_when_idle: true,
            stop_lets_go: false,
            early_acknowledge: Status::E_SUCCESS,
            opposite_grip: Status::E_ALREADY_RUNNING,
            ambient_c: 25.0,
            warning_c: 70.0,
            critical_c: 85.0,
            partial_request_timeout: Duration::from_millis(500),
        }
    }

    /// A WSG 25, without Overdrive Mode.
    #[must_use]
    pub fn wsg25() -> Self {
        Self::new(Model::Wsg25)
    }

    /// A WSG 32.
    #[must_use]
    pub fn wsg32() -> Self {
        Self::new(Model::Wsg32)
    }

    /// A WSG 50.
    #[must_use]
    pub fn wsg50() -> Self {
        Self::new(Model::Wsg50)
    }

    /// A WSG 70.
    #[must_use]
    pub fn wsg70() -> Self {
        Self::new(Model::Wsg70)
    }

    /// The device of this name: `wsg25`, `wsg32`, `wsg50` or `wsg70`, with `-fw2` behind it for firmware 2.
    #[must_use]
    pub fn from_model(name: &str) -> Option<Self> {
        match name.strip_suffix("-fw2") {
            Some(model) => Model::from_name(model).map(|model| Self::new(model).fw2()),
            None => Model::from_name(name).map(Self::new),
        }
    }

    /// The same device with firmware 2.
    #[must_use]
    pub fn fw2(self) -> Self {
        Self { generation: Generation::Fw2, firmware: Firmware(0x2200), width_before_referencing: true, ..self }
    }

    /// The same device with this part between its jaws.
    #[must_use]
    pub fn with_part(self, part: Part) -> Self {
        Self { part: Some(part), ..self }
    }

    pub(super) fn is_fw4(&self) -> bool {
        self.generation == Generation::Fw4
    }

    pub(super) fn stroke_mm(&self) -> f64 {
        f64::from(self.limits.stroke.mm())
    }

    pub(super) fn nominal_force_n(&self) -> f64 {
        f64::from(self.limits.nominal_force.n())
    }

    /// Whether 38h has something to tare.
    pub(super) fn has_force_sensor(&self) -> bool {
        self.force_sensor || self.has_force_finger()
    }

    pub(super) fn has_force_finger(&self) -> bool {
        self.fingers.contains(&FingerConfig::Fmf)
    }

    // Limits are set freely, so these are no `clamp`, which panics where the least is above the most.

    pub(super) fn clamp_speed_mm_s(&self, speed_mm_s: f64) -> f64 {
        speed_mm_s.max(f64::from(self.limits.min_speed.mm_s())).min(f64::from(self.limits.max_speed.mm_s()))
    }

    pub(super) fn clamp_width_mm(&self, width_mm: f64) -> f64 {
        width_mm.max(0.0).min(self.stroke_mm())
    }
}
