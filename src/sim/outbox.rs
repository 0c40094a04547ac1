//! What waits to be sent, bounded: when it is full, the oldest automatic update goes, and never a reply.

use std::collections::VecDeque;
use std::time::Instant;

/// So many frames wait at most. At 10 ms for each of the five updates that is half a second of a pump that stands.
pub const MAX_QUEUED_FRAMES: usize = 256;

/// With so many replies waiting, further requests are not taken up. The rest is for results of what runs.
pub const MAX_QUEUED_REPLIES: usize = MAX_QUEUED_FRAMES - 16;

/// A frame on its way out.
#[derive(Debug, Clone)]
pub(super) struct Outgoing {
    pub id: u8,
    pub is_update: bool,
    pub at: Instant,
    pub bytes: Vec<u8>,
}

#[derive(Debug, Default)]
pub(super) struct Outbox {
    frames: VecDeque<Outgoing>,
    replies: usize,
    pub dropped_updates: u64,
    pub dropped_replies: u64,
}

impl Outbox {
    pub fn push(&mut self, frame: Outgoing) {
        if self.frames.len() >= MAX_QUEUED_FRAMES && !self.drop_oldest_update() {
            // Replies alone fill it: can't be while requests are refused in time, but a bound is a bound.
            let dropped = if frame.is_update { &mut self.dropped_updates } else { &mut self.dropped_replies };
            *dropped += 1;
            return;
        }
        self.replies += usize::from(!frame.is_update);
        self.frames.push_back(frame);
    }

    pub fn pop(&mut self) -> Option<Outgoing> {
        let frame = self.frames.pop_front()?;
        self.replies -= usize::from(!frame.is_update);
        Some(frame)
    }

    pub fn front(&self) -> Option<&Outgoing> {
        self.frames.front()
    }

    pub fn len(&self) -> usize {
        self.frames.len()
    }

    pub fn clear(&mut self) {
        self.frames.clear();
        self.replies = 0;
    }

    /// Whether a further request would find no room for its replies.
    pub fn is_full(&self) -> bool {
        self.replies >= MAX_QUEUED_REPLIES
    }

    fn drop_oldest_update(&mut self) -> bool {
        let Some(oldest) = self.frames.iter().position(|frame| frame.is_update) else { return false };
        self.frames.remove(oldest);
        self.dropped_updates += 1;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(id: u8, is_update: bool) -> Outgoing {
        Outgoing { id, is_update, at: Instant::now(), bytes: vec![id] }
    }

    #[test]
    fn a_full_queue_drops_the_oldest_update_and_no_reply() {
        let mut outbox = Outbox::default();
        outbox.push(frame(1, false));
        outbox.push(frame(2, true));
        for _ in 2..MAX_QUEUED_FRAMES {
            outbox.push(frame(3, true));
        }
        outbox.push(frame(4, false));
        assert_eq!((outbox.len(), outbox.dropped_updates, outbox.dropped_replies), (MAX_QUEUED_FRAMES, 1, 0));
        assert_eq!(outbox.pop().unwrap().id, 1);
        assert_eq!(outbox.pop().unwrap().id, 3);
    }

    #[test]
    fn it_is_full_while_there_is_still_room_for_results() {
        let mut outbox = Outbox::default();
        for _ in 0..MAX_QUEUED_REPLIES {
            assert!(!outbox.is_full());
            outbox.push(frame(6, false));
        }
        assert!(outbox.is_full());
        assert!(outbox.len() < MAX_QUEUED_FRAMES);
        outbox.pop();
        assert!(!outbox.is_full());
    }
}
