//! Slows the automatic updates down on a link that cannot carry them, although its transport has no known rate: a serial
//! device server behind TCP or UDP. Its buffer then fills up, so that values arrive late, or not at all.

use std::time::{Duration, Instant};

use super::Purpose;
use crate::Now;
use crate::actor::Actor;
use crate::automatic_updates;
use model::UpdateRules;

/// Period of measuring the round trip.
const MEASURED_EVERY: Duration = Duration::from_secs(1);

/// Round trip that counts as long. A network in a plant takes a few milliseconds, a wireless one some tens.
const LONG_ROUND_TRIP: Duration = Duration::from_millis(250);

/// Loops in a row without an echo that count as a long round trip.
const LOST_LOOPS: u32 = 2;

/// Longest period in ms that updates are slowed down to: what 2400 baud can carry.
const LONGEST_PERIOD_MS: u16 = 560;

/// The pace of the updates on the current link.
#[derive(Debug, Default)]
pub(in crate::actor) struct Pacing {
    /// Period in ms that the updates were slowed down to; 0 if they were not.
    slowed_to_ms: u16,
    /// Whether the last round trip was long. A single one can come from a short disturbance.
    was_long: bool,
    measured_at: Option<Instant>,
}

impl Pacing {
    /// Whether the link cannot carry its updates at their own period.
    pub(in crate::actor) fn is_slow(&self) -> bool {
        self.slowed_to_ms > 0
    }
}

impl Actor {
    /// Rules of the updates on the current link.
    pub(in crate::actor) fn update_rules(&self) -> UpdateRules {
        let rules = self.config.rules.updates;
        UpdateRules { min_period_ms: rules.min_period_ms.max(self.pacing.slowed_to_ms), ..rules }
    }

    /// Begins to measure a link of unknown rate.
    pub(in crate::actor) fn start_pacing(&mut self, now: Now) {
        if std::mem::take(&mut self.pacing).slowed_to_ms > 0 {
            self.set_pace();
        }
        let is_unknown = self.link.properties.bytes_per_second.is_none();
        self.pacing.measured_at = is_unknown.then(|| now.instant + MEASURED_EVERY);
    }

    pub(in crate::actor) fn round_trip_due(&self) -> Option<Instant> {
        self.pacing.measured_at.filter(|_| self.is_in_use())
    }

    /// Measures the round trip once more.
    pub(in crate::actor) fn measure_round_trip(&mut self, now: Now) {
        self.pacing.measured_at = Some(now.instant + MEASURED_EVERY);
        let Some(session) = &mut self.link.session else { return };
        session.probe();
        if session.unanswered_loops() >= LOST_LOOPS && !self.link.is_silent(now.instant, LONG_ROUND_TRIP) {
            self.took_round_trip(now, LONG_ROUND_TRIP);
        }
    }

    /// Takes a round trip of Loop.
    pub(in crate::actor) fn took_round_trip(&mut self, now: Now, round_trip: Duration) {
        if self.round_trip_due().is_none() {
            return;
        }
        let is_long = round_trip >= LONG_ROUND_TRIP;
        if std::mem::replace(&mut self.pacing.was_long, is_long) && is_long {
            self.slow_down(now, round_trip);
        }
    }

    fn slow_down(&mut self, now: Now, round_trip: Duration) {
        let period_ms = automatic_updates::period_ms(self.update_rules(), None);
        let slower_ms = period_ms.saturating_mul(2).min(LONGEST_PERIOD_MS);
        if slower_ms <= period_ms {
            return;
        }
        self.pacing.slowed_to_ms = slower_ms;
        self.pacing.was_long = false;
        self.set_pace();
        tracing::warn!(gripper = %self.config.name, round_trip_ms = round_trip.as_millis() as u64, period_ms = slower_ms,
            "the link cannot carry its updates: they are slowed down until the next connection");
        for command in automatic_updates::switch_on_all(self.update_rules(), self.link.properties.bytes_per_second) {
            self.observed.requested(now.instant, command.id());
            // A full queue counts as no reply: silent getters are requested again later.
            let _ = self.link.submit(now, command, Purpose::Upkeep);
        }
    }

    fn set_pace(&mut self) {
        let rules = self.update_rules();
        let bytes_per_second = self.link.properties.bytes_per_second;
        self.observed.set_rules(rules, bytes_per_second);
        let period_ms = automatic_updates::period_ms(rules, bytes_per_second);
        self.publication.change_info(|info| info.update_period_ms = period_ms);
    }
}
