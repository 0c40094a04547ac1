//! Values that the device should report and does not.

use std::time::Instant;

use super::super::Now;
use super::Actor;
use super::link::UNRESPONSIVE_AFTER;
use model::error::Failure;
use model::{DeviceEvent, Missing};
use wsg::session::NoValue;
use wsg::{InvalidReply, id};

impl Actor {
    /// Takes a reply or an update without its value.
    pub(super) fn take_no_value(&mut self, id: u8, reason: NoValue) {
        let missing = match reason {
            NoValue::Refused(status) => Missing::Refused(status),
            NoValue::Invalid(InvalidReply::Size { .. }) => Missing::Unreadable,
            NoValue::Invalid(InvalidReply::Number { .. } | InvalidReply::Value { .. }) => Missing::Impossible,
        };
        self.observed.lose(id, missing);
    }

    /// Marks the values that have become unknown, and records changes.
    pub(super) fn expire_values(&mut self, now: Now) {
        self.observed.values.expire(now.instant);
        if !self.link.is_up() || self.link.is_silent(now.instant, self.observed.good_for) {
            // The state of the link says more.
            return;
        }
        let Some(report) = self.observed.report(now.instant) else { return };
        let mut lost = report.lost;
        while let Some(&(_, missing)) = lost.first() {
            let same = lost.extract_if(.., |(_, other)| *other == missing);
            let values: Vec<_> = same.map(|(name, _)| name).collect();
            let cause = missing.to_string();
            let event = DeviceEvent::ValuesUnknown { values: values.clone(), cause: cause.clone() };
            // The log leaves out what the journal only counts.
            if self.recording.device(now, event) {
                tracing::warn!(gripper = %self.config.name, ?values, cause, "value unknown");
            }
        }
        if !report.found.is_empty() {
            let event = DeviceEvent::ValuesKnown { values: report.found.clone() };
            if self.recording.device(now, event) {
                tracing::info!(gripper = %self.config.name, values = ?report.found, "value known again");
            }
        }
    }

    /// Description of the unknown values, if the flags are among them.
    fn unknown_flags(&self, now: Now) -> Option<String> {
        self.observed.values.flags.missing(now.instant)?;
        let missing = self.observed.values.missing(now.instant);
        let described: Vec<_> = missing.map(|(name, missing)| format!("{name} ({missing})")).collect();
        Some(format!("values of the device are unknown: {}", described.join(", ")))
    }

    /// Time at which unknown flags make the link unresponsive.
    fn flags_end_at(&self) -> Option<Instant> {
        let flags = &self.observed.values.flags;
        let end = flags.arrived_at()? + UNRESPONSIVE_AFTER.max(self.observed.good_for);
        Some(flags.ends_at().map_or(end, |awaited_until| end.max(awaited_until)))
    }

    pub(super) fn silence_at(&self) -> Option<Instant> {
        self.link.silence_at(self.flags_end_at()).filter(|_| self.drain.is_none())
    }

    /// Handles silence of the device, its flags alone included, and their end.
    pub(super) fn supervise(&mut self, now: Now) {
        let is_overdue = self.flags_end_at().is_some_and(|at| at <= now.instant);
        let unknown = if is_overdue { self.unknown_flags(now) } else { None };
        if self.link.supervise(now.instant, unknown) {
            tracing::info!(gripper = %self.config.name, "device responsive again");
            self.set_up_again(now);
        }
    }

    /// Checks that the flags are known: without them, nobody can tell whether a motion is safe.
    pub(super) fn check_flags(&self, now: Now) -> Result<(), Failure> {
        match self.unknown_flags(now) {
            Some(cause) => Err(Failure::FlagsUnknown { cause }),
            None => Ok(()),
        }
    }

    /// Rejection of a query whose value is unknown.
    pub(super) fn no_value(&self, now: Now, id: u8) -> Failure {
        let values = &self.observed.values;
        let missing = match id {
            id::GET_SYSTEM_STATE => values.flags.missing(now.instant),
            id::GET_GRIPPER_STATE => values.state.missing(now.instant),
            id::GET_WIDTH => values.width.missing(now.instant),
            id::GET_SPEED => values.speed.missing(now.instant),
            _ => values.force.missing(now.instant),
        };
        let command = id::name(id).unwrap_or("the getter");
        match missing {
            Some(missing) => Failure::ValueUnknown { command, cause: missing.to_string() },
            None => Failure::NoValueYet { command },
        }
    }
}
