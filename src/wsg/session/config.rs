//! Parameters of a link, and the time that requests take on its line.

use std::time::Duration;

use crate::{Command, frame};

/// Longest line time of a request while the fingers may move, because a FAST STOP has to wait for that request.
/// Requests no longer than a motion are exempt.
pub const MAX_LINE_TIME_WHILE_MOVING: Duration = Duration::from_millis(100);

/// Size in bytes of the longest motion frame: flags and two floats. At 1200 baud, even this frame takes more than
/// [`MAX_LINE_TIME_WHILE_MOVING`].
const SHORT_FRAME_BYTES: usize = frame::OVERHEAD_BYTES + 9;

/// Link parameters of a session.
#[derive(Debug, Clone)]
pub struct SessionConfig {
    /// Line rate in bytes per second, or `None` if it does not matter, as for TCP.
    pub bytes_per_second: Option<u32>,
    /// Time limit from the first to the last byte of a frame, beyond its line time.
    pub frame_gap: Duration,
    /// Whether the link can duplicate frames. If so, an answered id stays closed while a duplicate is
    /// awaited.
    pub may_duplicate: bool,
    /// Seed that makes this session's nonces differ from those of earlier sessions.
    pub nonce_seed: u64,
}

impl SessionConfig {
    pub(super) fn line_time(&self, bytes: usize) -> Duration {
        self.bytes_per_second.map_or(Duration::ZERO, |bytes_per_second| {
            Duration::from_secs_f64(bytes as f64 / f64::from(bytes_per_second.max(1)))
        })
    }

    pub(super) fn line_time_of(&self, command: &Command) -> Duration {
        if self.bytes_per_second.is_none() {
            return Duration::ZERO;
        }
        let mut frame = Vec::new();
        command.encode(&mut frame);
        self.line_time(frame.len())
    }

    /// Whether a FAST STOP would wait too long for this request. Short frames are never too long: without them, the gateway
    /// could not read that the fingers have stopped.
    pub(super) fn is_too_long(&self, command: &Command) -> bool {
        let line_time = self.line_time_of(command);
        line_time > MAX_LINE_TIME_WHILE_MOVING && line_time > self.line_time(SHORT_FRAME_BYTES)
    }
}
