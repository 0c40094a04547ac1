//! The temperature: it follows the load slowly, unless the world holds it at a value.

use std::time::Instant;

/// How long the device takes to come close to the temperature of its load, in s.
const TIME_CONSTANT_S: f64 = 600.0;

/// How much warmer than its surroundings it becomes with the nominal force, in K. It grows with the force's square, so
/// that Overdrive Mode can overheat it (`fw4-en 3.3.8`).
const RISE_AT_NOMINAL_K: f64 = 25.0;

#[derive(Debug)]
pub(super) struct Thermal {
    temperature_c: f64,
    ambient_c: f64,
    at: Instant,
    held_c: Option<f64>,
}

impl Thermal {
    pub fn new(ambient_c: f64, now: Instant) -> Self {
        Self { temperature_c: ambient_c, ambient_c, at: now, held_c: None }
    }

    pub fn temperature_c(&self) -> f64 {
        self.held_c.unwrap_or(self.temperature_c)
    }

    /// It is this warm, until [`Thermal::let_go`].
    pub fn hold(&mut self, temperature_c: f64) {
        self.held_c = Some(temperature_c);
    }

    pub fn let_go(&mut self) {
        self.held_c = None;
    }

    /// Up to `now`, the load was `load`: the share of the nominal force.
    pub fn advance(&mut self, now: Instant, load: f64) {
        let elapsed_s = now.saturating_duration_since(self.at).as_secs_f64();
        self.at = self.at.max(now);
        let final_c = self.ambient_c + RISE_AT_NOMINAL_K * load * load;
        self.temperature_c = final_c + (self.temperature_c - final_c) * (-elapsed_s / TIME_CONSTANT_S).exp();
    }
}
