//! The command that moves the fingers, and the time for which they can move because of it.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::super::observed::Observed;
use super::RESULT_WITHIN;
use model::error::{Conflict, Failure};
use model::{Client, CommandId, FastStopId, Kind, Motion, Outcome};
use wsg::session::Token;
use wsg::{GripperState, Status};

/// Time limit for homing: the longest stroke at the slowest homing speed.
const HOMING_WITHIN: Duration = Duration::from_mins(1);

/// Time allowed in addition to the travel time of a motion: for acceleration, clamping, and the device's own time-out
/// (E_TIMEOUT).
const MOTION_MARGIN: Duration = Duration::from_secs(10);

/// Longest time from the admission of a motion to its request, beyond its pause: for its record and for Set Force
/// Limit. The gateway's process can be frozen meanwhile, or the link be set up again.
const BEGINS_WITHIN: Duration = Duration::from_secs(2);

/// Longest wait for values measured after a motion, beyond the period of the updates, so that its result and the
/// client's next read have the values at rest. Values requested at the end, or the next updates, usually end the wait
/// sooner.
const SETTLES_WITHIN: Duration = Duration::from_millis(50);

/// Longest wait for the gripper state that confirms a grip. A packet that is lost on the network is repeated meanwhile.
const CONFIRMED_WITHIN: Duration = Duration::from_millis(500);

/// Time after a motion's end for which the flags can still show movement.
const ENDS_WITHIN: Duration = Duration::from_millis(300);

/// Time for which a motion without any reply can begin late on a link that loses frames or keeps no order.
const BEGINS_LATE_WITHIN: Duration = Duration::from_secs(10);

/// Upper bound of a travel time, whatever stroke a device reports.
const MAX_TRAVEL_TIME: Duration = Duration::from_mins(5);

/// Assumed stroke of a device that has not reported its own.
const LONGEST_STROKE_MM: f32 = 250.0;

/// The command that moves the fingers, or is about to move them.
#[derive(Debug)]
#[allow(clippy::struct_excessive_bools, reason = "facts that are independent")]
pub(super) struct Running {
    pub id: CommandId,
    pub motion: Motion,
    pub stage: Stage,
    pub accepted: bool,
    admitted_at: Instant,
    /// Whether the command is streamed: neither the command nor its client waits for anything.
    pub is_streamed: bool,
    /// Whether the command's `admitted` record is durable, or not required to be.
    pub recorded: bool,
    /// Id of the FAST STOP that came while the command ran.
    pub fast_stop: Option<FastStopId>,
    /// Subject of the client that cancelled the command.
    pub cancelled_by: Option<Arc<str>>,
    /// Reason for an unknown result.
    pub unknown_because: Option<Failure>,
    /// Whether the gateway sends a Stop behind the motion, because its result is unknown.
    pub is_stopped_behind: bool,
    /// Whether a part may have been held before the motion was sent.
    pub may_have_held: bool,
    /// Reply of a script.
    pub payload: Option<Vec<u8>>,
}

#[derive(Debug)]
pub(super) enum Stage {
    /// Waits for its record and for the pause after the last motion.
    Waiting,
    /// Waits for the reply to Set Force Limit.
    Force(Token),
    /// The session has the motion, and may have written its frame.
    Sent(Token),
    /// The motion has ended, and values measured after its end are awaited.
    Settling(Settling),
}

/// Result of a motion that has ended.
#[derive(Debug, Clone, Copy)]
pub(super) struct Settling {
    pub outcome: Outcome,
    pub status: Option<Status>,
    pub since: Instant,
}

impl Running {
    pub(super) fn new(now: Instant, id: CommandId, motion: Motion, is_streamed: bool) -> Self {
        Self {
            id,
            motion,
            stage: Stage::Waiting,
            accepted: false,
            admitted_at: now,
            is_streamed,
            recorded: false,
            fast_stop: None,
            cancelled_by: None,
            unknown_because: None,
            is_stopped_behind: false,
            may_have_held: true,
            payload: None,
        }
    }

    /// Whether the result of the motion is known.
    fn has_ended(&self) -> bool {
        matches!(self.stage, Stage::Settling(_))
    }

    /// Whether the motion has not been submitted to the session yet.
    pub(super) fn is_waiting(&self) -> bool {
        matches!(self.stage, Stage::Waiting | Stage::Force(_))
    }

    /// Whether the force limit has to stay as this grip sets it, because the device has not accepted the grip yet.
    fn needs_its_force(&self) -> bool {
        let has_force = matches!(self.motion, Motion::Grip { force: Some(_), .. });
        has_force && !self.accepted && !self.has_ended()
    }

    /// Token of the session's request, if there is one.
    pub(super) fn token(&self) -> Option<Token> {
        match self.stage {
            Stage::Waiting | Stage::Settling(_) => None,
            Stage::Force(token) | Stage::Sent(token) => Some(token),
        }
    }

    /// Time for which the fingers can still move because of this command after its end.
    fn moves_on_for(&self, stroke_mm: Option<f32>) -> Duration {
        let has_status = matches!(self.stage, Stage::Settling(Settling { status: Some(_), .. }));
        match &self.motion {
            // The fingers push against an obstacle, and snap to the target when it is gone.
            Motion::Move { flags, .. } if !flags.stop_on_block => MAX_TRAVEL_TIME,
            // A script can do anything.
            Motion::Custom(_) => RESULT_WITHIN,
            _ if has_status => ENDS_WITHIN,
            motion => result_within(motion, stroke_mm),
        }
    }
}

/// Time limit for a motion's result.
pub(super) fn result_within(motion: &Motion, stroke_mm: Option<f32>) -> Duration {
    let speed = match motion {
        Motion::Home(_) => return HOMING_WITHIN,
        Motion::Custom(_) => return RESULT_WITHIN,
        Motion::Move { speed, .. } | Motion::Grip { speed, .. } | Motion::Release { speed, .. } => speed.mm_s(),
    };
    let stroke = stroke_mm.unwrap_or(LONGEST_STROKE_MM);
    let travel_time = Duration::try_from_secs_f32(stroke / speed.max(1.0)).unwrap_or(MAX_TRAVEL_TIME);
    travel_time.min(MAX_TRAVEL_TIME) + MOTION_MARGIN
}

/// The current motion, and the end of the last one.
#[derive(Debug)]
pub(super) struct MotionState {
    /// Pause between the end of a motion and the next one.
    pause: Duration,
    pub running: Option<Running>,
    pub last_end: Option<Instant>,
    /// Time until which the fingers can move because of a motion that has ended.
    may_move_until: Option<Instant>,
    /// The last motion and the same time, if its result is unknown and no flags have shown since that the fingers stand
    /// still.
    unseen: Option<(CommandId, Instant)>,
    /// Time until which a motion without any reply can begin late, although a Stop was sent behind it: on links without
    /// a connection, the Stop can be lost or overtaken.
    begins_late: Option<(CommandId, Instant)>,
}

impl MotionState {
    pub(super) fn new(pause: Duration) -> Self {
        Self { pause, running: None, last_end: None, may_move_until: None, unseen: None, begins_late: None }
    }

    pub(super) fn set_pause(&mut self, pause: Duration) {
        self.pause = pause;
    }

    /// The command of this id, while it runs.
    pub(super) fn get_mut(&mut self, id: CommandId) -> Option<&mut Running> {
        self.running.as_mut().filter(|running| running.id == id)
    }

    pub(super) fn id(&self) -> Option<CommandId> {
        self.running.as_ref().map(|running| running.id)
    }

    /// Whether a motion runs whose result is not known yet.
    pub(super) fn is_under_way(&self) -> bool {
        self.running.as_ref().is_some_and(|running| !running.has_ended())
    }

    /// Checks that the next motion can be admitted.
    pub(super) fn check(&self) -> Result<(), Conflict> {
        match &self.running {
            Some(running) if !running.has_ended() => Err(Conflict::AlreadyRunning { id: running.id }),
            _ => Ok(()),
        }
    }

    /// Checks that the force limit can be set without changing the force of a grip that is about to begin.
    pub(super) fn check_force_limit(&self) -> Result<(), Conflict> {
        match &self.running {
            Some(running) if running.needs_its_force() => Err(Conflict::AlreadyRunning { id: running.id }),
            _ => Ok(()),
        }
    }

    /// Lets the motion start after its pause.
    pub(super) fn let_run(&mut self) {
        if let Some(running) = &mut self.running {
            running.recorded = true;
        }
    }

    pub(super) fn waits_for_record(&self, id: CommandId) -> bool {
        self.running.as_ref().is_some_and(|running| running.id == id && !running.recorded)
    }

    /// The motion that waits only for its pause.
    fn pausing(&self) -> Option<&Running> {
        self.running.as_ref().filter(|running| running.recorded && matches!(running.stage, Stage::Waiting))
    }

    /// End of the waiting motion's pause, if there is one.
    pub(super) fn starts_at(&self) -> Option<Instant> {
        self.pausing().filter(|running| !running.is_streamed).and(self.last_end).map(|end| end + self.pause)
    }

    /// The waiting motion whose pause is over.
    pub(super) fn due(&self, now: Instant) -> Option<&Running> {
        self.pausing().filter(|_| self.starts_at().is_none_or(|at| at <= now))
    }

    /// Time that a motion has waited in vain, if it is too late to begin it. Its client may have given up.
    pub(super) fn is_late(&self, now: Instant) -> Option<Duration> {
        let waited = now.saturating_duration_since(self.running.as_ref()?.admitted_at);
        (waited > self.pause + BEGINS_WITHIN).then_some(waited)
    }

    /// Time at which a settling motion ends even without newer values.
    pub(super) fn settles_at(&self, observed: &Observed) -> Option<Instant> {
        let Stage::Settling(Settling { outcome, since, .. }) = self.running.as_ref()?.stage else { return None };
        let is_confirmed = outcome != Outcome::PartHeld || observed.values.state.arrived_at() > Some(since);
        let within = if is_confirmed { SETTLES_WITHIN } else { CONFIRMED_WITHIN };
        Some(since + observed.period + within)
    }

    /// Whether the motion has settled: values newer than its end have arrived, or the wait is over.
    pub(super) fn has_settled(&self, now: Instant, observed: &Observed) -> bool {
        match &self.running {
            Some(Running { stage: Stage::Settling(settling), is_streamed, .. }) => {
                let is_over = self.settles_at(observed).is_some_and(|at| at <= now);
                let is_closing =
                    settling.outcome == Outcome::PartHeld && observed.last_state() == Some(GripperState::Grasping);
                *is_streamed || is_over || !is_closing && observed.is_newer_than(settling.since)
            }
            _ => false,
        }
    }

    /// End of a settling motion whose wait for newer values was in vain: values from before its end do not belong to its
    /// result. A device that sends only changes has no newer ones.
    pub(super) fn waited_since(&self, now: Instant, observed: &Observed) -> Option<Instant> {
        let is_over = self.settles_at(observed).is_some_and(|at| at <= now);
        match self.running.as_ref()?.stage {
            Stage::Settling(settling) if is_over && !observed.is_on_change() => Some(settling.since),
            _ => None,
        }
    }

    /// Takes the ended motion, and notes for how long the fingers can still move.
    pub(super) fn finish(&mut self, now: Instant, stroke_mm: Option<f32>) -> Option<Running> {
        let running = self.running.take()?;
        self.may_move_until = Some(now + running.moves_on_for(stroke_mm));
        Some(running)
    }

    /// Notes the client that cancels a command. Returns whether the command is still under way.
    pub(super) fn cancel(&mut self, id: CommandId, by: &Client) -> bool {
        let running = self.get_mut(id).filter(|running| !running.has_ended());
        running.map(|running| running.cancelled_by.get_or_insert_with(|| by.subject.clone())).is_some()
    }

    /// Whether homing is under way or settles. Until the first flags after it, the fingers can be without a reference.
    pub(super) fn is_homing(&self) -> bool {
        self.running.as_ref().is_some_and(|running| matches!(running.motion, Motion::Home(_)) && !running.is_waiting())
    }

    /// Whether a streamed command was submitted to the session, and has not ended.
    pub(super) fn is_streamed(&self) -> bool {
        let running = self.running.as_ref().filter(|running| running.is_streamed);
        running.is_some_and(|running| matches!(running.stage, Stage::Sent(_)))
    }

    /// Whether a motion was submitted to the session, or has ended and settles.
    pub(super) fn is_sent(&self) -> bool {
        self.running.as_ref().is_some_and(|running| !running.is_waiting())
    }

    /// Notes that the motion's result is unknown, so that the fingers count as moving until the flags show that they
    /// stand still.
    pub(super) fn lose_sight(&mut self, now: Instant, stroke_mm: Option<f32>) {
        self.unseen = self.running.as_ref().map(|running| (running.id, now + running.moves_on_for(stroke_mm)));
    }

    /// Notes that a motion without any reply can begin late.
    pub(super) fn may_begin_late(&mut self, now: Instant, id: CommandId) {
        self.begins_late = Some((id, now + BEGINS_LATE_WITHIN));
    }

    /// Returns the late motion that has made the fingers move, if there can be one. It is the mover again.
    pub(super) fn takes_late_motion(&mut self, now: Instant) -> Option<CommandId> {
        self.unseen = Some(self.begins_late.take()?);
        self.unseen.filter(|(_, until)| now < *until).map(|(id, _)| id)
    }

    /// Forgets the motion that can begin late.
    pub(super) fn forget_late(&mut self) {
        self.begins_late = None;
    }

    /// Forgets the motions of a device that another one replaces.
    pub(super) fn forget_unseen(&mut self) {
        (self.unseen, self.begins_late) = (None, None);
    }

    /// Notes that the fingers stand still.
    pub(super) fn rested(&mut self) {
        self.unseen = None;
    }

    /// The motion that moves the fingers as far as known: it is under way or about to start, or its result is unknown.
    pub(super) fn mover(&self, at: Instant) -> Option<CommandId> {
        let unseen = self.unseen.filter(|(_, until)| at < *until).map(|(id, _)| id);
        self.running.as_ref().filter(|running| !running.has_ended()).map(|running| running.id).or(unseen)
    }

    /// Whether the fingers can be moving because of a command of this gateway.
    pub(super) fn may_move(&self, now: Instant) -> bool {
        self.is_sent() || self.may_move_until.is_some_and(|until| now < until)
    }
}

/// Outcome of an accepted motion that ended with this status (`fw4-en 3.2`).
pub(super) fn outcome_of(kind: Kind, status: Status) -> Outcome {
    match (kind, status) {
        (kind, Status::E_SUCCESS) if kind.is_grip() => Outcome::PartHeld,
        (kind, Status::E_CMD_FAILED) if kind.is_grip() => Outcome::NoPart,
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
    use wsg::HomingDirection;

    #[test]
    fn motion_starts_after_the_configured_pause() {
        let end = Instant::now();
        for pause in [Duration::ZERO, Duration::from_millis(120)] {
            let mut motion = MotionState::new(pause);
            motion.last_end = Some(end);
            let home = Motion::Home(HomingDirection::Default);
            motion.running = Some(Running::new(end, CommandId::generate(), home, false));
            motion.let_run();
            assert_eq!(motion.starts_at(), Some(end + pause));
        }
    }

    #[test]
    fn grip_without_a_part_is_not_a_failure() {
        assert_eq!(outcome_of(Kind::Grip, Status::E_SUCCESS), Outcome::PartHeld);
        assert_eq!(outcome_of(Kind::Grip, Status::E_CMD_FAILED), Outcome::NoPart);
        assert_eq!(outcome_of(Kind::Reference, Status::E_SUCCESS), Outcome::PartHeld);
        assert_eq!(outcome_of(Kind::Release, Status::E_CMD_FAILED), Outcome::Failed);
        assert_eq!(outcome_of(Kind::Move, Status::E_AXIS_BLOCKED), Outcome::Blocked);
        assert_eq!(outcome_of(Kind::Move, Status::from_code(4711)), Outcome::Failed);
    }
}
