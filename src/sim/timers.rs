//! Timers of the device.

use std::time::Instant;

use wsg::{Reply, Status};

use super::Device;
use super::link::faults::FaultName;
use super::motion::StepOutcome;
use super::motion::axis::STEP;

impl Device {
    /// Advances time to `now`.
    pub fn handle_timeout(&mut self, now: Instant) {
        self.advance(now);
        self.settle();
    }

    /// Time of the next [`Device::handle_timeout`], or `None` if no timer runs.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        self.next_due().into_iter().chain(self.join_wait()).min()
    }

    /// Runs all timers due up to `now`, each at its own time. An earlier time than the newest changes nothing.
    pub(super) fn advance(&mut self, now: Instant) {
        while let Some(due) = self.next_due().filter(|&due| due <= now) {
            self.clock = self.clock.max(due);
            self.fire();
        }
        self.clock = self.clock.max(now);
    }

    /// Runs timers that became due because of a change.
    pub(super) fn settle(&mut self) {
        self.watch_faults();
        self.plan_step();
        self.advance(self.clock);
    }

    fn plan_step(&mut self) {
        self.next_step =
            if self.mechanics.needs_steps() { Some(self.next_step.unwrap_or(self.clock + STEP)) } else { None };
    }

    fn next_due(&self) -> Option<Instant> {
        let by_itself = [
            self.booting_until,
            self.next_step,
            self.current_fault_clears_at,
            self.process.target_reached_at,
            self.steering.due(),
            self.steering.silent_at,
            self.fingers[0].powered_up_at,
            self.fingers[1].powered_up_at,
            self.late.iter().map(|late| late.at).min(),
            self.decoder.deadline(),
            self.thermal.crosses(self.config.warning_c, self.clock),
            self.thermal.crosses(self.config.critical_c, self.clock),
            self.subscriptions.due(true, |id| Some(self.value(id))),
        ];
        by_itself.into_iter().flatten().min()
    }

    fn fire(&mut self) {
        let now = self.clock;
        if is_due(self.booting_until, now) {
            self.booting_until = None;
            if self.has_fault() {
                self.fast_stop();
            }
        }
        if is_due(self.next_step, now) {
            self.next_step = None;
            self.step();
        }
        if is_due(self.current_fault_clears_at, now) {
            (self.current_fault, self.current_fault_clears_at) = (false, None);
        }
        if is_due(self.process.target_reached_at, now) {
            self.process.after_delay();
        }
        if is_due(self.steering.due(), now) {
            self.run_steering();
        }
        if is_due(self.steering.silent_at, now) {
            self.stop_silent_script();
        }
        for index in 0..self.fingers.len() {
            if is_due(self.fingers[index].powered_up_at, now) {
                self.finger_is_up(index);
            }
        }
        if is_due(self.decoder.deadline(), now) {
            self.give_up_overdue_request();
        }
        self.send_late();
        self.watch_faults();
        self.plan_step();
        for (id, value) in self.take_due_updates() {
            self.send(id, &Reply::Success(value), true);
        }
    }

    fn take_due_updates(&mut self) -> Vec<(u8, wsg::Data)> {
        let mut subscriptions = std::mem::take(&mut self.subscriptions);
        let due = subscriptions.take_due(self.clock, true, |id| Some(self.value(id)));
        self.subscriptions = subscriptions;
        due
    }

    fn step(&mut self) {
        match self.mechanics.step(self.settings.soft_limits) {
            None => {}
            Some(StepOutcome::Finished(status)) => self.finished(status),
            Some(StepOutcome::Stopped) => self.stopped(Status::E_SUCCESS),
            Some(StepOutcome::StopTimedOut) => self.stopped(Status::E_TIMEOUT),
            Some(StepOutcome::PartLost) => self.process.part_lost(),
            Some(StepOutcome::SnappedToTarget) => self.process.reached_target(self.clock),
            Some(StepOutcome::ForbiddenRange) => self.left_soft_limits(),
        }
    }

    fn finished(&mut self, status: Status) {
        let Some(running) = self.running.take() else { return };
        self.process.finished(running.kind, status, self.clock);
        if let Some(ticket) = running.ticket {
            self.result_status(ticket, status);
        }
    }

    fn finger_is_up(&mut self, index: usize) {
        self.fingers[index].powered_up_at = None;
        if let Some(ticket) = self.finger_tickets[index].take() {
            self.result_status(ticket, Status::E_SUCCESS);
        }
    }

    /// Triggers a FAST STOP on overheating.
    pub(super) fn watch_faults(&mut self) {
        let load = self.mechanics.axis.force_n / self.config.nominal_force_n();
        self.thermal.set_load(load, self.clock);
        let is_critical = self.thermal.temperature_c(self.clock) >= self.config.critical_c;
        if is_critical && !self.overheated {
            self.faults.counts.add(FaultName::TemperatureFault);
            self.fast_stop();
        }
        self.overheated = is_critical;
    }
}

fn is_due(at: Option<Instant>, now: Instant) -> bool {
    at.is_some_and(|at| at <= now)
}
