//! Clocks. Only code that does I/O reads them; the state machines take the time as an argument.

use std::time::Instant;

use jiff::Timestamp;

/// Time of the monotonic clock and of the wall clock.
#[derive(Debug, Clone, Copy)]
pub struct Now {
    /// Monotonic time, for deadlines.
    pub instant: Instant,
    /// Wall clock time, for records, in whole milliseconds.
    pub wall: Timestamp,
    /// The same time, not rounded.
    pub exact: Timestamp,
}

impl Now {
    #[must_use]
    pub fn read() -> Self {
        let now = Timestamp::now();
        let milliseconds = Timestamp::from_millisecond(now.as_millisecond());
        Self { instant: instant(), wall: milliseconds.unwrap_or(now), exact: now }
    }
}

/// Monotonic time, which tests can pause.
#[must_use]
pub fn instant() -> Instant {
    tokio::time::Instant::now().into_std()
}

/// Waits until the deadline, or forever without one.
pub async fn sleep_until(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => tokio::time::sleep_until(deadline.into()).await,
        None => std::future::pending().await,
    }
}
