//! What the time is. Only those who do I/O read it; the machines are told.

use std::time::Instant;

use jiff::Timestamp;

/// The clock that never jumps, and the one that people read.
#[derive(Debug, Clone, Copy)]
pub struct Now {
    /// For deadlines.
    pub instant: Instant,
    /// For records, in whole milliseconds.
    pub wall: Timestamp,
}

impl Now {
    /// What the clocks say.
    #[must_use]
    pub fn read() -> Self {
        let now = Timestamp::now();
        let milliseconds = Timestamp::from_millisecond(now.as_millisecond());
        Self { instant: instant(), wall: milliseconds.unwrap_or(now) }
    }
}

/// What the clock that never jumps says, which tests can pause.
#[must_use]
pub fn instant() -> Instant {
    tokio::time::Instant::now().into_std()
}

/// Comes at the deadline, or never where there is none.
pub async fn sleep_until(deadline: Option<Instant>) {
    match deadline {
        Some(deadline) => tokio::time::sleep_until(deadline.into()).await,
        None => std::future::pending().await,
    }
}
