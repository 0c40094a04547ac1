//! Bounded queue of frames to send. When it is full, it drops the oldest automatic update rather than a reply.

use std::collections::VecDeque;
use std::time::Instant;

/// Limit of queued frames: half a second of the five updates at 10 ms each.
pub const MAX_QUEUED_FRAMES: usize = 256;

/// Limit of queued replies above which requests are rejected. The remaining room is for results of running commands.
pub const MAX_QUEUED_REPLIES: usize = MAX_QUEUED_FRAMES - 16;

/// A queued frame.
#[derive(Debug, Clone)]
pub(crate) struct Outgoing {
    pub id: u8,
    pub is_update: bool,
    pub at: Instant,
    pub bytes: Vec<u8>,
}

#[derive(Debug, Default)]
pub(crate) struct ReplyQueue {
    frames: VecDeque<Outgoing>,
    replies: usize,
    pub dropped_updates: u64,
    pub dropped_replies: u64,
}

impl ReplyQueue {
    pub fn push(&mut self, frame: Outgoing) {
        if self.frames.len() >= MAX_QUEUED_FRAMES && !self.drop_oldest_update() {
            // Only replies are left. Rejecting requests in time prevents this, but the bound holds anyway.
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

    /// Whether the replies to another request would exceed the limit.
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
    fn full_queue_drops_oldest_update_but_no_reply() {
        let mut outbox = ReplyQueue::default();
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
    fn full_queue_has_room_for_results() {
        let mut outbox = ReplyQueue::default();
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
