//! Estimates when bytes have left a line, for transports that cannot report it.

use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::time::{Instant, Sleep};

/// Estimates how long a line is busy, and waits until it is free.
#[derive(Debug)]
pub struct Pacer {
    bytes_per_second: u32,
    busy_until: Option<Instant>,
    sleep: Option<Pin<Box<Sleep>>>,
}

impl Pacer {
    #[must_use]
    pub fn new(bytes_per_second: u32) -> Self {
        Self { bytes_per_second: bytes_per_second.max(1), busy_until: None, sleep: None }
    }

    /// Adds the line time of `bytes` bytes.
    pub fn wrote(&mut self, bytes: usize) {
        let now = Instant::now();
        let from = self.busy_until.map_or(now, |until| until.max(now));
        self.busy_until = Some(from + self.line_time(bytes));
        self.sleep = None;
    }

    /// Line time of `bytes` bytes.
    #[must_use]
    pub fn line_time(&self, bytes: usize) -> Duration {
        Duration::from_secs_f64(bytes as f64 / f64::from(self.bytes_per_second))
    }

    /// Keeps the line busy until `time` from now.
    pub fn hold(&mut self, time: Duration) {
        self.busy_until = Some(Instant::now() + time);
        self.sleep = None;
    }

    /// Is ready once the line is free.
    pub fn poll_free(&mut self, cx: &mut Context<'_>) -> Poll<()> {
        let Some(until) = self.busy_until.filter(|until| *until > Instant::now()) else {
            self.busy_until = None;
            self.sleep = None;
            return Poll::Ready(());
        };
        let sleep = self.sleep.get_or_insert_with(|| Box::pin(tokio::time::sleep_until(until)));
        let slept = sleep.as_mut().poll(cx);
        if slept.is_ready() {
            self.busy_until = None;
            self.sleep = None;
        }
        slept
    }
}
