//! The rate of a client's state updates.

use std::time::Duration;

use tokio::time::{Interval, MissedTickBehavior, interval};

/// A steady rate that skips missed ticks, so that a slow client gets only the newest state.
#[derive(Debug)]
pub struct Pace(Interval);

impl Pace {
    /// Ticks `hz` times a second, at least once.
    #[must_use]
    pub fn new(hz: u32) -> Self {
        let mut ticks = interval(Duration::from_secs(1) / hz.max(1));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        Self(ticks)
    }

    /// Waits for the next tick and returns the number of ticks missed before it. Cancel-safe.
    pub async fn next(&mut self) -> u64 {
        let due = self.0.tick().await;
        u64::try_from(due.elapsed().as_nanos() / self.0.period().as_nanos()).unwrap_or(u64::MAX)
    }
}
