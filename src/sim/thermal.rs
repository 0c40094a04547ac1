//! The temperature, which follows the load slowly unless a change fixes it.

use std::time::{Duration, Instant};

/// Time constant in s with which the temperature approaches its final value.
const TIME_CONSTANT_S: f64 = 600.0;

/// Temperature rise over ambient at the nominal force, in K. It grows with the square of the force, so Overdrive Mode
/// can overheat the device (`fw4-en 3.3.8`).
const RISE_AT_NOMINAL_K: f64 = 25.0;

#[derive(Debug)]
pub(super) struct Thermal {
    ambient_c: f64,
    /// Share of the nominal force since `since`, when the temperature was `initial_c`.
    load: f64,
    since: Instant,
    initial_c: f64,
    held_c: Option<f64>,
}

impl Thermal {
    pub fn new(ambient_c: f64, now: Instant) -> Self {
        Self { ambient_c, load: 0.0, since: now, initial_c: ambient_c, held_c: None }
    }

    pub fn temperature_c(&self, now: Instant) -> f64 {
        self.held_c.unwrap_or_else(|| self.own_c(now))
    }

    /// Fixes the temperature until [`Thermal::let_go`].
    pub fn hold(&mut self, temperature_c: f64) {
        self.held_c = Some(temperature_c);
    }

    pub fn let_go(&mut self) {
        self.held_c = None;
    }

    pub fn set_load(&mut self, load: f64, now: Instant) {
        if (load - self.load).abs() > f64::EPSILON {
            self.initial_c = self.own_c(now);
            (self.load, self.since) = (load, now);
        }
    }

    /// Time after `now` at which the temperature crosses `threshold_c` by itself.
    pub fn crosses(&self, threshold_c: f64, now: Instant) -> Option<Instant> {
        let ratio = (self.initial_c - self.final_c()) / (threshold_c - self.final_c());
        if self.held_c.is_some() || !ratio.is_finite() || ratio <= 1.0 {
            return None;
        }
        let after = Duration::from_secs_f64(TIME_CONSTANT_S * ratio.ln());
        // Slightly later, so that the crossing exceeds the rounding error.
        let at = self.since + after + Duration::from_millis(1);
        (at > now).then_some(at)
    }

    fn final_c(&self) -> f64 {
        self.ambient_c + RISE_AT_NOMINAL_K * self.load * self.load
    }

    fn own_c(&self, now: Instant) -> f64 {
        let elapsed_s = now.saturating_duration_since(self.since).as_secs_f64();
        self.final_c() + (self.initial_c - self.final_c()) * (-elapsed_s / TIME_CONSTANT_S).exp()
    }
}
