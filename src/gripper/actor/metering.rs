//! Metering of a gripper: sessions of its link, commands and FAST STOPs.

use std::time::{Duration, Instant};

use prometheus::IntCounter;

use super::super::metrics::{GripperMetrics, SERVO_ACCEPTED, SERVO_REFUSED, SERVO_SUPERSEDED};
use model::{CommandReport, FastStopCause, FastStopStep, Kind, Outcome, ServoReport};
use wsg::DecoderCounters;
use wsg::session::{Counters, Session};

/// Metrics of the gripper, and the session counters already included in them.
#[derive(Debug)]
pub(super) struct Metering {
    pub metrics: GripperMetrics,
    /// Counters of the current session, as last seen. They begin at 0.
    sent: Counters,
    received: DecoderCounters,
    /// Whether the current link has not been set up yet.
    is_new_link: bool,
    /// Time of the oldest FAST STOP that waits to be sent.
    unsent: Option<Instant>,
    /// Time of the oldest FAST STOP that waits to be confirmed.
    unconfirmed: Option<Instant>,
}

impl Metering {
    pub(super) fn new(metrics: GripperMetrics) -> Self {
        let sent = Counters::default();
        let received = DecoderCounters::default();
        Self { metrics, sent, received, is_new_link: false, unsent: None, unconfirmed: None }
    }

    /// Starts the counters of a new session.
    pub(super) fn link_up(&mut self) {
        (self.sent, self.received) = (Counters::default(), DecoderCounters::default());
        self.is_new_link = true;
    }

    /// Adds the session's counts since the last call. Has to be called before a session ends. Returns the round trip of
    /// a Loop, if an echo has arrived.
    pub(super) fn session(&mut self, session: Option<&mut Session>) -> Option<Duration> {
        let session = session?;
        let metrics = &self.metrics;
        let loop_round_trip = session.take_loop_round_trip();
        for round_trip in loop_round_trip.into_iter().chain(session.take_round_trip()) {
            metrics.round_trip.observe(round_trip.as_secs_f64());
        }
        let sent = session.counters();
        let received = session.decoder_counters();
        if sent != self.sent {
            count(&metrics.frames_sent, sent.frames_sent, self.sent.frames_sent);
            count(&metrics.bytes_sent, sent.bytes_sent, self.sent.bytes_sent);
            count(&metrics.late_replies, sent.late_replies, self.sent.late_replies);
            count(&metrics.stray_replies, sent.stray_replies, self.sent.stray_replies);
            count(&metrics.invalid_replies, sent.invalid_replies, self.sent.invalid_replies);
            count(&metrics.timeouts, sent.time_outs, self.sent.time_outs);
        }
        if received != self.received {
            count(&metrics.frames_received, received.frames, self.received.frames);
            count(&metrics.bytes_received, received.bytes, self.received.bytes);
            count(&metrics.checksum_errors, received.checksum_errors, self.received.checksum_errors);
            count(&metrics.resynchronisations, received.resynchronisations, self.received.resynchronisations);
        }
        (self.sent, self.received) = (sent, received);
        loop_round_trip
    }

    /// Counts a reconnection after the setup of a new link.
    pub(super) fn set_up(&mut self, was_connected: bool) {
        if std::mem::take(&mut self.is_new_link) && was_connected {
            self.metrics.reconnects.inc();
        }
    }

    pub(super) fn ended(&self, command: &CommandReport) {
        let Some(outcome) = command.outcome else { return };
        let kind = command.kind.name();
        self.metrics.commands.with_label_values(&[kind, outcome.name()]).inc();
        if let (Some(duration_ms), false) =
            (command.duration_ms, command.kind == Kind::Stop || outcome == Outcome::Refused)
        {
            self.metrics.motions.with_label_values(&[kind]).observe(duration_ms as f64 / 1000.0);
        }
    }

    /// Counts a target of a servo session.
    pub(super) fn servo_target(&self, is_accepted: bool) {
        let result = if is_accepted { SERVO_ACCEPTED } else { SERVO_REFUSED };
        self.metrics.servo_targets.with_label_values(&[result]).inc();
    }

    pub(super) fn servo_ended(&self, report: &ServoReport) {
        self.metrics.servo_targets.with_label_values(&[SERVO_SUPERSEDED]).inc_by(report.superseded);
        if let Some(reason) = report.ended {
            self.metrics.servo_sessions.with_label_values(&[reason.name()]).inc();
        }
    }

    /// Starts the time of a FAST STOP. If several wait, the oldest counts.
    pub(super) fn fast_stop_requested(&mut self, at: Instant) {
        self.unsent.get_or_insert(at);
        self.unconfirmed.get_or_insert(at);
    }

    pub(super) fn fast_stop_sent(&mut self, now: Instant) {
        if let Some(since) = self.unsent.take() {
            self.metrics.fast_stop_sent.observe(now.saturating_duration_since(since).as_secs_f64());
        }
    }

    pub(super) fn fast_stop(&mut self, now: Instant, step: FastStopStep, cause: FastStopCause) {
        match step {
            FastStopStep::Latched => self.metrics.fast_stops.with_label_values(&[cause.name()]).inc(),
            FastStopStep::Confirmed => {
                if let Some(since) = self.unconfirmed.take() {
                    self.metrics.fast_stop_confirmed.observe(now.saturating_duration_since(since).as_secs_f64());
                }
            }
        }
    }
}

/// Adds what a counter of the session has counted since `before`.
fn count(counter: &IntCounter, now: u64, before: u64) {
    if now > before {
        counter.inc_by(now - before);
    }
}
