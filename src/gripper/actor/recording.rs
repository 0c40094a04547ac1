//! What the actor writes down, and what waits until that is durable.
//!
//! A motion's frame leaves after its `admitted` record is durable, and no client is told of a command before: so
//! whatever becomes of the gateway, the journal knows every command that a client knows. A FAST STOP waits for nothing,
//! and a Stop's frame neither.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::super::Now;
use super::super::curve::{Curve, TAIL};
use super::super::error::Failure;
use super::super::model::{
    AcknowledgeEvent, Admitted, Client, Command as Ended, CommandEvent, CommandId, Detail, DeviceEvent, Done, Event,
    FastStopEvent, FastStopStep, GripRecord, Kind, Link, LinkEvent, Motion, Outcome, Parameters, PartId, Submission,
};
use super::super::recorder::{Health, Record};
use super::Actor;
use super::flicker::Flicker;
use super::repeats::Repeats;
use crate::wsg::{GripperState, SystemState};

/// How long a command waits for its record. One that waits longer is refused, or goes on, and is never sent later.
pub(super) const RECORDED_WITHIN: Duration = Duration::from_millis(500);

/// What becomes of motions while the journal takes no records.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OnJournalFailure {
    /// They are refused.
    #[default]
    Refuse,
    /// They go on without.
    Continue,
}

/// What the actor has to do with the journal.
#[derive(Debug, Default)]
pub(super) struct Recording {
    /// What is to be recorded, with the command that waits for it. The driver takes it after each input.
    outbox: VecDeque<(Record, Option<CommandId>)>,
    /// The commands whose records aren't durable yet, and until when that is waited for: the oldest first.
    unrecorded: VecDeque<(Instant, CommandId)>,
    health: Health,
    /// The motion that is being measured.
    measured: Option<Measured>,
    /// How the link was recorded last.
    link: Option<(Link, bool)>,
    pub repeats: Repeats,
    pub flicker: Flicker,
}

/// A motion that is being measured.
#[derive(Debug)]
struct Measured {
    id: CommandId,
    part_id: Option<PartId>,
    curve: Curve,
    /// How it has ended, and until when its curve goes on.
    ended: Option<(Instant, std::sync::Arc<Ended>)>,
}

impl Recording {
    /// Time until which the oldest command waits for its record.
    pub(super) fn given_up_at(&self) -> Option<Instant> {
        self.unrecorded.front().map(|(until, _)| *until)
    }

    /// End of the tail of the curve that is being measured.
    pub(super) fn curve_ends_at(&self) -> Option<Instant> {
        Some(self.measured.as_ref()?.ended.as_ref()?.0)
    }

    /// Takes a record that nobody waits for.
    pub(super) fn push(&mut self, record: Record) {
        self.outbox.push_back((record, None));
    }

    /// Why records don't become durable.
    pub(super) fn failure(&self) -> Option<&str> {
        self.health.failure.as_deref()
    }
}

impl Actor {
    /// What is to be recorded next, and the command that waits for it: [`Actor::recorded`] says how that went.
    pub fn poll_record(&mut self) -> Option<(Record, Option<CommandId>)> {
        self.recording.outbox.pop_front()
    }

    /// A command's record is durable, or will not be soon.
    pub fn recorded(&mut self, now: Now, id: CommandId, durable: bool) {
        self.take_recorded(now, id, durable.then_some(()).ok_or("it did not take the record"));
        self.settle(now);
    }

    /// How the journal is.
    pub fn journal_health(&mut self, now: Now, health: Health) {
        self.recording.health = health;
        self.settle(now);
    }

    fn take_recorded(&mut self, now: Now, id: CommandId, durable: Result<(), &str>) {
        self.recording.unrecorded.retain(|(_, unrecorded)| *unrecorded != id);
        if self.running.as_ref().is_some_and(|running| running.id == id && !running.recorded) {
            if durable.is_ok() || self.config.on_journal_failure == OnJournalFailure::Continue {
                self.let_run();
            } else {
                let failure = self.journal_down(durable.err().unwrap_or_default());
                self.reject_running(now, failure.into());
            }
        }
        self.commands.recorded(id);
    }

    /// What could not be recorded in time goes on, or does not.
    pub(super) fn give_up_recording(&mut self, now: Now) {
        while let Some((until, id)) = self.recording.unrecorded.front().copied() {
            if until > now.instant {
                break;
            }
            tracing::warn!(gripper = %self.config.name, command = %id, "its record is not durable in time");
            self.take_recorded(now, id, Err("it has not taken the record in time"));
        }
    }

    /// Whether a motion may be admitted.
    pub(super) fn check_journal(&self) -> Result<(), Failure> {
        match (self.config.on_journal_failure, self.recording.failure()) {
            (OnJournalFailure::Refuse, Some(_)) => Err(self.journal_down("it takes none")),
            _ => Ok(()),
        }
    }

    /// By the journal's own words, where it has said some.
    fn journal_down(&self, cause: &str) -> Failure {
        Failure::JournalDown { cause: self.recording.failure().unwrap_or(cause).to_owned() }
    }

    pub(super) fn record(&mut self, event: Event) {
        self.recording.push(Record::Event(event, None));
    }

    pub(super) fn event(&self, now: Now, detail: Detail) -> Event {
        Event::new(now.wall, Some(self.config.name.clone()), detail)
    }

    pub(super) fn record_device(&mut self, now: Now, event: DeviceEvent) {
        let event = self.event(now, Detail::Device(event));
        self.record_change_of_device(now, event);
    }

    /// The first of a command's two records.
    pub(super) fn record_admitted(&mut self, now: Now, id: CommandId, submission: &Submission) {
        let admitted = Admitted {
            command: submission.action.kind(),
            request_id: submission.request_id.clone(),
            parameters: Parameters::from(&submission.action),
        };
        let detail = Detail::Command(CommandEvent::Admitted(admitted));
        let event = self.event(now, detail).by(&submission.client).of(id);
        self.recording.outbox.push_back((Record::Event(event, None), Some(id)));
        self.recording.unrecorded.push_back((now.instant + RECORDED_WITHIN, id));
    }

    /// The second.
    pub(super) fn record_done(&mut self, now: Now, client: &Client, command: &std::sync::Arc<Ended>) {
        let measured = self.recording.measured.as_ref().filter(|measured| measured.id == command.id);
        let part_id = measured.and_then(|measured| measured.part_id.clone());
        let detail = Detail::Command(CommandEvent::Done(Box::new(Done::of(command, part_id))));
        let event = self.event(now, detail).by(client).of(command.id);
        self.record(event);
        self.end_measuring(now, command);
    }

    pub(super) fn record_fast_stop(&mut self, now: Now, step: FastStopStep, by: Option<&Client>) {
        let Some(latch) = self.latch.current() else { return };
        let detail = Detail::FastStop(FastStopEvent {
            event: step,
            fast_stop_id: latch.id,
            cause: latch.cause,
            reason: latch.reason.as_str().to_owned(),
            count: 1,
        });
        self.metering.fast_stop(now.instant, step, latch.cause);
        let event = self.event(now, detail);
        let event = match by {
            Some(client) => event.by(client),
            None => event,
        };
        self.record_or_count(now, event, by);
    }

    /// Tells clients how their acknowledges ended, and writes it down.
    pub(super) fn tell_acknowledges(&mut self, now: Now) {
        for acknowledged in self.latch.take_acknowledged() {
            self.record_repeats();
            let cause = acknowledged.result.as_ref().err().map(ToString::to_string);
            let detail = Detail::Acknowledge(AcknowledgeEvent {
                fast_stop_id: acknowledged.id,
                cleared: cause.is_none(),
                cause,
            });
            let event = self.event(now, detail).by(&acknowledged.client);
            self.record(event);
            // Whoever asked may be gone.
            let _ = acknowledged.answer.send(acknowledged.result);
        }
    }

    /// A link that changes is written down once: not each attempt of one that can't be made.
    pub(super) fn record_link(&mut self, now: Now) {
        let link = (self.link_now(), self.link_cause.is_some());
        if self.recording.link.replace(link) == Some(link) {
            return;
        }
        let detail = Detail::Link(LinkEvent { link: link.0, link_cause: self.link_cause.clone() });
        let event = self.event(now, detail);
        self.record_change_of_device(now, event);
    }

    pub(super) fn record_flags(&mut self, now: Now, before: Option<SystemState>, flags: SystemState) {
        let before = before.unwrap_or_default() & SystemState::FAULTS;
        let faults = flags & SystemState::FAULTS;
        let (come, gone) = (faults - before, before - faults);
        if !come.is_empty() {
            self.record_device(now, DeviceEvent::Fault { flags: come.names().collect() });
        }
        if !gone.is_empty() {
            self.record_device(now, DeviceEvent::FaultCleared { flags: gone.names().collect() });
        }
    }

    pub(super) fn record_gripper_state(&mut self, now: Now, before: Option<GripperState>) {
        match self.observed.gripper_state {
            state if state == before => {}
            Some(GripperState::PartLost) => self.record_lost_part(now, before.is_none()),
            // A part that was let go, or a device that has restarted.
            Some(GripperState::Idle | GripperState::NoPart)
                if self.running.is_none() && !self.observed.part.is_held() =>
            {
                self.observed.part.take_grip();
            }
            _ => {}
        }
    }

    /// A part was lost: now, or while nobody looked. What was lost before the last run knew of it is no news.
    fn record_lost_part(&mut self, now: Now, is_first_look: bool) {
        let grip = self.observed.part.take_grip();
        if is_first_look && grip.is_none() {
            return;
        }
        tracing::warn!(gripper = %self.config.name, "the part is lost");
        self.metering.metrics.parts_lost.inc();
        let width_mm = self.observed.width_mm.filter(|_| self.observed.has(SystemState::REFERENCED));
        let event = self.event(now, Detail::Device(DeviceEvent::PartLost { width_mm }));
        let event = match grip {
            Some(grip) => event.of(grip),
            None => event,
        };
        self.record_change_of_device(now, event);
    }

    /// A motion is to be measured from now on.
    pub(super) fn start_measuring(&mut self, id: CommandId, motion: &Motion) {
        self.finish_measuring();
        let part_id = match motion {
            Motion::Grip { part_id, .. } => part_id.clone(),
            _ => None,
        };
        self.recording.measured = Some(Measured { id, part_id, curve: Curve::default(), ended: None });
    }

    /// Takes a sample, of values that are all known.
    pub(super) fn measure(&mut self, now: Now) {
        let observed = &self.observed;
        if let (Some(measured), Some(width), Some(speed), Some(force)) =
            (&mut self.recording.measured, observed.width_mm, observed.speed_mm_s, observed.force_n)
        {
            measured.curve.take(now.instant, width, speed, force);
        }
    }

    fn end_measuring(&mut self, now: Now, command: &std::sync::Arc<Ended>) {
        let Some(measured) = self.recording.measured.as_mut().filter(|measured| measured.id == command.id) else {
            return;
        };
        if command.outcome == Some(Outcome::Refused) {
            // Nothing has moved.
            self.recording.measured = None;
            return;
        }
        if command.outcome == Some(Outcome::PartHeld) {
            self.observed.part.gripped(command.id);
        }
        let tail = if command.kind == Kind::Grip { TAIL } else { Duration::ZERO };
        measured.ended = Some((now.instant + tail, command.clone()));
    }

    /// Records the curve as it is.
    pub(super) fn finish_measuring(&mut self) {
        let Some(Measured { part_id, curve, ended: Some((_, command)), .. }) = self.recording.measured.take() else {
            return;
        };
        let contact = curve.contact().filter(|_| command.kind == Kind::Grip);
        let peak_force_n = curve.peak_force_n();
        let curve = curve.into_samples();
        let record = GripRecord {
            id: command.id,
            gripper: command.gripper.clone(),
            kind: command.kind,
            part_id,
            outcome: command.outcome.unwrap_or(Outcome::Unknown),
            subject: command.client.clone(),
            started_at: command.started_at,
            duration_ms: command.duration_ms,
            width_mm: command.width_mm,
            force_n: command.force_n,
            peak_force_n,
            contact_width_mm: contact.map(|contact| contact.width_mm),
            time_to_contact_ms: contact.map(|contact| contact.after_ms),
            samples: curve.len(),
            curve,
        };
        self.recording.push(Record::Grip(Box::new(record)));
    }
}
