//! Queue of frames for one client, bounded in bytes.

use std::collections::VecDeque;
use std::sync::{Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use tokio::sync::Notify;

use super::bodies::Following;
use crate::connections::admission::HeldBytes;

/// Maximum number of unread bytes of a client. A client that exceeds it is disconnected.
pub const MAX_WAITING_BYTES: usize = 256 * 1024;

/// Unread responses, and their bytes, from which requests are refused as `overloaded`, except FAST STOPs.
const MAX_UNREAD: usize = 64;
const MAX_UNREAD_BYTES: usize = MAX_WAITING_BYTES / 2;

/// Overhead of an entry in the queue.
const ENTRY_BYTES: usize = 64;

/// The queue of one client, filled by its reader and emptied by its writer.
#[derive(Debug)]
pub struct Outbox {
    queue: Mutex<Queue>,
    news: Notify,
}

#[derive(Debug)]
struct Queue {
    items: VecDeque<Item>,
    /// Bytes of the queued frames and of those being written.
    bytes: usize,
    held: Option<HeldBytes>,
    is_closed: bool,
}

pub enum Item {
    /// Complete WebSocket frames.
    Frames(Bytes),
    /// A new subscription, which replaces the previous one.
    Follow(Following),
}

impl std::fmt::Debug for Item {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Frames(bytes) => f.debug_tuple("Frames").field(&bytes.len()).finish(),
            Self::Follow(_) => f.write_str("Follow"),
        }
    }
}

impl Outbox {
    pub fn new(held: Option<HeldBytes>) -> Self {
        let queue = Queue { items: VecDeque::new(), bytes: 0, held, is_closed: false };
        Self { queue: Mutex::new(queue), news: Notify::new() }
    }

    pub fn push(&self, frames: Bytes) {
        self.queue().push(frames);
        self.news.notify_one();
    }

    /// Queues a new subscription, and its answer: after the rest of the replaced subscription, and before the first update
    /// of the new one.
    pub fn follow(&self, following: Following, answer: Option<Bytes>) {
        let mut queue = self.queue();
        queue.items.push_back(Item::Follow(following));
        if let Some(answer) = answer {
            queue.push(answer);
        }
        drop(queue);
        self.news.notify_one();
    }

    /// Ends the writer once everything is written.
    pub fn close(&self) {
        self.queue().is_closed = true;
        self.news.notify_one();
    }

    /// Whether so much is unread that further requests are refused.
    pub fn is_backlogged(&self) -> bool {
        let queue = self.queue();
        queue.items.len() >= MAX_UNREAD || queue.bytes >= MAX_UNREAD_BYTES
    }

    /// Whether the queue exceeds [`MAX_WAITING_BYTES`].
    pub fn has_overflown(&self) -> bool {
        self.queue().bytes > MAX_WAITING_BYTES
    }

    /// Returns the next item, or `None` once the outbox is closed and empty.
    pub async fn next(&self) -> Option<Item> {
        loop {
            let news = self.news.notified();
            {
                let mut queue = self.queue();
                match queue.items.pop_front() {
                    None if queue.is_closed => return None,
                    None => {}
                    item => return item,
                }
            }
            news.await;
        }
    }

    /// Returns the next frames, if the next item is already queued and has frames.
    pub fn next_frames(&self) -> Option<Bytes> {
        match self.queue().items.pop_front_if(|item| matches!(item, Item::Frames(_))) {
            Some(Item::Frames(frames)) => Some(frames),
            _ => None,
        }
    }

    pub fn written(&self, frames: &Bytes) {
        self.queue().count(0, frames.len() + ENTRY_BYTES);
    }

    fn queue(&self) -> MutexGuard<'_, Queue> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Queue {
    fn push(&mut self, frames: Bytes) {
        self.count(frames.len() + ENTRY_BYTES, 0);
        self.items.push_back(Item::Frames(frames));
    }

    fn count(&mut self, more: usize, less: usize) {
        self.bytes = self.bytes + more - less;
        if let Some(held) = &mut self.held {
            held.set(self.bytes);
        }
    }
}
