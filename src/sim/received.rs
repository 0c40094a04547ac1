//! A log of the frames that the device received: what invariants are checked on.

use std::time::Instant;

/// So many of the newest frames are kept.
pub const MAX_RECEIVED_FRAMES: usize = 4096;

/// A request as it came over the wire.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReceivedFrame {
    /// When it was complete.
    pub at: Instant,
    /// Its id.
    pub id: u8,
    /// Its parameters.
    pub payload: Vec<u8>,
}

#[derive(Debug, Default)]
pub(super) struct ReceivedLog {
    frames: Vec<ReceivedFrame>,
    pub total: u64,
}

impl ReceivedLog {
    pub fn push(&mut self, frame: ReceivedFrame) {
        if self.frames.len() == MAX_RECEIVED_FRAMES {
            // A quarter at once, so that the move costs little per frame.
            self.frames.drain(..MAX_RECEIVED_FRAMES / 4);
        }
        self.frames.push(frame);
        self.total += 1;
    }

    pub fn frames(&self) -> &[ReceivedFrame] {
        &self.frames
    }
}
