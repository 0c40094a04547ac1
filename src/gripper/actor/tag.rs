//! The device tag: each write of it wears the device's flash.

use std::time::{Duration, Instant};

use super::super::error::Failure;
use crate::wsg::{Command, DeviceTag};

/// Time between two writes, whoever asks: a write each second is already far more than a tag changes.
const WRITE_EVERY: Duration = Duration::from_secs(1);

/// Time for which a tag that was read back counts as the device's. Another program on the device may change it meanwhile.
const KNOWN_FOR: Duration = Duration::from_mins(1);

/// Writes of the device tag.
#[derive(Debug, Default)]
pub(super) struct TagWrites {
    written_at: Option<Instant>,
    /// Time at which the tag was read back on this link.
    known_at: Option<Instant>,
}

impl TagWrites {
    /// The tag was read back.
    pub(super) fn read_back(&mut self, now: Instant) {
        self.known_at = Some(now);
    }

    /// The tag may be another: the link is lost.
    pub(super) fn forget(&mut self) {
        self.known_at = None;
    }

    /// Begins a write, unless the device has this tag already. Returns whether to write.
    ///
    /// # Errors
    /// [`Failure::FlashWear`] where the last write was just now.
    pub(super) fn begin(&mut self, now: Instant, tag: &DeviceTag, is_known: bool) -> Result<bool, Failure> {
        if is_known && self.known_at.is_some_and(|at| now < at + KNOWN_FOR) {
            return Ok(false);
        }
        if self.written_at.is_some_and(|at| now < at + WRITE_EVERY) {
            let command = super::name_of(&Command::SetDeviceTag(tag.clone()));
            return Err(Failure::FlashWear { command, every_ms: WRITE_EVERY.as_millis() as u64 });
        }
        *self = Self { written_at: Some(now), known_at: None };
        Ok(true)
    }
}
