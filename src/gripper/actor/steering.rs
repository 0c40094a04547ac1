//! Servo sessions: a client's newest target goes to the fingers, and silence stops them.
//!
//! Each target is a streamed motion of its own, subject to lease, latch and limits. Whatever stops the fingers, or takes
//! the right to move them, ends the session first, so that no target follows.

use std::sync::Arc;
use std::time::Instant;

use tokio::sync::oneshot;

use super::super::Now;
use super::super::handle::ResultSender;
use super::super::servo::{DueTarget, ServoSession};
use super::Actor;
use super::link::{OwnStop, Purpose};
use super::running::Running;
use super::streaming;
use model::error::{Conflict, Invalid, Rejection};
use model::{
    Action, Client, CommandId, CommandReport, DeviceEvent, LeaseToken, Motion, Outcome, ServoAdapter, ServoEnd,
    ServoReport, ServoTarget, ServoTerms, Steer, Submission,
};
use wsg::session::End;
use wsg::{Command, Data, Force, GripperState, MoveFlags, Reply, SystemState, Width};

/// The open servo session, and what is known of the last one.
#[derive(Debug, Default)]
pub(super) struct ServoState {
    session: Option<ServoSession>,
    last: Option<Arc<ServoReport>>,
}

impl ServoState {
    /// The open session, or the last one.
    pub(super) fn report(&self) -> Option<Arc<ServoReport>> {
        self.session.as_ref().map(|session| Arc::new(session.report())).or_else(|| self.last.clone())
    }

    pub(super) fn is_open(&self) -> bool {
        self.session.is_some()
    }

    /// Refuses other motions while a session is open.
    pub(super) fn check(&self) -> Result<(), Conflict> {
        self.session.as_ref().map_or(Ok(()), |session| Err(Conflict::Steering { by: session.client.subject.clone() }))
    }

    /// Counts the way of the fingers.
    pub(super) fn moved(&mut self, before_mm: Option<f32>, width: Width) {
        if let (Some(session), Some(before_mm)) = (&mut self.session, before_mm) {
            session.travelled((width.mm() - before_mm).abs());
        }
    }

    /// The open session of this client.
    fn session_of(&mut self, client: &Client, token: Option<&LeaseToken>) -> Result<&mut ServoSession, Conflict> {
        let last = self.last.as_ref().filter(|last| last.by == client.subject);
        let ended = last.and_then(|last| last.ended);
        let session = self.session.as_mut().filter(|session| session.is_of(client, token));
        session.ok_or(Conflict::NoServo { ended })
    }

    /// Rate that this device has reached with the adapter.
    fn rate_hz(&self, adapter: ServoAdapter) -> Option<f32> {
        self.last.as_ref().filter(|last| last.adapter == adapter)?.rate_hz
    }
}

impl Actor {
    /// Takes a request for a servo session. The answer is the session as it is then.
    pub(super) fn steer(
        &mut self,
        now: Now,
        request: Steer,
        client: &Client,
        token: Option<&LeaseToken>,
        answer: ResultSender<ServoReport>,
    ) {
        // A token without a lease renews nothing.
        let _ = self.lease.renew(now.instant, token);
        let done = match request {
            Steer::Start(terms) => self.start_servo(now, terms, client, token),
            Steer::Aim(target) => self.aim_servo(now, target, client, token),
            Steer::Stop => {
                let is_open = self.servo.session_of(client, token).map(drop);
                if is_open.is_ok() {
                    self.stop_servo(now, ServoEnd::Ended);
                }
                is_open.map_err(Rejection::from)
            }
        };
        let answered = done.and_then(|()| {
            let report = self.servo.report().ok_or(Conflict::NoServo { ended: None })?;
            Ok(ServoReport::clone(&report))
        });
        self.answers.add(answer, answered);
    }

    fn start_servo(
        &mut self,
        now: Now,
        terms: ServoTerms,
        client: &Client,
        token: Option<&LeaseToken>,
    ) -> Result<(), Rejection> {
        let adapter = terms.adapter.unwrap_or(self.config.rules.servo.adapter);
        self.check_start_of_servo(now, &terms, adapter, client, token)?;
        let force = terms.force;
        if let Some(force) = force {
            let purpose = Purpose::ServoForce(force, client.clone());
            self.link.submit(now, Command::SetForceLimit(force), purpose).map_err(|not_taken| not_taken.0)?;
        }
        // A motion that settles ends now, with its values so far.
        self.end_running(now, false);
        self.streaming.watch_ended();
        let rate_hz = self.servo.rate_hz(adapter);
        tracing::info!(gripper = %self.config.name, client = %client.subject, adapter = adapter.name(), "servo session begins");
        let started = DeviceEvent::ServoStarted {
            adapter,
            timeout_ms: terms.timeout.as_millis() as u64,
            max_speed_mm_s: terms.max_speed.mm_s(),
            force_n: force.map(Force::n),
        };
        self.recording.servo(now, started, client);
        self.servo.session = Some(ServoSession::begin(now, client.clone(), token.cloned(), adapter, terms, rate_hz));
        Ok(())
    }

    fn check_start_of_servo(
        &self,
        now: Now,
        terms: &ServoTerms,
        adapter: ServoAdapter,
        client: &Client,
        token: Option<&LeaseToken>,
    ) -> Result<(), Rejection> {
        let rules = &self.config.rules.servo;
        if adapter == ServoAdapter::Script && adapter != rules.adapter {
            let detail = "`script` is not configured: set servo_adapter and servo_layout of the gripper".to_owned();
            return Err(Invalid::Malformed { field: "adapter", detail }.into());
        }
        if rules.sends_force(adapter) && terms.force.is_none() {
            let detail = "is missing: this adapter sends a force with each target".to_owned();
            return Err(Invalid::Malformed { field: "force_n", detail }.into());
        }
        self.check_stopped()?;
        self.check_claim(now, client, token)?;
        let limits = self.settings.limits(&self.observed);
        limits.check_servo(terms)?;
        self.check_servo_link(now)?;
        self.servo.check()?;
        self.motion.check()?;
        self.recording.check()?;
        if self.observed.has(SystemState::REFERENCED) { Ok(()) } else { Err(Conflict::NotReferenced.into()) }
    }

    fn check_servo_link(&self, now: Now) -> Result<(), Rejection> {
        self.check_link()?;
        Ok(self.check_flags(now)?)
    }

    fn aim_servo(
        &mut self,
        now: Now,
        target: ServoTarget,
        client: &Client,
        token: Option<&LeaseToken>,
    ) -> Result<(), Rejection> {
        self.servo.session_of(client, token)?;
        let checked = self.check_target(now, &target, client, token);
        let session = self.servo.session_of(client, token)?;
        match &checked {
            Ok(()) => session.accept(now, target),
            Err(_) => session.refuse(),
        }
        self.metering.servo_target(checked.is_ok());
        checked
    }

    fn check_target(
        &self,
        now: Now,
        target: &ServoTarget,
        client: &Client,
        token: Option<&LeaseToken>,
    ) -> Result<(), Rejection> {
        let Some(session) = &self.servo.session else { return Err(Conflict::NoServo { ended: None }.into()) };
        self.check_stopped()?;
        self.check_claim(now, client, token)?;
        session.check_time(now, target.at)?;
        session.check_speeds(target)?;
        let width = self.observed.values.width_mm(now.instant);
        let limits = self.settings.limits(&self.observed);
        limits.check_servo_target(target, width)?;
        self.check_servo_link(now)
    }

    /// Whether a servo session can move the fingers at any time. It does not count while a part is held, since stopping
    /// the fingers could drop the part.
    pub(super) fn is_steered(&self) -> bool {
        self.servo.session.is_some() && self.observed.last_state() != Some(GripperState::Holding)
    }

    /// Time at which the next target is sent, or a motion of the device is ended for it.
    pub(super) fn servo_sends_at(&self) -> Option<Instant> {
        let session = self.servo.session.as_ref().filter(|_| self.link.is_up())?;
        if self.motion.is_under_way() { session.ends_motion_at() } else { session.sends_at() }
    }

    /// Sends the newest target if the device can take it.
    pub(super) fn send_servo_target(&mut self, now: Now) {
        let width_mm = self.observed.values.width_mm(now.instant);
        let is_due = self.servo_sends_at().is_some_and(|at| at <= now.instant);
        let Some(session) = self.servo.session.as_mut().filter(|_| is_due) else { return };
        if self.motion.is_under_way() {
            session.ended_motion_early();
            return self.link.send_stop(now, OwnStop::new(self.motion.id()));
        }
        let Some(target) = session.due(now.instant, width_mm) else { return };
        let is_script = session.adapter != ServoAdapter::Moves;
        // A script may need a target from time to time, although it has not changed.
        if !is_script && session.has_target(target) {
            return session.leave_out(now.instant);
        }
        match self.motion_of(target) {
            Some(motion) => self.start_servo_motion(now, target, motion, is_script),
            None => self.stop_servo(now, ServoEnd::Device),
        }
    }

    /// The motion for a target. `None` if the script's id cannot be sent.
    fn motion_of(&self, target: DueTarget) -> Option<Motion> {
        let session = self.servo.session.as_ref()?;
        let DueTarget { width, speed } = target;
        if session.adapter == ServoAdapter::Moves {
            return Some(Motion::Move { flags: MoveFlags { relative: false, stop_on_block: true }, width, speed });
        }
        let request = self.config.rules.servo.request(session.adapter, width, speed, session.terms.force)?;
        Some(Motion::Custom(request))
    }

    fn start_servo_motion(&mut self, now: Now, target: DueTarget, motion: Motion, is_script: bool) {
        // The values of a motion that settles belong to no record.
        self.end_running(now, false);
        let Some(session) = &mut self.servo.session else { return };
        let id = self.ids.command_id(now.wall);
        session.sent(now.instant, id, target);
        let submission = Submission {
            client: session.client.clone(),
            action: Action::Motion(motion.clone()),
            request_id: None,
            lease: session.token.clone(),
        };
        let report = CommandReport::admitted(id, self.config.name.clone(), &submission, now.wall);
        self.commands.enter(now.instant, report, &submission, true);
        self.motion.running = Some(Running::new(now.instant, id, motion, is_script));
        self.motion.let_run();
        self.commands.recorded(id);
        self.start_waiting_motion(now);
    }

    /// Takes the end of a target. A device that refuses one, or does not answer it, is steered no further.
    pub(super) fn servo_target_ended(&mut self, now: Now, id: CommandId, outcome: Option<Outcome>) {
        let Some(session) = &mut self.servo.session else { return };
        let is_fine = matches!(outcome, Some(Outcome::Success | Outcome::Aborted | Outcome::Blocked));
        if session.answered(now, id) && !is_fine {
            tracing::warn!(gripper = %self.config.name, outcome = outcome.map(Outcome::name),
                "servo session ends: the device did not take a target");
            self.stop_servo(now, ServoEnd::Device);
        }
    }

    /// Takes the answer to the force limit of a session. The limit stays set, whatever happens to the session.
    pub(super) fn servo_force_ended(&mut self, now: Now, force: Force, client: Client, end: &End) {
        self.reads.forget();
        let setter = Command::SetForceLimit(force);
        self.note_unanswered(now, &setter, &client, end);
        let is_set = matches!(end, End::Reply(Reply::Success(_)));
        if is_set {
            self.note_setting(&Data::ForceLimit(force));
            // The session does not wait for the value to be read back.
            self.read_back(now, Command::GetForceLimit, setter, client, oneshot::channel().0);
        }
        if let Some(session) = self.servo.session.as_mut().filter(|session| session.terms.force == Some(force)) {
            session.is_ready = is_set;
            if !is_set {
                self.stop_servo(now, ServoEnd::Device);
            }
        }
    }

    pub(super) fn servo_silent_at(&self) -> Option<Instant> {
        self.servo.session.as_ref().map(ServoSession::silent_at)
    }

    /// Ends a session whose client is silent.
    pub(super) fn end_silent_servo(&mut self, now: Now) {
        if let Some(session) = &self.servo.session {
            let timeout_ms = session.terms.timeout.as_millis() as u64;
            tracing::warn!(gripper = %self.config.name, client = %session.client.subject, timeout_ms,
                "servo session is silent: stopping the fingers");
        }
        self.stop_servo(now, ServoEnd::Silence);
    }

    /// Ends the session, and stops what it moves.
    pub(super) fn stop_servo(&mut self, now: Now, why: ServoEnd) {
        let Some(session) = &self.servo.session else { return };
        let sent = session.last_sent_at().zip(session.same_since());
        self.end_servo(now, why);
        let Some((last_sent_at, same_since)) = sent else { return };
        self.withdraw_waiting_motion(now);
        if self.may_move_by_target(now, last_sent_at, same_since) {
            self.link.send_stop(now, OwnStop::new(self.motion.mover(now.instant)));
        }
    }

    /// Whether a target that was sent at this time, and for the first time at `same_since`, can move the fingers. The
    /// flags show the motion later.
    fn may_move_by_target(&self, now: Now, sent_at: Instant, same_since: Instant) -> bool {
        if self.observed.has(SystemState::MOVING) {
            return true;
        }
        // A Stop could let a held part go. The target can have let go of a part that was held before.
        let values = &self.observed.values;
        if values.is_holding(now.instant) && values.state.arrived_at() > Some(same_since) {
            return false;
        }
        // Flags from before the motion still count as known.
        let shows_rest = values.flags.arrived_at() > Some(sent_at + streaming::MOVES_WITHIN);
        self.motion.is_under_way() || !shows_rest
    }

    /// Ends a session without its lease.
    pub(super) fn end_servo_without_lease(&mut self, now: Now) {
        let Some(session) = &self.servo.session else { return };
        if self.lease.check(now.instant, &session.client, session.token.as_ref()).is_err() {
            self.stop_servo(now, ServoEnd::Lease);
        }
    }

    /// Ends the session. The caller stops the fingers.
    pub(super) fn end_servo(&mut self, now: Now, why: ServoEnd) {
        let Some(session) = self.servo.session.take() else { return };
        if session.last_sent_at().is_some() {
            self.streaming.watch_after_stop(now.instant);
        }
        let client = session.client.clone();
        let duration_ms = session.lasted(now).as_millis() as u64;
        let report = session.end(why);
        tracing::info!(gripper = %self.config.name, client = %client.subject, reason = why.name(), "servo session ended");
        self.metering.servo_ended(&report);
        let ended = DeviceEvent::ServoEnded {
            adapter: report.adapter,
            reason: why,
            duration_ms,
            accepted: report.accepted,
            superseded: report.superseded,
            refused: report.refused,
            longest_gap_ms: report.longest_gap_ms,
            travel_mm: report.travel_mm,
        };
        self.recording.servo(now, ended, &client);
        self.servo.last = Some(Arc::new(report));
    }
}
