//! The one command that moves the fingers: waiting, sent, ended.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::super::Now;
use super::super::error::{Conflict, DeviceRefusal, Failure, Rejection};
use super::super::model::{Client, Command as Record, CommandId, FastStopId, Kind, Motion, Outcome};
use super::purpose::{NotSubmitted, Purpose};
use super::{Actor, REPLY_WITHIN, RESULT_WITHIN};
use crate::wsg::session::{End, Token};
use crate::wsg::{Command, Data, Force, Reply, Status, SystemState};

/// The pause between the end of a motion and the next: devices in the field fall over otherwise.
const PAUSE: Duration = Duration::from_millis(50);

/// How long homing may take: the slowest homing speed over the longest stroke.
const HOMING_WITHIN: Duration = Duration::from_mins(1);

/// How much longer than its way at its speed a motion may take: acceleration, clamping, and a device that gives up by
/// itself with E_TIMEOUT.
const MOTION_MARGIN: Duration = Duration::from_secs(10);

/// How long a command's end waits for values that were measured after it, so that what its client is told, and reads
/// next, is of after the motion. Updates every 10 ms bring them sooner.
const SETTLES_WITHIN: Duration = Duration::from_millis(50);

/// How long after a motion's end the flags may still show that it moves.
const ENDS_WITHIN: Duration = Duration::from_millis(300);

/// The longest that a way may take, whatever a device says of its stroke.
const LONGEST_WAY: Duration = Duration::from_mins(5);

/// The stroke that is reckoned with where the device has not told its own.
const LONGEST_STROKE_MM: f32 = 250.0;

/// The command that moves the fingers, or is about to.
#[derive(Debug)]
pub(super) struct Running {
    pub id: CommandId,
    motion: Motion,
    stage: Stage,
    accepted: bool,
    /// Whether it is one of many that steer the fingers: it waits for nothing, and neither does its client.
    is_streamed: bool,
    /// Whether its `admitted` record is durable, or need not be.
    pub recorded: bool,
    /// The FAST STOP that came while it ran.
    fast_stop: Option<FastStopId>,
    /// Who has cancelled it.
    cancelled_by: Option<Arc<str>>,
    /// What a script answered.
    payload: Option<Vec<u8>>,
}

#[derive(Debug)]
enum Stage {
    /// For the pause after the last one.
    Waiting,
    /// For the answer to Set Force Limit.
    Force(Token),
    /// The session has the motion: its frame may be written.
    Sent(Token),
    /// It has ended, and the values of after it are awaited.
    Settling(Settling),
}

/// What has become of a motion that has ended.
#[derive(Debug, Clone, Copy)]
struct Settling {
    outcome: Outcome,
    status: Option<Status>,
    since: Instant,
}

impl Running {
    pub(super) fn new(id: CommandId, motion: Motion, is_streamed: bool) -> Self {
        Self {
            id,
            motion,
            stage: Stage::Waiting,
            accepted: false,
            is_streamed,
            recorded: false,
            fast_stop: None,
            cancelled_by: None,
            payload: None,
        }
    }

    /// Whether it takes the fingers' reference away, for as long as it runs.
    pub(super) fn homes(&self) -> bool {
        matches!(self.motion, Motion::Home(_)) && !self.is_waiting()
    }

    /// Whether it was given to the device, which may have begun.
    pub(super) fn is_sent(&self) -> bool {
        !self.is_waiting()
    }

    /// Whether the device has said how it ended.
    pub(super) fn has_ended(&self) -> bool {
        matches!(self.stage, Stage::Settling(_))
    }

    /// Whether it has not been given to the device.
    fn is_waiting(&self) -> bool {
        matches!(self.stage, Stage::Waiting | Stage::Force(_))
    }

    /// What the session has of it.
    pub(super) fn token(&self) -> Option<Token> {
        match self.stage {
            Stage::Waiting | Stage::Settling(_) => None,
            Stage::Force(token) | Stage::Sent(token) => Some(token),
        }
    }
}

impl Actor {
    /// Nothing but its pause keeps the motion from starting.
    pub(super) fn let_run(&mut self) {
        if let Some(running) = &mut self.running {
            running.recorded = true;
        }
    }

    /// When the waiting motion may start, once the link is set up.
    pub(super) fn motion_due(&self) -> Option<Instant> {
        let running = self.running.as_ref().filter(|running| running.recorded && self.link.is_up())?;
        let paused_until = self.last_motion_end.filter(|_| !running.is_streamed).map(|end| end + PAUSE);
        matches!(running.stage, Stage::Waiting).then_some(paused_until).flatten()
    }

    /// Starts the motion that waits, when its pause is over.
    pub(super) fn start_waiting_motion(&mut self, now: Now) {
        let Some(running) = &self.running else { return };
        let is_due = self.motion_due().is_none_or(|due| due <= now.instant);
        if !matches!(running.stage, Stage::Waiting) || !is_due || !running.recorded || !self.link.is_up() {
            return;
        }
        let id = running.id;
        match running.motion {
            Motion::Grip { force: Some(force), .. } => {
                let sent = self.link.submit(now, Command::SetForceLimit(force), Purpose::Force(id, force));
                self.set_stage(now, sent.map(Stage::Force));
            }
            _ => self.start_motion(now, id),
        }
    }

    /// The one place that submits a motion.
    pub(super) fn start_motion(&mut self, now: Now, id: CommandId) {
        let Some(running) = self.running.as_ref().filter(|running| running.id == id) else { return };
        if let Some(fast_stop) = self.latch.id() {
            return self.reject_running(now, Conflict::FastStop { id: fast_stop }.into());
        }
        let request = running.motion.request();
        let within = self.result_within(&running.motion);
        let sent = self.link.submit_within(now, request, Purpose::Motion(id), REPLY_WITHIN, within);
        self.set_stage(now, sent.map(Stage::Sent));
    }

    fn set_stage(&mut self, now: Now, stage: Result<Stage, NotSubmitted>) {
        match (stage, &mut self.running) {
            (Ok(stage), Some(running)) => running.stage = stage,
            (Err(not_taken), _) => self.reject_running(now, not_taken.0),
            (Ok(_), None) => {}
        }
    }

    fn result_within(&self, motion: &Motion) -> Duration {
        let speed = match motion {
            Motion::Home(_) => return HOMING_WITHIN,
            Motion::Custom(_) => return RESULT_WITHIN,
            Motion::Move { speed, .. } | Motion::Grip { speed, .. } | Motion::Release { speed, .. } => speed.mm_s(),
        };
        let stroke = self.settings.stroke_mm().unwrap_or(LONGEST_STROKE_MM);
        let way = Duration::try_from_secs_f32(stroke / speed.max(1.0)).unwrap_or(LONGEST_WAY);
        way.min(LONGEST_WAY) + MOTION_MARGIN
    }

    /// How long the fingers may still move on behalf of a motion that has ended.
    fn moves_on_for(&self, ended: &Running) -> Duration {
        let is_told = matches!(ended.stage, Stage::Settling(Settling { status: Some(_), .. }));
        match &ended.motion {
            // They push against an obstacle, and snap to the target when it goes.
            Motion::Move { flags, .. } if !flags.stop_on_block => LONGEST_WAY,
            // A script may do anything.
            Motion::Custom(_) => RESULT_WITHIN,
            _ if is_told => ENDS_WITHIN,
            motion => self.result_within(motion),
        }
    }

    /// The force limit before a grip has been answered. It stays set, whatever has become of the grip.
    pub(super) fn force_ended(&mut self, now: Now, id: CommandId, force: Force, end: End) {
        self.reads.forget();
        let success = matches!(end, End::Reply(Reply::Success(_)));
        if success {
            self.note_setting(&Data::ForceLimit(force));
            if let Some(client) = self.commands.client(id) {
                self.recording.set(now, &client, &Data::ForceLimit(force));
            }
        }
        if self.running.as_ref().is_none_or(|running| running.id != id) {
            return;
        }
        if success {
            self.start_motion(now, id);
        } else {
            let rejection = self.rejection_of("SetForceLimit", end);
            self.reject_running(now, rejection);
        }
    }

    pub(super) fn motion_accepted(&mut self, id: CommandId) {
        if let Some(running) = self.running.as_mut().filter(|running| running.id == id) {
            running.accepted = true;
            self.observed.part.released();
            self.commands.accepted(id);
        }
    }

    /// The motion has ended, as far as the session knows.
    pub(super) fn motion_ended(&mut self, now: Now, id: CommandId, end: End) {
        let Some(running) = self.running.as_mut().filter(|running| running.id == id) else { return };
        self.last_motion_end = Some(now.instant);
        let command = super::name_of(&running.motion.request());
        let (outcome, status) = match end {
            // A script needs no E_CMD_PENDING before.
            End::Reply(Reply::Success(Data::Custom(payload))) => {
                running.payload = Some(payload);
                (Outcome::Success, Some(Status::E_SUCCESS))
            }
            End::Reply(reply) if running.accepted => {
                (outcome_of(running.motion.kind(), reply.status()), Some(reply.status()))
            }
            End::Reply(Reply::Status(status)) => {
                let rejection = self.refusal(command, status);
                return self.reject_running(now, rejection);
            }
            End::Unanswered { written: false, waited, .. } => {
                let waited_ms = waited.as_millis() as u64;
                return self.reject_running(now, Failure::DeviceTimeout { command, waited_ms }.into());
            }
            End::Unanswered { stopped: true, .. } | End::NoResult { stopped: true } => (Outcome::Aborted, None),
            _ => (Outcome::Unknown, None),
        };
        running.stage = Stage::Settling(Settling { outcome, status, since: now.instant });
    }

    /// When a settling motion is told as it is.
    pub(super) fn settles_at(&self) -> Option<Instant> {
        match self.running.as_ref()?.stage {
            Stage::Settling(settling) => Some(settling.since + SETTLES_WITHIN),
            _ => None,
        }
    }

    /// Ends a motion that has settled.
    pub(super) fn end_settled_motion(&mut self, now: Now) {
        let Some(Running { stage: Stage::Settling(settling), is_streamed, .. }) = &self.running else { return };
        if *is_streamed
            || self.observed.is_newer_than(settling.since)
            || self.settles_at().is_some_and(|at| at <= now.instant)
        {
            self.end_running(now, false);
        }
    }

    /// Ends the motion as it stands: settled, or cut off by the end of its link.
    pub(super) fn end_running(&mut self, now: Now, unwritten: bool) {
        let Some(running) = self.running.take() else { return };
        self.may_move_until = Some(now.instant + self.moves_on_for(&running));
        let (outcome, status) = match running.stage {
            Stage::Settling(Settling { outcome, status, .. }) => (outcome, status),
            // It may have happened.
            Stage::Sent(_) if !unwritten => (Outcome::Unknown, None),
            _ => return self.reject(now, running.id, self.link.failure().into()),
        };
        self.end(now, running.id, |record| {
            record.outcome = Some(outcome);
            if let Some(status) = status {
                record.set_status(status);
            }
            if matches!(outcome, Outcome::Aborted | Outcome::Unknown) {
                record.fast_stop_id = running.fast_stop;
                record.cancelled_by = running.cancelled_by;
            }
            record.payload = running.payload.map(|payload| hex::encode(payload).into());
        });
    }

    /// A FAST STOP holds: what waits is over, what runs will be.
    pub(super) fn abort_for_latch(&mut self, now: Now) {
        let fast_stop = self.latch.id();
        if let Some(running) = &mut self.running {
            running.fast_stop = fast_stop;
            self.withdraw_waiting_motion(now);
        }
    }

    /// Ends the motion whose frame has not been written yet, if there is one.
    pub(super) fn withdraw_waiting_motion(&mut self, now: Now) {
        let Some(running) = &self.running else { return };
        let token = running.token();
        let (id, fast_stop, waiting) = (running.id, running.fast_stop, running.is_waiting());
        let cancelled_by = running.cancelled_by.clone();
        let withdrawn = token.is_some_and(|token| self.link.withdraw(token));
        if waiting || withdrawn {
            self.running = None;
            self.end(now, id, |record| {
                record.outcome = Some(Outcome::Aborted);
                record.fast_stop_id = fast_stop;
                record.cancelled_by = cancelled_by;
            });
        }
    }

    /// Stops a command on its client's behalf.
    pub(super) fn cancel(&mut self, now: Now, id: CommandId, by: &Client) {
        match &mut self.running {
            Some(running) if running.id == id && !running.has_ended() => {
                running.cancelled_by.get_or_insert_with(|| by.subject.clone());
            }
            _ => return,
        }
        self.withdraw_waiting_motion(now);
        if self.running.is_some() {
            self.link.send_stop(now);
        }
    }

    /// A Stop has ended.
    pub(super) fn stop_ended(&mut self, now: Now, id: CommandId, end: End) {
        match end {
            End::Reply(Reply::Success(_)) => {
                self.streaming.stopped();
                self.end(now, id, |record| {
                    record.outcome = Some(Outcome::Success);
                    record.set_status(Status::E_SUCCESS);
                });
            }
            end => {
                // Written and not answered, it may have happened all the same.
                let unknown = matches!(end, End::Unanswered { written: true, .. } | End::NoResult { .. });
                let outcome = if unknown { Outcome::Unknown } else { Outcome::Refused };
                let rejection = self.rejection_of("Stop", end);
                self.end_rejected(now, id, outcome, rejection);
            }
        }
    }

    /// What a client is told of an end that is no success.
    pub(super) fn rejection_of(&self, command: &'static str, end: End) -> Rejection {
        match end {
            End::Reply(reply) => self.refusal(command, reply.status()),
            End::Invalid(invalid) => Failure::DeviceProtocol { command, detail: invalid.to_string() }.into(),
            End::Unanswered { waited, .. } => {
                Failure::DeviceTimeout { command, waited_ms: waited.as_millis() as u64 }.into()
            }
            End::NoResult { .. } => {
                Failure::DeviceTimeout { command, waited_ms: super::RESULT_WITHIN.as_millis() as u64 }.into()
            }
        }
    }

    fn refusal(&self, command: &'static str, status: Status) -> Rejection {
        DeviceRefusal { command, status, fast_stop: self.latch.id() }.into()
    }

    pub(super) fn reject_running(&mut self, now: Now, rejection: Rejection) {
        if let Some(running) = self.running.take() {
            self.reject(now, running.id, rejection);
        }
    }

    /// Ends a command that the device never accepted.
    pub(super) fn reject(&mut self, now: Now, id: CommandId, rejection: Rejection) {
        self.end_rejected(now, id, Outcome::Refused, rejection);
    }

    fn end_rejected(&mut self, now: Now, id: CommandId, outcome: Outcome, rejection: Rejection) {
        self.end(now, id, |record| {
            record.outcome = Some(outcome);
            if let Rejection::Device(refusal) = &rejection {
                record.set_status(refusal.status);
            }
            record.rejection = Some(rejection);
        });
    }

    /// The one place that ends a command.
    pub(super) fn end(&mut self, now: Now, id: CommandId, fill_in: impl FnOnce(&mut Record)) {
        self.reads.forget();
        let (width_mm, force_n) = (self.observed.width_mm, self.observed.force_n);
        let referenced = self.observed.has(SystemState::REFERENCED);
        let ended = self.commands.end(now.instant, id, |record| {
            fill_in(record);
            let known = !matches!(record.outcome, Some(Outcome::Unknown | Outcome::Refused));
            record.width_mm = width_mm.filter(|_| known && referenced);
            record.force_n = force_n.filter(|_| known);
            if !matches!(record.kind, Kind::Stop | Kind::Custom) && known {
                record.reached_goal = Some(matches!(record.outcome, Some(Outcome::Success | Outcome::PartHeld)));
                record.stalled = Some(matches!(record.outcome, Some(Outcome::PartHeld | Outcome::Blocked)));
            }
        });
        if let Some((client, record)) = ended {
            self.metering.ended(&record);
            if self.commands.is_streamed(id) {
                return;
            }
            self.recording.done(now, &client, &record);
            if record.outcome == Some(Outcome::PartHeld) {
                self.observed.part.gripped(id);
            }
            tracing::info!(gripper = %self.config.name, command = %id, kind = %record.kind,
                outcome = record.outcome.map(Outcome::name), status = record.status, duration_ms = record.duration_ms,
                "ended");
        }
    }
}

/// What the result of an accepted motion means (`fw4-en 3.2`).
fn outcome_of(kind: Kind, status: Status) -> Outcome {
    match (kind, status) {
        (Kind::Grip, Status::E_SUCCESS) => Outcome::PartHeld,
        (Kind::Grip, Status::E_CMD_FAILED) => Outcome::NoPart,
        (_, Status::E_SUCCESS) => Outcome::Success,
        (_, Status::E_CMD_ABORTED) => Outcome::Aborted,
        (_, Status::E_AXIS_BLOCKED) => Outcome::Blocked,
        (_, Status::E_RANGE_ERROR) => Outcome::Range,
        (_, Status::E_TIMEOUT) => Outcome::Timeout,
        _ => Outcome::Failed,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grip_without_a_part_is_an_answer_and_not_a_failure() {
        assert_eq!(outcome_of(Kind::Grip, Status::E_SUCCESS), Outcome::PartHeld);
        assert_eq!(outcome_of(Kind::Grip, Status::E_CMD_FAILED), Outcome::NoPart);
        assert_eq!(outcome_of(Kind::Release, Status::E_CMD_FAILED), Outcome::Failed);
        assert_eq!(outcome_of(Kind::Move, Status::E_AXIS_BLOCKED), Outcome::Blocked);
        assert_eq!(outcome_of(Kind::Move, Status::from_code(4711)), Outcome::Failed);
    }
}
