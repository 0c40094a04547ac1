//! Search for a FAST STOP in dropped bytes.

use super::frame::ChecksumEvaluation;

/// A FAST STOP without parameters (`fw4-en 3.2.4`).
const FAST_STOP: u64 = u64::from_be_bytes([0xAA, 0xAA, 0xAA, super::id::FAST_STOP, 0, 0, 0xAC, 0x1C]);

/// Mask of all bytes but the checksum.
const WITHOUT_CHECKSUM: u64 = !0xFFFF;

/// Looks for a whole FAST STOP in consecutive bytes, without keeping them.
#[derive(Debug)]
pub(super) struct MissedFastStop {
    /// The newest eight bytes.
    newest: u64,
    mask: u64,
    is_found: bool,
}

impl MissedFastStop {
    pub(super) fn new(evaluation: ChecksumEvaluation) -> Self {
        let mask = match evaluation {
            ChecksumEvaluation::On => u64::MAX,
            ChecksumEvaluation::Off => WITHOUT_CHECKSUM,
        };
        Self { newest: 0, mask, is_found: false }
    }

    pub(super) fn look_at(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.newest = self.newest << 8 | u64::from(byte);
            self.is_found |= (self.newest ^ FAST_STOP) & self.mask == 0;
        }
    }

    /// Whether a FAST STOP was found since the last call.
    pub(super) fn take(&mut self) -> bool {
        std::mem::take(&mut self.is_found)
    }

    /// Forgets all bytes, because they belong to a valid frame or lie before one.
    pub(super) fn clear(&mut self) {
        (self.newest, self.is_found) = (0, false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Command;

    #[test]
    fn searched_bytes_are_a_fast_stop() {
        let mut frame = Vec::new();
        Command::FastStop.encode(&mut frame);
        assert_eq!(frame, FAST_STOP.to_be_bytes());
    }

    #[test]
    fn checksum_counts_unless_its_evaluation_is_off() {
        let mut bytes = [&[0xAA][..], &FAST_STOP.to_be_bytes()].concat();
        *bytes.last_mut().unwrap() = 0;
        for (evaluation, is_found) in [(ChecksumEvaluation::On, false), (ChecksumEvaluation::Off, true)] {
            let mut missed = MissedFastStop::new(evaluation);
            missed.look_at(&bytes[..5]);
            missed.look_at(&bytes[5..]);
            assert_eq!(missed.take(), is_found);
            assert!(!missed.take());
        }
    }
}
