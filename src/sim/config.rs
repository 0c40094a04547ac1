//! Configuration of a simulated device: type plate, web page settings, and each choice that the manuals leave open.

use std::time::Duration;

use wsg::{ChecksumEvaluation, DeviceTag, Firmware, SoftLimits, Status, SystemLimits};

use super::models::{Generation, Model};
use super::motion::axis::AxisDirection;
use super::motion::world::Part;

/// A script that steers the fingers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SteeringScript {
    /// B1h with a position in mm, a speed in mm/s, two gains and two force limits in N. The script sets the speed with
    /// each request, and the fingers keep it until the next one.
    Pd,
    /// B1h with a width in mm and a speed in mm/s, and B2h with a speed.
    Width,
    /// The script of `deploy/device`: B4h with a width in mm and a speed in mm/s.
    Watchdog,
}

/// Steering of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SteeringConfig {
    pub script: Option<SteeringScript>,
    /// Time that the script needs for a request: it takes the next one after this time.
    pub period: Duration,
    /// Time from a request's arrival until the script can take it.
    pub delay: Duration,
}

impl Default for SteeringConfig {
    fn default() -> Self {
        Self { script: None, period: Duration::from_millis(25), delay: Duration::ZERO }
    }
}

/// Reaction to a request with a wrong checksum, which the manuals leave open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum BadChecksum {
    /// No reply.
    Silence,
    /// `E_CHECKSUM_ERROR`.
    Answer,
}

/// Finger on a base jaw.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum FingerConfig {
    /// No finger, which the protocol cannot distinguish from [`FingerConfig::Generic`].
    #[default]
    None,
    /// A finger without electronics. Its power can be switched.
    Generic,
    /// WSG-FMF force measurement finger. Its data are half of the gripping force in N, as a float.
    Fmf,
    /// WSG-DSA tactile finger.
    Dsa {
        /// Data that 63h or 73h returns.
        frame: Vec<u8>,
    },
}

/// A command that a script on the device adds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Script {
    /// An id that the manuals do not list, such as B0h.
    pub id: u8,
    pub answer: ScriptAnswer,
}

/// Reply of a script.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ScriptAnswer {
    /// The parameters of the request.
    Echo,
    Bytes(Vec<u8>),
    /// The gripper state as a byte, then width in mm, speed in mm/s and force in N as floats, as common measuring
    /// scripts reply.
    Measurement,
    /// A status, without data.
    Status(u16),
}

/// Configuration of a device.
#[derive(Debug, Clone)]
#[allow(clippy::struct_excessive_bools, reason = "independent checkboxes")]
pub struct DeviceConfig {
    pub model: Model,
    pub generation: Generation,
    /// Firmware version (50h).
    pub firmware: Firmware,
    /// Hardware revision (50h).
    pub hardware_revision: u8,
    /// Serial number (50h).
    pub serial_number: u32,
    /// Physical limits (53h).
    pub limits: SystemLimits,
    /// True width in mm at power-on, unknown to the device.
    pub start_width_mm: f64,
    /// Homing direction for "default" in 20h.
    pub homing: AxisDirection,
    /// Travel in mm beyond a part's nominal width to build up force (`fw4-en 3.2.6`).
    pub clamping_travel_mm: f64,
    /// Tolerance in mm for contact with a part before its nominal width.
    pub part_width_tolerance_mm: f64,
    /// Acceleration after a restart, in mm/s² (`fw4-en 3.3.1`).
    pub acceleration_mm_s2: f64,
    /// Force limit after a restart, in N (`fw4-en 3.3.3`).
    pub force_limit_n: f64,
    /// Soft limits loaded at a restart (fw2 3.3.5).
    pub soft_limits: Option<SoftLimits>,
    /// Stored device tag.
    pub device_tag: Option<DeviceTag>,
    /// Whether the device evaluates checksums (`fw4-en 1.4.1`).
    pub checksum_evaluation: ChecksumEvaluation,
    pub bad_checksum: BadChecksum,
    /// Whether the unannounced end of a TCP connection is a FAST STOP (`fw4-en 1.4.2`).
    pub fast_stop_on_disconnect: bool,
    pub fingers: [FingerConfig; 2],
    /// Whether the device has its own force sensor. A WSG-FMF finger also counts as one.
    pub force_sensor: bool,
    /// Offset in N of the unloaded force sensor until it is tared (38h).
    pub force_sensor_offset_n: f64,
    /// Whether the device has an Overdrive Mode (37h).
    pub overdrive: bool,
    /// Initial part between the jaws.
    pub part: Option<Part>,
    pub scripts: Vec<Script>,
    /// A script that moves the fingers.
    pub steering: SteeringConfig,
    /// Whether 43h returns a width before the first homing (fw4: 0, without updates on change).
    pub width_before_referencing: bool,
    /// Whether a request that switches automatic updates on gets a reply. The manuals leave it open.
    pub answers_update_requests: bool,
    /// Whether `E_CMD_PENDING` precedes the data of Loop (`fw4-en 3.1.1`).
    pub loop_is_pending: bool,
    /// Whether the reply to Stop precedes the result of the stopped motion. The manuals leave it open.
    pub stop_answers_first: bool,
    /// Whether a Stop without a motion sets AXIS_STOPPED. Ruling: both are possible.
    pub stop_sets_flag_when_idle: bool,
    /// Whether Stop while HOLDING ends the gripping force. The manuals leave it open.
    pub stop_lets_go: bool,
    /// Whether a FAST STOP while HOLDING ends the gripping force. The manuals do not say.
    pub fast_stop_lets_go: bool,
    /// Status for an acknowledgement while the fault persists. No manual names one. Ruling: the FAST STOP stays.
    pub early_acknowledge: Status,
    /// Status for a grip in the opposite direction without a release between. fw4 forbids it without naming a status.
    pub opposite_grip: Status,
    /// Ambient temperature in °C.
    pub ambient_c: f64,
    /// Temperature warning threshold in °C.
    pub warning_c: f64,
    /// Temperature fault threshold in °C.
    pub critical_c: f64,
    /// Time limit for the rest of an incomplete request.
    pub partial_request_timeout: Duration,
}

impl DeviceConfig {
    /// Factory configuration of a model, with firmware 4.
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
            homing: AxisDirection::Opening,
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
            steering: SteeringConfig::default(),
            width_before_referencing: false,
            answers_update_requests: true,
            loop_is_pending: false,
            stop_answers_first: true,
            stop_sets_flag_when_idle: true,
            stop_lets_go: false,
            fast_stop_lets_go: true,
            early_acknowledge: Status::E_SUCCESS,
            opposite_grip: Status::E_ALREADY_RUNNING,
            ambient_c: 25.0,
            warning_c: 70.0,
            critical_c: 85.0,
            partial_request_timeout: Duration::from_millis(500),
        }
    }

    #[must_use]
    pub fn wsg25() -> Self {
        Self::new(Model::Wsg25)
    }

    #[must_use]
    pub fn wsg32() -> Self {
        Self::new(Model::Wsg32)
    }

    #[must_use]
    pub fn wsg50() -> Self {
        Self::new(Model::Wsg50)
    }

    #[must_use]
    pub fn wsg70() -> Self {
        Self::new(Model::Wsg70)
    }

    /// Configuration by name: `wsg25`, `wsg32`, `wsg50` or `wsg70`, with the suffix `-fw2` for firmware 2.
    #[must_use]
    pub fn from_model(name: &str) -> Option<Self> {
        match name.strip_suffix("-fw2") {
            Some(model) => Model::from_name(model).map(|model| Self::new(model).fw2()),
            None => Model::from_name(name).map(Self::new),
        }
    }

    #[must_use]
    pub fn fw2(self) -> Self {
        Self { generation: Generation::Fw2, firmware: Firmware(0x2200), width_before_referencing: true, ..self }
    }

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

    pub(super) fn has_script(&self) -> bool {
        !self.scripts.is_empty() || self.steering.script.is_some()
    }

    /// Whether 38h can tare a sensor.
    pub(super) fn has_force_sensor(&self) -> bool {
        self.force_sensor || self.has_force_finger()
    }

    pub(super) fn has_force_finger(&self) -> bool {
        self.fingers.contains(&FingerConfig::Fmf)
    }

    // Limits can be configured freely, so avoid `clamp`, which panics if the minimum exceeds the maximum.

    pub(super) fn clamp_speed_mm_s(&self, speed_mm_s: f64) -> f64 {
        speed_mm_s.max(f64::from(self.limits.min_speed.mm_s())).min(f64::from(self.limits.max_speed.mm_s()))
    }

    pub(super) fn clamp_width_mm(&self, width_mm: f64) -> f64 {
        width_mm.max(0.0).min(self.stroke_mm())
    }
}
