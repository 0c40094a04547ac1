//! Handling of motion requests (`fw4-en 3.2`).

use wsg::{Command, HomingDirection, InvalidRequest, Status, Width};

use super::replies::PendingReply;
use crate::motion::Plan;
use crate::motion::axis::{AxisDirection, Drive};
use crate::motion::grip::Grip;
use crate::process::MotionKind;
use crate::{Device, Running};

/// Homing speed in mm/s.
const HOMING_SPEED_MM_S: f64 = 50.0;

/// Share of the nominal force for pre-positioning (fw4) and homing.
const BLOCK_FORCE_SHARE: f64 = 0.5;

impl Device {
    /// Checks a request in the order of the manual's statuses, and starts the motion.
    pub(super) fn motion_request(&mut self, id: u8, command: Result<Command, InvalidRequest>) {
        match self.check_motion(command) {
            Ok((kind, plan)) => {
                let ticket = self.pending(id);
                self.start(Some(ticket), kind, plan);
            }
            Err(status) => self.answer_status(id, status),
        }
    }

    fn check_motion(&self, command: Result<Command, InvalidRequest>) -> Result<(MotionKind, Plan), Status> {
        if self.fast_stopped || self.has_fault() {
            return Err(Status::E_ACCESS_DENIED);
        }
        if self.is_running() {
            return Err(Status::E_ALREADY_RUNNING);
        }
        match command.map_err(InvalidRequest::status)? {
            Command::Homing(direction) => Ok((MotionKind::Home, self.plan_homing(direction))),
            // Ruling: 20h "has to be executed prior to any other motion-related command".
            _ if !self.mechanics.referenced => Err(Status::E_NOT_INITIALIZED),
            Command::PrePosition { flags, width, speed } => {
                let from_mm = if flags.relative { self.mechanics.width_mm() } else { 0.0 };
                let width_mm = self.allowed_target(from_mm + f64::from(width.mm()))?;
                let clamp = !flags.stop_on_block;
                Ok((MotionKind::Move, self.plan_move(width_mm, f64::from(speed.mm_s()), clamp)))
            }
            Command::Grip { width, speed } => {
                let width_mm = self.allowed_target(f64::from(width.mm()))?;
                let direction = self.grip_direction(width_mm);
                if self.process.forbids_grip(direction) {
                    return Err(self.config.opposite_grip);
                }
                Ok((MotionKind::Grip(direction), self.plan_grip(width_mm, direction, f64::from(speed.mm_s()))))
            }
            Command::Release { width, speed } => {
                let width_mm = self.allowed_target(f64::from(width.mm()))?;
                let drive = self.drive(width_mm, f64::from(speed.mm_s()), self.settings.force_limit_n);
                Ok((MotionKind::Release, Plan::Release { drive }))
            }
            _ => Err(Status::E_CMD_UNKNOWN),
        }
    }

    /// Direction of a grip. Fingers that hold a part are beyond its nominal width, within the clamping travel, so
    /// gripping the same part again keeps the direction.
    fn grip_direction(&self, nominal_mm: f64) -> AxisDirection {
        let width_mm = self.mechanics.width_mm();
        match self.mechanics.holds_in() {
            Some(direction)
                if (0.0..=self.config.clamping_travel_mm).contains(&((width_mm - nominal_mm) * direction.sign())) =>
            {
                direction
            }
            _ => AxisDirection::towards(width_mm, nominal_mm),
        }
    }

    /// Clamps a target to the physical limits (`fw4-en 3.2.2`). Ruling: a target outside the soft limits is a range
    /// error, unless the fingers move towards the limits.
    pub(super) fn allowed_target(&self, width_mm: f64) -> Result<f64, Status> {
        let width_mm = self.config.clamp_width_mm(width_mm);
        let target = Width::new(width_mm as f32).unwrap_or(Width::ZERO);
        match self.settings.soft_limits {
            Some(limits) if !limits.allow_from(self.mechanics.width_mm() as f32, target) => Err(Status::E_RANGE_ERROR),
            _ => Ok(width_mm),
        }
    }

    fn plan_homing(&self, direction: HomingDirection) -> Plan {
        let direction = match direction {
            HomingDirection::Default => self.config.homing,
            HomingDirection::Outer => AxisDirection::Opening,
            HomingDirection::Inner => AxisDirection::Closing,
        };
        let beyond_mm = self.mechanics.axis.position_mm + direction.sign() * 2.0 * self.config.stroke_mm();
        let drive = Drive {
            target_mm: beyond_mm,
            speed_mm_s: self.config.clamp_speed_mm_s(HOMING_SPEED_MM_S),
            acceleration_mm_s2: self.settings.acceleration_mm_s2,
            force_limit_n: self.config.nominal_force_n() * BLOCK_FORCE_SHARE,
        };
        Plan::Home { direction, drive }
    }

    /// Plans pre-positioning: with the force limit in fw2, with half of the nominal force in fw4.
    pub(crate) fn plan_move(&self, width_mm: f64, speed_mm_s: f64, clamp: bool) -> Plan {
        let force_limit_n = if self.config.is_fw4() {
            self.config.nominal_force_n() * BLOCK_FORCE_SHARE
        } else {
            self.settings.force_limit_n
        };
        Plan::Move { drive: self.drive(width_mm, speed_mm_s, force_limit_n), clamp }
    }

    fn plan_grip(&self, width_mm: f64, direction: AxisDirection, speed_mm_s: f64) -> Plan {
        let end_mm = width_mm + direction.sign() * self.config.clamping_travel_mm;
        let end_mm = self.config.clamp_width_mm(end_mm);
        let drive = self.drive(end_mm, speed_mm_s, self.settings.force_limit_n);
        let nominal_mm = self.mechanics.true_mm(width_mm);
        Plan::Grip(Grip::new(drive, direction, nominal_mm, self.config.part_width_tolerance_mm))
    }

    pub(super) fn drive(&self, width_mm: f64, speed_mm_s: f64, force_limit_n: f64) -> Drive {
        Drive {
            target_mm: self.mechanics.true_mm(width_mm),
            speed_mm_s: self.config.clamp_speed_mm_s(speed_mm_s),
            acceleration_mm_s2: self.settings.acceleration_mm_s2,
            force_limit_n,
        }
    }

    pub(crate) fn start(&mut self, ticket: Option<PendingReply>, kind: MotionKind, plan: Plan) {
        self.process.started(kind);
        self.mechanics.start(plan);
        self.running = Some(Running { kind, ticket });
    }

    pub(crate) fn is_running(&self) -> bool {
        self.running.is_some() || self.mechanics.is_running()
    }
}

#[cfg(test)]
#[path = "motions_tests.rs"]
mod tests;
