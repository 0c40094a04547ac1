//! Submitting, stopping and ending the command that moves the fingers.

use std::time::Instant;

use tokio::sync::oneshot;

use super::super::Now;
use super::super::automatic_updates;
use super::super::observed::HeldPart;
use super::link::{NotSubmitted, OwnStop, Purpose};
use super::running::{Running, Settling, Stage, outcome_of, result_within};
use super::{Actor, REPLY_WITHIN};
use model::error::{Conflict, DeviceRefusal, Failure, MotionError, Rejection};
use model::{AcceptedWidths, Client, CommandId, CommandReport, Kind, Motion, Outcome, ServoEnd};
use wsg::session::End;
use wsg::{Command, Data, Force, GripperState, Reply, Status, SystemState, Width};

impl Actor {
    /// Starts the waiting motion after its pause.
    pub(super) fn start_waiting_motion(&mut self, now: Now) {
        if !self.link.is_up() {
            return;
        }
        let Some(running) = self.motion.due(now.instant) else { return };
        let id = running.id;
        match running.motion {
            Motion::Grip { force: Some(force), .. }
                if self.motion.is_late(now.instant).is_none() && self.check_stopped().is_ok() =>
            {
                let sent = self.link.submit(now, Command::SetForceLimit(force), Purpose::Force(id, force));
                self.set_stage(now, id, sent.map(Stage::Force));
            }
            // Refuses a motion that may not start.
            _ => self.start_motion(now, id),
        }
    }

    /// Submits a motion to the session. No other place does.
    pub(super) fn start_motion(&mut self, now: Now, id: CommandId) {
        let Some(running) = self.motion.running.as_ref().filter(|running| running.id == id) else { return };
        let request = running.motion.request();
        if let Err(conflict) = self.check_stopped() {
            return self.reject_running(now, conflict.into());
        }
        if let Some(waited) = self.motion.is_late(now.instant) {
            let command = super::name_of(&request);
            let waited_ms = waited.as_millis() as u64;
            return self.reject_running(now, Failure::Late { command, waited_ms }.into());
        }
        let within = result_within(&running.motion, self.settings.stroke_mm());
        let sent = self.link.submit_within(now, request, Purpose::Motion(id), REPLY_WITHIN, within);
        let may_hold = self.observed.values.state(now.instant).is_none_or(|state| state == GripperState::Holding);
        if let Some(running) = self.motion.get_mut(id) {
            running.may_have_held = may_hold;
        }
        self.set_stage(now, id, sent.map(Stage::Sent));
    }

    fn set_stage(&mut self, now: Now, id: CommandId, stage: Result<Stage, NotSubmitted>) {
        match (stage, self.motion.get_mut(id)) {
            (Ok(stage), Some(running)) => running.stage = stage,
            (Err(not_taken), _) => self.reject_running(now, not_taken.0),
            (Ok(_), None) => {}
        }
    }

    /// Takes the result of the Set Force Limit before a grip. The limit stays set, whatever happens to the grip.
    pub(super) fn force_ended(&mut self, now: Now, id: CommandId, force: Force, end: End) {
        self.reads.forget();
        let success = matches!(end, End::Reply(Reply::Success(_)));
        let client = self.commands.client(id);
        if let Some(client) = &client {
            self.note_unanswered(now, &Command::SetForceLimit(force), client, &end);
        }
        let client = client.filter(|_| success);
        if self.motion.id() == Some(id) {
            if success && self.link.is_up() {
                self.start_motion(now, id);
            } else if success {
                // The device is being set up again.
                self.set_stage(now, id, Ok(Stage::Waiting));
            } else {
                let rejection = self.rejection_of("SetForceLimit", end);
                self.reject_running(now, rejection);
            }
        }
        if let Some(client) = client {
            // The grip does not wait for the value to be read back.
            self.note_setting(&Data::ForceLimit(force));
            let setter = Command::SetForceLimit(force);
            self.read_back(now, Command::GetForceLimit, setter, client, oneshot::channel().0);
        }
    }

    pub(super) fn motion_accepted(&mut self, id: CommandId) {
        if let Some(running) = self.motion.get_mut(id) {
            running.accepted = true;
            if !running.is_streamed {
                // A Stop for the end of a stream could end this motion, or let its part go. A motion that the device
                // refuses leaves the fingers to a script that moves them, so they are watched further.
                self.streaming.watch_ended();
            }
            if !self.link.properties.may_duplicate {
                // The link keeps the order, so what was written earlier has arrived, or never will.
                self.motion.forget_late();
            }
            // The motion releases the held part, or grips it again.
            self.observed.part = HeldPart::default();
            self.commands.accepted(id);
        }
    }

    /// Takes the result of a motion from the session.
    pub(super) fn motion_ended(&mut self, now: Now, id: CommandId, end: End) {
        let Some(running) = self.motion.running.as_mut().filter(|running| running.id == id) else { return };
        self.motion.last_end = Some(now.instant);
        let command = super::name_of(&running.motion.request());
        let (outcome, status) = match end {
            // A script may reply without an E_CMD_PENDING before.
            End::Reply(Reply::Success(Data::Custom(payload))) => {
                running.payload = Some(payload);
                if !running.is_streamed {
                    self.streaming.watch_ended();
                }
                (Outcome::Success, Some(Status::E_SUCCESS))
            }
            End::Reply(reply) if running.accepted => {
                (outcome_of(running.motion.kind(), reply.status()), Some(reply.status()))
            }
            End::Reply(Reply::Status(status)) => {
                let rejection = self.refusal(command, status);
                return self.reject_running(now, rejection);
            }
            end @ End::Unanswered { written: false, .. } => {
                return self.reject_running(now, unanswered(command, &end).into());
            }
            End::Unanswered { stopped: true, .. } | End::NoResult { stopped: true } => (Outcome::Aborted, None),
            end => {
                running.unknown_because = Some(unanswered(command, &end));
                (Outcome::Unknown, None)
            }
        };
        let was_accepted = running.accepted;
        running.stage = Stage::Settling(Settling { outcome, status, since: now.instant });
        self.request_values(now);
        if outcome == Outcome::Unknown {
            self.motion.lose_sight(now.instant, self.settings.stroke_mm());
            self.stop_behind(now, id, was_accepted);
        }
    }

    /// Sends a Stop behind a motion whose result is unknown, so that it cannot move the fingers after its client got
    /// this result. A motion that has reached the device is over if the fingers are known to stand still. A Stop could
    /// then let a gripped part go.
    fn stop_behind(&mut self, now: Now, id: CommandId, was_accepted: bool) {
        let stands_still = self.observed.values.has(SystemState::MOVING, now.instant) == Some(false);
        let has_arrived = was_accepted || self.has_gripped(now);
        if has_arrived && stands_still {
            return;
        }
        self.link.send_stop(now, OwnStop::new(Some(id)));
        // A connection loses no Stop, and keeps it behind the motion.
        if !has_arrived && !self.link.properties.connection_oriented {
            self.motion.may_begin_late(now.instant, id);
        }
        if let Some(running) = self.motion.get_mut(id) {
            running.is_stopped_behind = true;
        }
    }

    /// Whether the running motion is a grip whose part shows that it has reached the device, although its replies are
    /// missing.
    fn has_gripped(&self, now: Now) -> bool {
        let Some(running) = &self.motion.running else { return false };
        let is_new_grip = running.motion.kind().is_grip() && !running.may_have_held;
        is_new_grip && self.observed.values.is_holding(now.instant)
    }

    /// Requests the values that the device has now, so that a motion's result does not wait for the next updates. A line
    /// of known rate carries its updates as often as it can, so their requests would only delay them.
    fn request_values(&mut self, now: Now) {
        let flows = self.observed.flows();
        let has_client = self.motion.running.as_ref().is_some_and(|running| !running.is_streamed);
        // A drain sends nothing that it does not need.
        let is_awaited = has_client && self.drain.is_none();
        let is_quick = is_awaited && self.link.properties.bytes_per_second.is_none() && !self.pacing.is_slow();
        if flows && !is_quick {
            return;
        }
        for command in automatic_updates::switch_on_all(self.update_rules(), self.link.properties.bytes_per_second) {
            if !flows {
                self.observed.requested(now.instant, command.id());
            }
            // Without a reply, the result has no value.
            let _ = self.link.submit(now, command, Purpose::Upkeep);
        }
    }

    /// Sends a Stop behind a script's request that was written and not answered, and behind an accepted one without a
    /// result while the fingers may move.
    pub(super) fn stop_script(&mut self, now: Now, command: &Command, end: &End) {
        let is_unknown = match end {
            End::Unanswered { written, stopped, .. } => *written && !stopped,
            End::NoResult { stopped } => {
                !stopped && self.observed.values.has(SystemState::MOVING, now.instant) != Some(false)
            }
            _ => false,
        };
        if is_unknown && self.is_script(command) {
            self.link.send_stop(now, OwnStop::new(None));
        }
    }

    pub(super) fn end_settled_motion(&mut self, now: Now) {
        if self.motion.has_settled(now.instant, &self.observed) {
            self.end_running(now, false);
        }
    }

    /// Ends the motion with its result so far: settled, or cut off by the loss of the link.
    pub(super) fn end_running(&mut self, now: Now, unwritten: bool) {
        if !unwritten && self.motion.is_under_way() && self.motion.is_sent() {
            self.motion.lose_sight(now.instant, self.settings.stroke_mm());
        }
        let newer_than = self.motion.waited_since(now.instant, &self.observed);
        let Some(mut running) = self.motion.finish(now.instant, self.settings.stroke_mm()) else { return };
        let (outcome, status) = match running.stage {
            Stage::Settling(Settling { outcome, status, .. }) => (outcome, status),
            // The motion may have happened.
            Stage::Sent(_) if !unwritten => {
                running.unknown_because = Some(self.link.failure());
                if !running.accepted {
                    // An accepted motion cannot act later: it acts now, and its holder has said what a loss means.
                    running.is_stopped_behind = true;
                    self.link.owed_stop = Some(OwnStop::new(Some(running.id)));
                    if !self.link.properties.connection_oriented {
                        self.motion.may_begin_late(now.instant, running.id);
                    }
                }
                (Outcome::Unknown, None)
            }
            _ => return self.reject(now, running.id, self.link.failure().into()),
        };
        let is_held = outcome.holds_part();
        let contact_width_mm = if is_held { self.recording.judge_contact(running.id) } else { None };
        let confirmed = self.confirmed_by_state(now, outcome, newer_than);
        if confirmed == Outcome::Unknown && outcome != confirmed {
            let state = self.state_after(now, newer_than).map_or("unknown", GripperState::name);
            let detail = format!(
                "the device reported success, but its state is {state} and not HOLDING: check whether the part is held"
            );
            running.unknown_because = Some(Failure::DeviceProtocol { command: "Grip", detail });
        }
        let outcome = confirmed;
        let width_mm = self.width_of_result(now, newer_than);
        let outcome = Self::judged(outcome, &running.motion, contact_width_mm.or(width_mm));
        let peak_force_n = self.recording.peak_force_n(running.id);
        self.end_measured(now, running.id, newer_than, |record| {
            record.set_outcome(outcome);
            record.contact_width_mm = contact_width_mm;
            record.peak_force_n = peak_force_n;
            if let Some(status) = status {
                record.set_status(status);
                if matches!(outcome, Outcome::Blocked | Outcome::Range | Outcome::Timeout | Outcome::Failed) {
                    let error = MotionError { command: super::name_of(&running.motion.request()), status };
                    record.explain(error.code(), &error);
                }
            }
            if let Some(failure) = running.unknown_because.map(Rejection::from) {
                let stop = if running.is_stopped_behind { "; the gateway sends a Stop after this command" } else { "" };
                record.explain(failure.code(), &format!("{failure}{stop}"));
            }
            if matches!(outcome, Outcome::Aborted | Outcome::Unknown) {
                record.fast_stop_id = running.fast_stop;
                record.cancelled_by = running.cancelled_by;
            }
            record.payload = running.payload.map(|payload| hex::encode(payload).into());
        });
    }

    /// Checks the success of a grip against the gripper's state, which reflects the process (`fw4-en 3.2.6`).
    fn confirmed_by_state(&self, now: Now, outcome: Outcome, newer_than: Option<Instant>) -> Outcome {
        if outcome != Outcome::PartHeld {
            return outcome;
        }
        match self.state_after(now, newer_than) {
            Some(GripperState::Holding) => outcome,
            // The next motion has ended the wait for a newer state.
            Some(GripperState::Grasping) if newer_than.is_none() => outcome,
            Some(GripperState::NoPart | GripperState::PartLost) => Outcome::NoPart,
            _ => Outcome::Unknown,
        }
    }

    /// The gripper state, if it arrived after this time.
    fn state_after(&self, now: Now, newer_than: Option<Instant>) -> Option<GripperState> {
        let state = &self.observed.values.state;
        state.at(now.instant).filter(|_| newer_than.is_none_or(|then| state.arrived_at() > Some(then)))
    }

    /// Judges a grip with a part by its recipe and its width at contact, or at the end. Without any width, the part is
    /// not known to be the right one.
    fn judged(outcome: Outcome, motion: &Motion, width_mm: Option<f32>) -> Outcome {
        let Motion::Grip { recipe: Some(recipe), .. } = motion else { return outcome };
        let is_right =
            recipe.accepted == AcceptedWidths::default() || width_mm.is_some_and(|mm| recipe.accepted.accept(mm));
        if outcome == Outcome::PartHeld && !is_right { Outcome::WrongPart } else { outcome }
    }

    /// Aborts the motion for a FAST STOP: a waiting motion ends at once, a running one with its reply.
    pub(super) fn abort_for_latch(&mut self, now: Now) {
        if let Some(id) = self.latch.id() {
            self.withdraw_scripts(&Conflict::FastStop { id }.into(), |_| true);
        }
        self.streaming.stopped(now.instant);
        self.end_servo(now, ServoEnd::FastStop);
        if let Some(running) = &mut self.motion.running {
            running.fast_stop = self.latch.id();
            self.withdraw_waiting_motion(now);
        }
    }

    /// Ends the motion as aborted if its frame has not been written yet.
    pub(super) fn withdraw_waiting_motion(&mut self, now: Now) {
        let Some(running) = self.motion.running.as_ref() else { return };
        let withdrawn = running.token().is_some_and(|token| self.link.withdraw(token));
        if running.is_waiting() || withdrawn {
            let Some(Running { id, fast_stop, cancelled_by, .. }) = self.motion.running.take() else { return };
            self.end(now, id, |record| {
                record.set_outcome(Outcome::Aborted);
                record.fast_stop_id = fast_stop;
                record.cancelled_by = cancelled_by;
            });
        }
    }

    /// Cancels a command for a client.
    pub(super) fn cancel(&mut self, now: Now, id: CommandId, by: &Client) {
        if !self.motion.cancel(id, by) {
            return;
        }
        if self.commands.is_streamed(id) {
            self.streaming.stopped(now.instant);
            self.stop_servo(now, ServoEnd::Stop);
        }
        self.withdraw_waiting_motion(now);
        if self.motion.running.is_some() {
            self.link.send_stop(now, OwnStop::new(Some(id)));
        }
    }

    /// Repeats a Stop of the gateway's own that has failed, while the motion that it should stop may move the fingers.
    pub(super) fn own_stop_ended(&mut self, now: Now, stop: OwnStop, end: &End) {
        let has_stopped = matches!(end, End::Reply(Reply::Success(_))) || self.latch.id().is_some();
        // Without a motion of its own, the Stop could stop somebody else's script.
        let is_known = stop.motion.is_some() || stop.lost.is_some() && self.observed.has(SystemState::MOVING);
        if has_stopped || !is_known || self.motion.mover(now.instant) != stop.motion {
            return;
        }
        let lost = stop.lost.clone();
        if let Some(again) = stop.again() {
            self.link.send_stop(now, again);
        } else {
            tracing::warn!(gripper = %self.config.name, ?end, "the gripper did not stop");
            if let Some(holder) = lost {
                self.fast_stop_for_lost(now, &holder);
            }
        }
    }

    /// Takes the result of a Stop.
    pub(super) fn stop_ended(&mut self, now: Now, id: CommandId, end: End) {
        match end {
            End::Reply(Reply::Success(_)) => {
                self.end(now, id, |record| {
                    record.set_outcome(Outcome::Success);
                    record.set_status(Status::E_SUCCESS);
                });
            }
            end => {
                // A Stop that was written but not answered may still have happened.
                let unknown =
                    matches!(end, End::Unanswered { written: true, .. } | End::NoResult { .. } | End::Invalid(_));
                let outcome = if unknown { Outcome::Unknown } else { Outcome::Refused };
                let rejection = self.rejection_of("Stop", end);
                self.end_rejected(now, id, outcome, rejection);
            }
        }
    }

    /// Rejection for a request that ended without success.
    pub(super) fn rejection_of(&self, command: &'static str, end: End) -> Rejection {
        match end {
            End::Reply(reply) => self.refusal(command, reply.status()),
            end => unanswered(command, &end).into(),
        }
    }

    fn refusal(&self, command: &'static str, status: Status) -> Rejection {
        DeviceRefusal { command, status, fast_stop: self.latch.id() }.into()
    }

    pub(super) fn reject_running(&mut self, now: Now, rejection: Rejection) {
        if let Some(running) = self.motion.running.take() {
            self.reject(now, running.id, rejection);
        }
    }

    /// Ends a command that the device never accepted.
    pub(super) fn reject(&mut self, now: Now, id: CommandId, rejection: Rejection) {
        self.end_rejected(now, id, Outcome::Refused, rejection);
    }

    fn end_rejected(&mut self, now: Now, id: CommandId, outcome: Outcome, rejection: Rejection) {
        self.end(now, id, |record| {
            record.set_outcome(outcome);
            if let Rejection::Device(refusal) = &rejection {
                record.set_status(refusal.status);
            }
            record.explain(rejection.code(), &rejection);
            record.rejection = Some(rejection);
        });
    }

    /// Opening width for the result of a command, if it arrived after this time.
    fn width_of_result(&self, now: Now, newer_than: Option<Instant>) -> Option<f32> {
        let width = &self.observed.values.width;
        width.at(now.instant).map(Width::mm).filter(|_| newer_than.is_none_or(|then| width.arrived_at() > Some(then)))
    }

    /// Gripping force for the result of a command, if it arrived after this time.
    fn force_of_result(&self, now: Now, newer_than: Option<Instant>) -> Option<f32> {
        let force = &self.observed.values.force;
        force.at(now.instant).map(Force::n).filter(|_| newer_than.is_none_or(|then| force.arrived_at() > Some(then)))
    }

    pub(super) fn end(&mut self, now: Now, id: CommandId, fill_in: impl FnOnce(&mut CommandReport)) {
        self.end_measured(now, id, None, fill_in);
    }

    /// Ends a command with the values that arrived after this time. No other place does.
    fn end_measured(
        &mut self,
        now: Now,
        id: CommandId,
        newer_than: Option<Instant>,
        fill_in: impl FnOnce(&mut CommandReport),
    ) {
        self.reads.forget();
        let width_mm = self.width_of_result(now, newer_than);
        let force_n = self.force_of_result(now, newer_than);
        let ended = self.commands.end(now.instant, id, |record| {
            fill_in(record);
            let known = !matches!(record.outcome, Some(Outcome::Unknown | Outcome::Refused));
            record.width_mm = width_mm.filter(|_| known);
            record.force_n = force_n.filter(|_| known);
            if !matches!(record.kind, Kind::Stop | Kind::Custom) && known {
                record.reached_goal = Some(matches!(record.outcome, Some(Outcome::Success | Outcome::PartHeld)));
                record.stalled =
                    Some(record.outcome.is_some_and(|outcome| outcome.holds_part() || outcome == Outcome::Blocked));
            }
        });
        if let Some((client, record)) = ended {
            self.metering.ended(&record);
            if self.commands.is_streamed(id) {
                self.streaming.answered(now.instant);
                return self.servo_target_ended(now, id, record.outcome);
            }
            self.recording.done(now, &client, &record);
            if record.outcome.is_some_and(Outcome::holds_part) {
                self.observed.part.grip = Some(id);
            }
            tracing::info!(gripper = %self.config.name, command = %id, kind = %record.kind,
                outcome = record.outcome.map(Outcome::name), status = record.status, duration_ms = record.duration_ms,
                "command ended");
        }
    }
}

/// Failure of a request without a valid reply.
fn unanswered(command: &'static str, end: &End) -> Failure {
    let waited_ms = match end {
        End::Invalid(invalid) => return Failure::DeviceProtocol { command, detail: invalid.to_string() },
        End::Unanswered { written: false, .. } => return Failure::NotSent { command },
        End::Unanswered { waited, .. } => waited.as_millis() as u64,
        // Acceptance gives a Stop no more time.
        End::NoResult { .. } if command == "Stop" => REPLY_WITHIN.as_millis() as u64,
        End::NoResult { .. } | End::Reply(_) => super::RESULT_WITHIN.as_millis() as u64,
    };
    Failure::DeviceTimeout { command, waited_ms }
}
