//! The device tag. Each write wears the device's flash memory.

use std::time::{Duration, Instant};

use model::error::Failure;
use wsg::{Command, DeviceTag};

/// Shortest time between two writes by all clients together. A tag changes far less often.
const WRITE_EVERY: Duration = Duration::from_secs(1);

/// Time for which a tag that was read back counts as current. Another program can change it meanwhile.
const KNOWN_FOR: Duration = Duration::from_mins(1);

#[derive(Debug, Default)]
pub(in crate::actor) struct TagWrites {
    written_at: Option<Instant>,
    /// Time at which the tag was read back on this link.
    known_at: Option<Instant>,
}

impl TagWrites {
    /// Notes that the tag was read back.
    pub(in crate::actor) fn read_back(&mut self, now: Instant) {
        self.known_at = Some(now);
    }

    /// Forgets that the tag is known, because the link was lost.
    pub(in crate::actor) fn forget(&mut self) {
        self.known_at = None;
    }

    /// Begins a write, unless the device has this tag already. Returns whether to write.
    ///
    /// # Errors
    /// [`Failure::FlashWear`] if the last write was less than [`WRITE_EVERY`] ago.
    pub(in crate::actor) fn begin(&mut self, now: Instant, tag: &DeviceTag, is_known: bool) -> Result<bool, Failure> {
        if is_known && self.known_at.is_some_and(|at| now < at + KNOWN_FOR) {
            return Ok(false);
        }
        if self.written_at.is_some_and(|at| now < at + WRITE_EVERY) {
            let command = crate::actor::name_of(&Command::SetDeviceTag(tag.clone()));
            return Err(Failure::FlashWear { command, every_ms: WRITE_EVERY.as_millis() as u64 });
        }
        *self = Self { written_at: Some(now), known_at: None };
        Ok(true)
    }
}
