//! Log of received frames, on which tests check invariants.

use std::time::Instant;

/// Limit of logged frames; the newest are kept.
pub const MAX_RECEIVED_FRAMES: usize = 4096;

/// A request as received.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReceivedFrame {
    /// Time at which the frame was complete.
    pub at: Instant,
    pub id: u8,
    /// Empty if the payload was too long to be kept.
    pub payload: Vec<u8>,
}

#[derive(Debug, Default)]
pub(crate) struct ReceivedLog {
    frames: Vec<ReceivedFrame>,
    pub total: u64,
}

impl ReceivedLog {
    pub fn push(&mut self, frame: ReceivedFrame) {
        if self.frames.len() == MAX_RECEIVED_FRAMES {
            // Removes a quarter at once, so that moving the rest costs little per frame.
            self.frames.drain(..MAX_RECEIVED_FRAMES / 4);
        }
        self.frames.push(frame);
        self.total += 1;
    }

    pub fn frames(&self) -> &[ReceivedFrame] {
        &self.frames
    }
}
