//! What is counted of the gripper on the way: of its link's sessions, of its commands and of its FAST STOPs.

use std::time::Instant;

use prometheus::IntCounter;

use super::super::Now;
use super::super::model::{Command as Ended, FastStopCause, FastStopStep, Kind, Outcome};
use super::Actor;
use crate::wsg::DecoderCounters;
use crate::wsg::session::Counters;

/// How far it was counted.
#[derive(Debug, Default)]
pub(super) struct Metering {
    /// Of the session at hand, which counts from 0.
    sent: Counters,
    received: DecoderCounters,
    /// Whether the link at hand has not been set up yet.
    is_new_link: bool,
    /// Since when a FAST STOP waits to be sent, and to be confirmed.
    unsent: Option<Instant>,
    unconfirmed: Option<Instant>,
}

impl Metering {
    /// A session begins.
    pub(super) fn link_up(&mut self) {
        *self = Self { is_new_link: true, unsent: self.unsent, unconfirmed: self.unconfirmed, ..Self::default() };
    }

    /// A FAST STOP was requested. Of several the one that waits the longest counts.
    pub(super) fn fast_stop_requested(&mut self, at: Instant) {
        self.unsent.get_or_insert(at);
        self.unconfirmed.get_or_insert(at);
    }
}

impl Actor {
    /// Counts what the session has seen since this was called last: to be called before a session ends.
    pub(super) fn meter_session(&mut self) {
        let Some(session) = &mut self.session else { return };
        let metrics = &self.config.metrics;
        if let Some(round_trip) = session.take_round_trip() {
            metrics.round_trip.observe(round_trip.as_secs_f64());
        }
        let (sent, received) = (session.counters(), session.decoder_counters());
        let (sent_before, received_before) = (self.metering.sent, self.metering.received);
        let count = |counter: &IntCounter, now: u64, before: u64| {
            if now > before {
                counter.inc_by(now - before);
            }
        };
        if sent != sent_before {
            count(&metrics.frames_sent, sent.frames_sent, sent_before.frames_sent);
            count(&metrics.bytes_sent, sent.bytes_sent, sent_before.bytes_sent);
            count(&metrics.late_replies, sent.late_replies, sent_before.late_replies);
            count(&metrics.stray_replies, sent.stray_replies, sent_before.stray_replies);
            count(&metrics.invalid_replies, sent.invalid_replies, sent_before.invalid_replies);
            count(&metrics.timeouts, sent.time_outs, sent_before.time_outs);
        }
        if received != received_before {
            count(&metrics.frames_received, received.frames, received_before.frames);
            count(&metrics.bytes_received, received.bytes, received_before.bytes);
            count(&metrics.checksum_errors, received.checksum_errors, received_before.checksum_errors);
            count(&metrics.resynchronisations, received.resynchronisations, received_before.resynchronisations);
        }
        (self.metering.sent, self.metering.received) = (sent, received);
    }

    /// The link was set up, perhaps again.
    pub(super) fn meter_set_up(&mut self) {
        if std::mem::take(&mut self.metering.is_new_link) && self.was_connected {
            self.config.metrics.reconnects.inc();
        }
    }

    pub(super) fn meter_ended(&self, command: &Ended) {
        let Some(outcome) = command.outcome else { return };
        let (kind, metrics) = (command.kind.name(), &self.config.metrics);
        metrics.commands.with_label_values(&[kind, outcome.name()]).inc();
        if let (Some(duration_ms), false) =
            (command.duration_ms, command.kind == Kind::Stop || outcome == Outcome::Refused)
        {
            metrics.motions.with_label_values(&[kind]).observe(duration_ms as f64 / 1000.0);
        }
    }

    pub(super) fn meter_fast_stop_sent(&mut self, now: Now) {
        if let Some(since) = self.metering.unsent.take() {
            let latency = now.instant.saturating_duration_since(since);
            self.config.metrics.fast_stop_sent.observe(latency.as_secs_f64());
        }
    }

    pub(super) fn meter_fast_stop(&mut self, now: Now, step: FastStopStep, cause: FastStopCause) {
        match (step, self.metering.unconfirmed) {
            (FastStopStep::Latched, _) => self.config.metrics.fast_stops.with_label_values(&[cause.name()]).inc(),
            (FastStopStep::Confirmed, Some(since)) => {
                self.metering.unconfirmed = None;
                let latency = now.instant.saturating_duration_since(since);
                self.config.metrics.fast_stop_confirmed.observe(latency.as_secs_f64());
            }
            (FastStopStep::Confirmed, None) => {}
        }
    }
}
