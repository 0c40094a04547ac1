//! Effects of journal replies and device events on commands and parts.

use super::super::Now;
use super::super::observed::HeldPart;
use super::super::recorder::{JournalHealth, Record};
use super::Actor;
use model::{AcknowledgeEvent, Client, CommandId, Detail, DeviceEvent, FastStopStep};
use wsg::GripperState;

impl Actor {
    /// The next record, and the command that waits for it. [`Actor::recorded`] takes the result.
    pub fn poll_record(&mut self) -> Option<(Record, Option<CommandId>)> {
        self.recording.poll()
    }

    /// Takes the result for a command's record: durable, or failed.
    pub fn recorded(&mut self, now: Now, id: CommandId, durable: bool) {
        self.take_recorded(now, id, durable.then_some(()).ok_or("the record was not stored"));
        self.after_input(now);
    }

    pub fn journal_health(&mut self, now: Now, health: JournalHealth) {
        self.recording.health = health;
        self.after_input(now);
    }

    fn take_recorded(&mut self, now: Now, id: CommandId, durable: Result<(), &str>) {
        let result = self.recording.end_wait(id, durable);
        if self.motion.waits_for_record(id) {
            match result {
                Ok(()) => self.motion.let_run(),
                Err(failure) => self.reject_running(now, failure.into()),
            }
        }
        self.commands.recorded(id);
    }

    /// Ends the wait of commands whose records did not become durable in time.
    pub(super) fn give_up_recording(&mut self, now: Now) {
        while let Some((_, id)) = self.recording.oldest_wait().filter(|(until, _)| *until <= now.instant) {
            tracing::warn!(gripper = %self.config.name, command = %id, "command record not durable in time");
            self.take_recorded(now, id, Err("the record was not durable in time"));
        }
    }

    pub(super) fn record_fast_stop(&mut self, now: Now, step: FastStopStep, by: Option<&Client>) {
        let Some(latch) = self.latch.current() else { return };
        self.metering.fast_stop(now.instant, step, latch.cause);
        self.recording.fast_stop(now, step, latch, by);
    }

    /// Records the results of acknowledgements, and sends them to their clients.
    pub(super) fn send_acknowledge_results(&mut self, now: Now) {
        for acknowledged in self.latch.take_acknowledged() {
            if acknowledged.result.is_ok() && self.observed.last_state() != Some(GripperState::Holding) {
                // The fingers have no force after an acknowledgement, so nothing is held for a lost client either.
                self.observed.part = HeldPart::default();
            }
            self.recording.record_repeats();
            let cause = acknowledged.result.as_ref().err().map(ToString::to_string);
            let detail = Detail::Acknowledge(AcknowledgeEvent {
                fast_stop_id: acknowledged.id,
                cleared: cause.is_none(),
                cause,
            });
            let event = self.recording.event(now, detail).by(&acknowledged.client);
            self.recording.record(event);
            // The caller may be gone.
            let _ = acknowledged.answer.send(acknowledged.result);
        }
    }

    pub(super) fn record_gripper_state(&mut self, now: Now, before: Option<GripperState>) {
        match self.observed.last_state() {
            state if state == before => {}
            Some(GripperState::PartLost) => self.record_lost_part(now, before.is_none()),
            // The part was released, or the device has restarted.
            Some(GripperState::Idle | GripperState::NoPart)
                if self.motion.running.is_none() && !self.observed.part.is_held =>
            {
                self.observed.part.grip = None;
            }
            _ => {}
        }
    }

    /// Records a lost part. If the first known gripper state already shows the loss and no grip is known, the part was
    /// lost earlier, and nothing is recorded.
    fn record_lost_part(&mut self, now: Now, is_first_look: bool) {
        let grip = self.observed.part.grip.take();
        if is_first_look && grip.is_none() {
            return;
        }
        tracing::warn!(gripper = %self.config.name, "part lost");
        self.metering.metrics.parts_lost.inc();
        let width_mm = self.observed.values.width_mm(now.instant);
        let event = self.recording.event(now, Detail::Device(DeviceEvent::PartLost { width_mm }));
        let event = match grip {
            Some(grip) => event.of(grip),
            None => event,
        };
        self.recording.change_of_device(now, event);
    }
}
