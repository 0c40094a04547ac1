//! Measuring of motions.

use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::Timestamp;

use super::Recording;
use crate::Now;
use crate::curve::{Contact, MotionCurve, TAIL};
use crate::recorder::Record;
use model::{CommandId, CommandReport, GripRecord, Motion, Outcome, PartId, Values};

/// A motion being measured.
#[derive(Debug)]
pub(in crate::actor) struct MeasuredMotion {
    id: CommandId,
    part_id: Option<PartId>,
    serial_number: Option<u32>,
    curve: MotionCurve,
    /// Time at which the frame of the first sample arrived.
    measured_at: Option<Timestamp>,
    /// Contact as judged at the end of a grip with a part.
    contact: Option<Contact>,
    /// End time of the curve, and the ended command.
    ended: Option<(Instant, Arc<CommandReport>)>,
}

impl Recording {
    pub(in crate::actor) fn start_measuring(&mut self, id: CommandId, motion: &Motion, serial_number: Option<u32>) {
        self.finish_measuring();
        let part_id = match motion {
            Motion::Grip { part_id, .. } => part_id.clone(),
            _ => None,
        };
        let curve = MotionCurve::default();
        self.measured =
            Some(MeasuredMotion { id, part_id, serial_number, curve, measured_at: None, contact: None, ended: None });
    }

    /// Takes a sample, if all values are known.
    pub(in crate::actor) fn measure(&mut self, now: Now, values: &Values) {
        let Some(measured) = &mut self.measured else { return };
        if let (Some(width), Some(speed), Some(force)) =
            (values.width_mm(now.instant), values.speed_mm_s(now.instant), values.force_n(now.instant))
        {
            measured.measured_at = measured.measured_at.or_else(|| values.measured_at(now.instant));
            measured.curve.take(now.instant, width, speed, force);
        }
    }

    /// Name of the part that the measured command grips.
    pub(super) fn measured_part(&self, id: CommandId) -> Option<PartId> {
        self.measured.as_ref().filter(|measured| measured.id == id)?.part_id.clone()
    }

    /// Determines the contact of a grip that has ended with a part, and returns its width in mm. The record of the grip
    /// has the same contact, however the force develops afterwards.
    pub(in crate::actor) fn judge_contact(&mut self, id: CommandId) -> Option<f32> {
        let measured = self.measured.as_mut().filter(|measured| measured.id == id)?;
        measured.contact = measured.curve.contact();
        measured.contact.map(|contact| contact.width_mm)
    }

    /// Force with the greatest magnitude that was measured during this command, in N.
    pub(in crate::actor) fn peak_force_n(&self, id: CommandId) -> Option<f32> {
        self.measured.as_ref().filter(|measured| measured.id == id)?.curve.peak_force_n()
    }

    /// End of the current curve's tail.
    pub(in crate::actor) fn curve_ends_at(&self) -> Option<Instant> {
        Some(self.measured.as_ref()?.ended.as_ref()?.0)
    }

    /// Takes the end of the measured command. A grip's curve continues for its tail.
    pub(super) fn end_measuring(&mut self, now: Now, command: &Arc<CommandReport>) {
        // A refused command moved nothing.
        self.measured.take_if(|measured| measured.id == command.id && command.outcome == Some(Outcome::Refused));
        if let Some(measured) = self.measured.as_mut().filter(|measured| measured.id == command.id) {
            let tail = if command.kind.is_grip() { TAIL } else { Duration::ZERO };
            measured.ended = Some((now.instant + tail, command.clone()));
        }
    }

    /// Records the curve so far.
    pub(in crate::actor) fn finish_measuring(&mut self) {
        let Some(measured) = self.measured.take() else { return };
        let MeasuredMotion { part_id, serial_number, curve, measured_at, contact, ended: Some((_, command)), .. } =
            measured
        else {
            return;
        };
        let contact = contact.or_else(|| curve.contact()).filter(|_| command.kind.is_grip());
        let peak_force_n = curve.peak_force_n();
        let travel_mm = curve.travel_mm();
        let curve = curve.into_samples();
        let record = GripRecord {
            id: command.id,
            gateway: self.gateway.clone(),
            gripper: command.gripper.clone(),
            serial_number,
            kind: command.kind,
            part_id,
            outcome: command.outcome.unwrap_or(Outcome::Unknown),
            code: command.code,
            detail: command.detail.clone(),
            subject: command.client.clone(),
            requested: command.requested.clone(),
            started_at: command.started_at,
            duration_ms: command.duration_ms,
            width_mm: command.width_mm,
            force_n: command.force_n,
            peak_force_n,
            travel_mm,
            contact_width_mm: contact.map(|contact| contact.width_mm),
            time_to_contact_ms: contact.map(|contact| contact.after_ms),
            measured_at,
            samples: curve.len(),
            curve,
        };
        self.push(Record::Grip(Box::new(record)));
    }
}
