//! Commands that end motions: Stop, FAST STOP and its acknowledgement, and the disconnect announcement
//! (`fw4-en 3.2.3` to `3.2.5`, `3.1.2`).

use wsg::{Status, id};

use super::replies::PendingReply;
use crate::Device;
use crate::motion::StepOutcome;
use crate::process::MotionKind;

/// Limit of Stops that wait for the fingers to come to rest; further ones are answered at once.
const MAX_WAITING_STOPS: usize = 16;

impl Device {
    /// Stops the motion, and replies when the fingers are at rest (`fw4-en 3.2.3`).
    pub(crate) fn stop(&mut self) {
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
        if self.mechanics.stop(self.config.stop_lets_go) == Some(StepOutcome::Stopped) {
            self.stopped(Status::E_SUCCESS);
        }
    }

    /// Answers the waiting Stops with `answer`, and ends the motion.
    pub(crate) fn stopped(&mut self, answer: Status) {
        let stops = std::mem::take(&mut self.stops);
        if self.running.is_some() {
            self.process.aborted();
        }
        self.end_running(&stops, answer, Status::E_CMD_ABORTED);
    }

    /// Triggers a FAST STOP, and replies at once even if the fingers are still moving (`fw4-en 3.2.4`).
    pub(super) fn fast_stop_request(&mut self) {
        let ticket = self.ticket(id::FAST_STOP);
        self.fast_stop_with(Some(ticket), Status::E_CMD_ABORTED);
    }

    pub(crate) fn fast_stop(&mut self) {
        self.fast_stop_with(None, Status::E_CMD_ABORTED);
    }

    /// Triggers a FAST STOP outside the soft limits (`fw4-en 3.3.5`). Only 21h has a specific status for this cause.
    pub(crate) fn left_soft_limits(&mut self) {
        let moves = self.running.as_ref().is_some_and(|running| running.kind == MotionKind::Move);
        self.fast_stop_with(None, if moves { Status::E_RANGE_ERROR } else { Status::E_CMD_ABORTED });
    }

    fn fast_stop_with(&mut self, ticket: Option<PendingReply>, result: Status) {
        self.fast_stopped = true;
        self.mechanics.fast_stop(self.config.fast_stop_lets_go);
        self.process.fast_stopped();
        let mut tickets = std::mem::take(&mut self.stops);
        tickets.extend(ticket);
        self.end_running(&tickets, Status::E_SUCCESS, result);
    }

    /// Answers the stop requests and the stopped motion, in the configured order.
    pub(super) fn end_running(&mut self, stoppers: &[PendingReply], stopped_with: Status, result: Status) {
        let stopped = self.running.take().and_then(|running| running.ticket);
        if self.config.stop_answers_first {
            self.answer_all(stoppers, stopped_with);
        }
        if let Some(ticket) = stopped {
            self.result_status(ticket, result);
        }
        if !self.config.stop_answers_first {
            self.answer_all(stoppers, stopped_with);
        }
    }

    fn answer_all(&mut self, tickets: &[PendingReply], status: Status) {
        for &ticket in tickets {
            self.result_status(ticket, status);
        }
    }

    /// Acknowledges a FAST STOP (`fw4-en 3.2.5`). Ruling: while its cause persists, the FAST STOP stays.
    pub(super) fn acknowledge(&mut self) {
        if self.fast_stopped && self.has_fault() {
            let status = self.config.early_acknowledge;
            return self.answer_status(id::ACKNOWLEDGE_FAST_STOP, status);
        }
        self.fast_stopped = false;
        self.answer_status(id::ACKNOWLEDGE_FAST_STOP, Status::E_SUCCESS);
    }

    /// Aborts a motion at once and rejects all further requests (`fw4-en 3.1.2`). A held part stays held.
    pub(super) fn announce_disconnect(&mut self) {
        if !self.is_tcp() {
            return self.answer_status(id::DISCONNECT_ANNOUNCEMENT, Status::E_NOT_AVAILABLE);
        }
        self.announced = true;
        self.subscriptions.clear();
        let mut tickets = std::mem::take(&mut self.stops);
        tickets.push(self.ticket(id::DISCONNECT_ANNOUNCEMENT));
        if self.is_running() {
            self.mechanics.fast_stop(true);
            self.process.aborted();
        }
        self.end_running(&tickets, Status::E_SUCCESS, Status::E_CMD_ABORTED);
    }
}

#[cfg(test)]
#[path = "stops_tests.rs"]
mod tests;
