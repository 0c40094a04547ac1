//! What a motion's request gets, and the stops that end it (`fw4-en 3.2`).

use crate::wsg::{Command, HomingDirection, InvalidRequest, Status, Width, id};

use super::axis::{Direction, Drive};
use super::grip::Grip;
use super::motion::{Event, Plan};
use super::process::Kind;
use super::replies::Ticket;
use super::{Device, Running};

/// The speed of homing, in mm/s.
const HOMING_SPEED_MM_S: f64 = 50.0;

/// Pre-positioning presses with this share of the nominal force (fw4), and homing too.
const BLOCK_FORCE_SHARE: f64 = 0.5;

/// So many Stops wait for a stand at most; a further one is answered at once.
const MAX_WAITING_STOPS: usize = 16;

impl Device {
    /// The checks are in the order in which the manual lists their statuses.
    pub(super) fn motion_request(&mut self, id: u8, payload: &[u8]) {
        match self.check_motion(Command::parse(id, payload)) {
            Ok((kind, plan)) => {
                let ticket = self.pending(id);
                self.start(Some(ticket), kind, plan);
            }
            Err(status) => self.answer_status(id, status),
        }
    }

    fn check_motion(&self, command: Result<Command, InvalidRequest>) -> Result<(Kind, Plan), Status> {
        if self.fast_stopped || self.has_fault() {
            return Err(Status::E_ACCESS_DENIED);
        }
        if self.is_running() {
            return Err(Status::E_ALREADY_RUNNING);
        }
        match command.map_err(InvalidRequest::status)? {
            Command::Homing(direction) => Ok((Kind::Home, self.plan_homing(direction))),
            // Ruling: 20h "has to be executed prior to any other motion-related command".
            _ if !self.mechanics.referenced => Err(Status::E_NOT_INITIALIZED),
            Command::PrePosition { flags, width, speed } => {
                let from_mm = if flags.relative { self.mechanics.width_mm() } else { 0.0 };
                let width_mm = self.allowed_target(from_mm + f64::from(width.mm()))?;
                let clamp = !flags.stop_on_block;
                Ok((Kind::Move, self.plan_move(width_mm, f64::from(speed.mm_s()), clamp)))
            }
            Command::Grip { width, speed } => {
                let width_mm = self.allowed_target(f64::from(width.mm()))?;
                let direction = Direction::towards(self.mechanics.width_mm(), width_mm);
                if self.process.forbids_grip(direction) {
                    return Err(self.config.opposite_grip);
                }
                Ok((Kind::Grip(direction), self.plan_grip(width_mm, direction, f64::from(speed.mm_s()))))
            }
            Command::Release { width, speed } => {
                let width_mm = self.allowed_target(f64::from(width.mm()))?;
                let drive = self.drive(width_mm, f64::from(speed.mm_s()), self.settings.force_limit_n);
                Ok((Kind::Release, Plan::Release { drive }))
            }
            _ => Err(Status::E_CMD_UNKNOWN),
        }
    }

    /// Clamped to the physical limits (`fw4-en 3.2.2`). Ruling: a target outside the soft limits is a range error.
    fn allowed_target(&self, width_mm: f64) -> Result<f64, Status> {
        let width_mm = width_mm.clamp(0.0, self.config.stroke_mm());
        let target = Width::new(width_mm as f32).unwrap_or(Width::ZERO);
        match self.settings.soft_limits {
            Some(limits) if !limits.allow(target) => Err(Status::E_RANGE_ERROR),
            _ => Ok(width_mm),
        }
    }

    fn plan_homing(&self, direction: HomingDirection) -> Plan {
        let direction = match direction {
            HomingDirection::Default => self.config.homing,
            HomingDirection::Outer => Direction::Opening,
            HomingDirection::Inner => Direction::Closing,
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

    /// fw2 pre-positions with the force limit, fw4 with half of the nominal force.
    pub(super) fn plan_move(&self, width_mm: f64, speed_mm_s: f64, clamp: bool) -> Plan {
        let force_limit_n = if self.config.is_fw4() {
            self.config.nominal_force_n() * BLOCK_FORCE_SHARE
        } else {
            self.settings.force_limit_n
        };
        Plan::Move { drive: self.drive(width_mm, speed_mm_s, force_limit_n), clamp }
    }

    fn plan_grip(&self, width_mm: f64, direction: Direction, speed_mm_s: f64) -> Plan {
        let end_mm = width_mm + direction.sign() * self.config.clamping_travel_mm;
        let end_mm = end_mm.clamp(0.0, self.config.stroke_mm());
        let drive = self.drive(end_mm, speed_mm_s, self.settings.force_limit_n);
        let nominal_mm = self.mechanics.true_mm(width_mm);
        Plan::Grip(Grip::new(drive, direction, nominal_mm, self.config.part_width_tolerance_mm))
    }

    fn drive(&self, width_mm: f64, speed_mm_s: f64, force_limit_n: f64) -> Drive {
        Drive {
            target_mm: self.mechanics.true_mm(width_mm),
            speed_mm_s: self.config.clamp_speed_mm_s(speed_mm_s),
            acceleration_mm_s2: self.settings.acceleration_mm_s2,
            force_limit_n,
        }
    }

    pub(super) fn start(&mut self, ticket: Option<Ticket>, kind: Kind, plan: Plan) {
        self.process.started(kind);
        self.mechanics.start(plan);
        self.running = Some(Running { kind, ticket });
    }

    pub(super) fn is_running(&self) -> bool {
        self.running.is_some() || self.mechanics.is_running()
    }

    /// `fw4-en 3.2.3`: answered when the fingers stand.
    pub(super) fn stop(&mut self) {
        let ticket = self.ticket(id::STOP);
        if self.is_running() || self.config.stop_sets_flag_when_idle {
            self.process.axis_stopped = true;
        }
        if self.mechanics.is_holding() && self.config.stop_lets_go {
            self.process.aborted();
        }
        if self.stops.len() >= MAX_WAITING_STOPS {
            return self.result_status(ticket, Status::E_SUCCESS);
        }
        self.stops.push(ticket);
        if self.mechanics.stop(self.config.stop_lets_go) == Some(Event::Stopped) {
            self.stopped();
        }
    }

    pub(super) fn stopped(&mut self) {
        let stops = std::mem::take(&mut self.stops);
        if self.running.is_some() {
            self.process.aborted();
        }
        self.end_running(&stops, Status::E_CMD_ABORTED);
    }

    /// `fw4-en 3.2.4`: answered at once, whatever the fingers still do.
    pub(super) fn fast_stop_request(&mut self) {
        let ticket = self.ticket(id::FAST_STOP);
        self.fast_stop_with(Some(ticket), Status::E_CMD_ABORTED);
    }

    pub(super) fn fast_stop(&mut self) {
        self.fast_stop_with(None, Status::E_CMD_ABORTED);
    }

    /// `fw4-en 3.3.5`. Only 21h has a status that says why; the others' result is that of any FAST STOP.
    pub(super) fn left_soft_limits(&mut self) {
        let moves = self.running.as_ref().is_some_and(|running| running.kind == Kind::Move);
        self.fast_stop_with(None, if moves { Status::E_RANGE_ERROR } else { Status::E_CMD_ABORTED });
    }

    fn fast_stop_with(&mut self, ticket: Option<Ticket>, result: Status) {
        self.fast_stopped = true;
        self.mechanics.fast_stop();
        self.process.fast_stopped();
        let mut tickets = std::mem::take(&mut self.stops);
        tickets.extend(ticket);
        self.end_running(&tickets, result);
    }

    /// Answers those who stopped, and whoever was stopped, in the order that the configuration says.
    fn end_running(&mut self, stoppers: &[Ticket], result: Status) {
        let stopped = self.running.take().and_then(|running| running.ticket);
        let answer = |device: &mut Self| {
            for &ticket in stoppers {
                device.result_status(ticket, Status::E_SUCCESS);
            }
        };
        if self.config.stop_answers_first {
            answer(self);
        }
        if let Some(ticket) = stopped {
            self.result_status(ticket, result);
        }
        if !self.config.stop_answers_first {
            answer(self);
        }
    }

    /// `fw4-en 3.2.5`. Ruling: while its cause is still there, the FAST STOP stays.
    pub(super) fn acknowledge(&mut self) {
        if self.fast_stopped && self.has_fault() {
            let status = self.config.early_acknowledge;
            return self.answer_status(id::ACKNOWLEDGE_FAST_STOP, status);
        }
        self.fast_stopped = false;
        self.answer_status(id::ACKNOWLEDGE_FAST_STOP, Status::E_SUCCESS);
    }

    /// `fw4-en 3.1.2`: a motion is aborted at once, and nothing is accepted any more. What is held stays held.
    pub(super) fn announce_disconnect(&mut self) {
        if !self.is_tcp() {
            return self.answer_status(id::DISCONNECT_ANNOUNCEMENT, Status::E_NOT_AVAILABLE);
        }
        self.announced = true;
        self.subscriptions.clear();
        let mut tickets = std::mem::take(&mut self.stops);
        tickets.push(self.ticket(id::DISCONNECT_ANNOUNCEMENT));
        if self.is_running() {
            self.mechanics.fast_stop();
            self.process.aborted();
        }
        self.end_running(&tickets, Status::E_CMD_ABORTED);
    }
}

#[cfg(test)]
#[path = "motions_tests.rs"]
mod tests;
