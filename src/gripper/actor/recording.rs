//! Records for the journal, and the commands that wait until theirs are durable.
//!
//! A motion's frame is sent, and its client is answered, only after its `admitted` record is durable. So the journal
//! has every command that a client knows of, even after a crash. FAST STOPs and the frames of Stops do not wait.

mod measuring;
mod persistence;
mod rapid_changes;
mod repeats;

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use super::super::Now;
use super::super::recorder::{JournalHealth, Record};
use measuring::MeasuredMotion;
use model::error::Failure;
use model::{
    Admitted, Client, CommandEvent, CommandId, CommandReport, Detail, DeviceEvent, Done, Event, FastStopEvent,
    FastStopStep, Latch, LeaseEvent, Link, LinkEvent, Name, OnJournalFailure, Parameters, Submission,
};
use persistence::LastReported;
use rapid_changes::Flicker;
use repeats::Repeats;
use wsg::SystemState;

/// Time limit for a command's record to become durable. When it expires, the command is refused, or it proceeds without
/// the record if `on_journal_failure` is `continue`. Either happens at once: no command waits longer for the journal.
const RECORDED_WITHIN: Duration = Duration::from_millis(500);

/// The gripper's side of the journal.
#[derive(Debug)]
pub(super) struct Recording {
    pub gateway: Name,
    pub gripper: Name,
    on_failure: OnJournalFailure,
    /// Records for the driver to take after each input, with the commands that wait for them.
    outbox: VecDeque<(Record, Option<CommandId>)>,
    /// Commands whose records are not durable yet, oldest first, each with the end of its wait.
    unrecorded: VecDeque<(Instant, CommandId)>,
    pub health: JournalHealth,
    /// The motion being measured.
    pub measured: Option<MeasuredMotion>,
    /// Link state as last recorded.
    link: Option<(Link, bool)>,
    pub reported: LastReported,
    pub repeats: Repeats,
    pub flicker: Flicker,
}

impl Recording {
    pub(super) fn new(gateway: Name, gripper: Name, on_failure: OnJournalFailure) -> Self {
        Self {
            gateway,
            gripper,
            on_failure,
            outbox: VecDeque::new(),
            unrecorded: VecDeque::new(),
            health: JournalHealth::default(),
            measured: None,
            link: None,
            reported: LastReported::default(),
            repeats: Repeats::default(),
            flicker: Flicker::default(),
        }
    }

    pub(super) fn set_on_failure(&mut self, on_failure: OnJournalFailure) {
        self.on_failure = on_failure;
    }

    pub(super) fn poll(&mut self) -> Option<(Record, Option<CommandId>)> {
        self.outbox.pop_front()
    }

    /// Adds a record that no command waits for.
    pub(super) fn push(&mut self, record: Record) {
        self.outbox.push_back((record, None));
    }

    /// Reason that records do not become durable.
    pub(super) fn failure(&self) -> Option<&str> {
        self.health.failure.as_deref()
    }

    /// Checks that a motion can be admitted.
    pub(super) fn check(&self) -> Result<(), Failure> {
        match (self.on_failure, self.failure()) {
            (OnJournalFailure::Refuse, Some(_)) => Err(self.journal_down("records are not being stored")),
            _ => Ok(()),
        }
    }

    /// Ends the wait for a command's record. An error means that the command must not proceed.
    pub(super) fn end_wait(&mut self, id: CommandId, durable: Result<(), &str>) -> Result<(), Failure> {
        self.unrecorded.retain(|(_, unrecorded)| *unrecorded != id);
        match durable {
            Err(cause) if self.on_failure == OnJournalFailure::Refuse => Err(self.journal_down(cause)),
            _ => Ok(()),
        }
    }

    /// The oldest command whose record is not durable yet, with the end of its wait.
    pub(super) fn oldest_wait(&self) -> Option<(Instant, CommandId)> {
        self.unrecorded.front().copied()
    }

    /// A failure with the journal's own reason, or with `cause` if it has none.
    fn journal_down(&self, cause: &str) -> Failure {
        Failure::JournalDown { cause: self.failure().unwrap_or(cause).to_owned() }
    }

    pub(super) fn event(&self, now: Now, detail: Detail) -> Event {
        Event::new(now.wall, Some(self.gripper.clone()), detail)
    }

    pub(super) fn record(&mut self, event: Event) {
        self.push(Record::Event(event, None));
    }

    /// Records a change of the device. Returns whether it was recorded at once, and not only counted.
    pub(super) fn device(&mut self, now: Now, event: DeviceEvent) -> bool {
        let event = self.event(now, Detail::Device(event));
        self.change_of_device(now, event)
    }

    /// Records the admission of a command.
    pub(super) fn admitted(&mut self, now: Now, command: &CommandReport, submission: &Submission) {
        let admitted = Admitted {
            command: command.kind,
            holder: command.requested.holder.clone(),
            request_id: submission.request_id.clone(),
            parameters: Parameters::from(&submission.action),
        };
        let detail = Detail::Command(CommandEvent::Admitted(Box::new(admitted)));
        let event = self.event(now, detail).by(&submission.client).of(command.id);
        self.outbox.push_back((Record::Event(event, None), Some(command.id)));
        self.unrecorded.push_back((now.instant + RECORDED_WITHIN, command.id));
    }

    /// Records the end of a command.
    pub(super) fn done(&mut self, now: Now, client: &Client, command: &std::sync::Arc<CommandReport>) {
        let part_id = self.measured_part(command.id);
        let detail = Detail::Command(CommandEvent::Done(Box::new(Done::of(command, part_id))));
        let event = self.event(now, detail).by(client).of(command.id);
        self.record(event);
        self.end_measuring(now, command);
    }

    pub(super) fn lease(&mut self, now: Now, event: LeaseEvent, client: &Client) {
        let event = self.event(now, Detail::Lease(event)).by(client);
        self.record(event);
    }

    pub(super) fn fast_stop(&mut self, now: Now, step: FastStopStep, latch: &Latch, by: Option<&Client>) {
        let detail = Detail::FastStop(FastStopEvent {
            event: step,
            fast_stop_id: latch.id,
            cause: latch.cause,
            reason: latch.reason.as_str().to_owned(),
            count: 1,
        });
        let event = self.event(now, detail);
        let event = match by {
            Some(client) => event.by(client),
            None => event,
        };
        self.record_or_count(now, event, by);
    }

    /// Records a change of the link, but not each failed attempt to connect.
    pub(super) fn link(&mut self, now: Now, link: Link, link_cause: Option<String>) {
        let change = (link, link_cause.is_some());
        if self.link.replace(change) == Some(change) {
            return;
        }
        let event = self.event(now, Detail::Link(LinkEvent { link, link_cause }));
        self.change_of_device(now, event);
    }

    pub(super) fn flags(&mut self, now: Now, before: Option<SystemState>, flags: SystemState) {
        let before = before.unwrap_or_default() & SystemState::FAULTS;
        let faults = flags & SystemState::FAULTS;
        let come = faults - before;
        let gone = before - faults;
        if !come.is_empty() {
            self.device(now, DeviceEvent::Fault { flags: come.names().collect() });
        }
        if !gone.is_empty() {
            self.device(now, DeviceEvent::FaultCleared { flags: gone.names().collect() });
        }
    }

    pub(super) fn streamed(&mut self, now: Now, raw_id: u8, client: &Client, count: u64) {
        let event = self.event(now, Detail::Device(DeviceEvent::Streamed { raw_id, count })).by(client);
        self.record(event);
    }

    pub(super) fn servo(&mut self, now: Now, event: DeviceEvent, client: &Client) {
        let event = self.event(now, Detail::Device(event)).by(client);
        self.record(event);
    }

    pub(super) fn stream_silent(&mut self, now: Now, raw_id: u8) {
        let event = self.event(now, Detail::Device(DeviceEvent::StreamSilent { raw_id }));
        self.record(event);
    }

    /// Records everything that was counted or is being measured.
    pub(super) fn finish(&mut self, now: Now) {
        self.finish_measuring();
        self.record_repeats();
        self.record_flicker(now);
    }
}
