//! Current state of the device: values of its getters, and a full snapshot for tests and the control port.

use wsg::{Data, DeviceTag, Force, GripperState, SoftLimits, Speed, Statistics, SystemInfo, SystemState, Width, id};

use super::Device;
use super::motion::AT_LIMIT_MM;
use super::motion::axis::AxisDirection;
use super::motion::world::Part;

/// Full state of a device at one moment: true values and those that the device shows.
#[derive(Debug, Clone, PartialEq)]
#[allow(clippy::struct_excessive_bools, reason = "independent states")]
pub struct Snapshot {
    /// True distance between the jaws, in mm.
    pub true_width_mm: f64,
    /// Opening width that the device shows (43h), in mm.
    pub width_mm: f64,
    /// Relative speed of the fingers, positive while opening, in mm/s.
    pub speed_mm_s: f64,
    /// Gripping force that the device shows (45h), in N.
    pub force_n: f64,
    /// System state flags (40h).
    pub flags: SystemState,
    /// Gripper state (41h).
    pub gripper_state: GripperState,
    pub referenced: bool,
    pub moving: bool,
    /// Whether a FAST STOP is latched.
    pub fast_stop: bool,
    /// Part between the jaws or beside them.
    pub part: Option<Part>,
    /// Width at which the jaws touch the obstacle, in mm.
    pub obstacle_mm: Option<f64>,
    /// Gripping statistics (42h).
    pub statistics: Statistics,
    pub temperature_c: f64,
    pub acceleration_mm_s2: f64,
    pub force_limit_n: f64,
    pub soft_limits: Option<SoftLimits>,
    pub overdrive: bool,
    pub device_tag: Option<String>,
    /// Ids whose automatic updates are on.
    pub updates: Vec<u8>,
    /// Whether a client is connected (TCP), or an interface is in use (others).
    pub connected: bool,
    /// Whether the client has announced its disconnect (07h).
    pub announced: bool,
    /// Whether the device is restarting after a [`Reboot`](super::Change::Reboot).
    pub booting: bool,
    /// Whether the device sends nothing, because of [`Silent`](super::Change::Silent) or a fault.
    pub silent: bool,
    /// Whether the connection passes no bytes.
    pub half_open: bool,
    /// Frames waiting to be sent.
    pub queued_frames: usize,
    /// Automatic updates dropped because too many frames were waiting.
    pub dropped_updates: u64,
    /// Requests received with a correct checksum.
    pub received_frames: u64,
    /// Requests received with a wrong checksum.
    pub damaged_requests: u64,
    /// Requests rejected because too many replies were waiting.
    pub refused_requests: u64,
}

impl Device {
    #[must_use]
    pub fn snapshot(&self) -> Snapshot {
        Snapshot {
            true_width_mm: self.mechanics.axis.position_mm,
            width_mm: self.shown_width_mm(),
            speed_mm_s: self.mechanics.axis.speed_mm_s,
            force_n: self.shown_force_n(),
            flags: self.flags(),
            gripper_state: self.process.state,
            referenced: self.mechanics.referenced,
            moving: self.mechanics.is_moving(),
            fast_stop: self.fast_stopped,
            part: self.mechanics.world.part(),
            obstacle_mm: self.mechanics.world.obstacle_mm(),
            statistics: self.process.statistics,
            temperature_c: self.thermal.temperature_c(self.clock),
            acceleration_mm_s2: self.settings.acceleration_mm_s2,
            force_limit_n: self.settings.force_limit_n,
            soft_limits: self.settings.soft_limits,
            overdrive: self.settings.overdrive,
            device_tag: self.settings.device_tag.as_ref().map(DeviceTag::text),
            updates: self.subscriptions.ids().collect(),
            connected: self.link.is_some(),
            announced: self.announced,
            booting: self.booting_until.is_some(),
            silent: self.silent || self.muted,
            half_open: self.half_open,
            queued_frames: self.outbox.len() + self.chunks.len(),
            dropped_updates: self.outbox.dropped_updates,
            received_frames: self.log.total,
            damaged_requests: self.damaged_requests,
            refused_requests: self.refused_requests,
        }
    }

    /// Value that the getter `id` returns.
    pub(super) fn value(&self, id: u8) -> Data {
        match id {
            id::GET_SYSTEM_STATE => Data::SystemState(self.flags()),
            id::GET_GRIPPER_STATE => Data::GripperState(self.process.state),
            id::GET_WIDTH => Data::Width(Width::new(self.shown_width_mm() as f32).unwrap_or(Width::ZERO)),
            id::GET_SPEED => Data::Speed(Speed::new(self.mechanics.axis.speed_mm_s as f32).unwrap_or(Speed::ZERO)),
            id::GET_FORCE => Data::Force(Force::new(self.shown_force_n() as f32).unwrap_or(Force::ZERO)),
            _ => Data::None,
        }
    }

    /// Width in mm, or 0 unless referenced (`fw4-en 3.4.4`).
    pub(super) fn shown_width_mm(&self) -> f64 {
        let known = self.mechanics.referenced || self.config.width_before_referencing;
        if known { self.mechanics.width_mm() } else { 0.0 }
    }

    /// Absolute gripping force in N.
    pub(super) fn shown_force_n(&self) -> f64 {
        let force_n = self.mechanics.axis.force_n;
        if self.config.has_force_sensor() { (force_n + self.sensor_offset_n).abs() } else { force_n }
    }

    /// System state flags (40h; `fw4-en` Appendix B).
    #[must_use]
    pub fn flags(&self) -> SystemState {
        let mechanics = &self.mechanics;
        let temperature_c = self.thermal.temperature_c(self.clock);
        let soft_limit = self.at_soft_limit();
        let set = [
            (SystemState::REFERENCED, mechanics.referenced),
            (SystemState::MOVING, mechanics.is_moving()),
            (SystemState::BLOCKED_MINUS, mechanics.blocked == Some(AxisDirection::Closing)),
            (SystemState::BLOCKED_PLUS, mechanics.blocked == Some(AxisDirection::Opening)),
            (SystemState::SOFT_LIMIT_MINUS, soft_limit == Some(AxisDirection::Closing)),
            (SystemState::SOFT_LIMIT_PLUS, soft_limit == Some(AxisDirection::Opening)),
            (SystemState::AXIS_STOPPED, self.process.axis_stopped),
            (SystemState::TARGET_POS_REACHED, self.process.target_reached),
            (SystemState::OVERDRIVE_MODE, self.settings.overdrive),
            (SystemState::FORCECNTL_MODE, self.config.has_force_finger() && mechanics.is_holding()),
            (SystemState::FAST_STOP, self.fast_stopped),
            (SystemState::TEMP_WARNING, temperature_c >= self.config.warning_c),
            (SystemState::TEMP_FAULT, self.overheated),
            (SystemState::POWER_FAULT, self.power_fault),
            (SystemState::CURR_FAULT, self.current_fault),
            (SystemState::FINGER_FAULT, self.fingers.iter().any(super::FingerPort::is_faulty)),
            (SystemState::CMD_FAILURE, self.command_failed),
            (SystemState::SCRIPT_RUNNING, self.script_runs),
            (SystemState::SCRIPT_FAILURE, self.script_failed),
        ];
        set.into_iter().filter(|(_, is_set)| *is_set).map(|(flag, _)| flag).collect()
    }

    pub(super) fn has_fault(&self) -> bool {
        self.overheated || self.power_fault || self.current_fault
    }

    pub(super) fn system_info(&self) -> SystemInfo {
        SystemInfo {
            device_type: self.config.model.device_type(self.config.generation),
            hardware_revision: self.config.hardware_revision,
            firmware: self.config.firmware,
            serial_number: self.config.serial_number,
        }
    }

    /// Soft limit that the fingers have reached or passed.
    fn at_soft_limit(&self) -> Option<AxisDirection> {
        let limits = self.settings.soft_limits.filter(|_| self.mechanics.referenced)?;
        let width_mm = self.mechanics.width_mm();
        if width_mm <= f64::from(limits.minus().mm()) + AT_LIMIT_MM {
            Some(AxisDirection::Closing)
        } else if width_mm >= f64::from(limits.plus().mm()) - AT_LIMIT_MM {
            Some(AxisDirection::Opening)
        } else {
            None
        }
    }
}
