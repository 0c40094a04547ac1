//! How often a client is told of states.

use std::time::Duration;

use tokio::time::{Interval, MissedTickBehavior, interval};

/// So often a second. A client that was slow gets the newest, and not all that it missed.
#[derive(Debug)]
pub struct Pace(Interval);

impl Pace {
    /// At least once.
    #[must_use]
    pub fn new(hz: u32) -> Self {
        let mut ticks = interval(Duration::from_secs(1) / hz.max(1));
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        Self(ticks)
    }

    /// Waits for the next time, and says how many went by before it. Cancelled without loss.
    pub async fn next(&mut self) -> u64 {
        let due = self.0.tick().await;
        u64::try_from(due.elapsed().as_nanos() / self.0.period().as_nanos()).unwrap_or(u64::MAX)
    }
}
