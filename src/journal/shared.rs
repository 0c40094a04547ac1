//! What the journal's handles and its writing thread share.

use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use tokio::sync::{broadcast, watch};

use super::row::Stored;
use crate::gripper::recorder::Health;

/// How many events a slow follower may be behind before it reads them from the file.
const BROADCAST: usize = 1024;

/// The newest of what is known.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) health: watch::Sender<Health>,
    /// Of the thread that writes: its end ends what listens.
    events: broadcast::WeakSender<Arc<Stored>>,
    committed: AtomicI64,
}

impl Shared {
    /// And what the thread tells of events by.
    pub(super) fn new(committed: i64) -> (Self, broadcast::Sender<Arc<Stored>>) {
        let events = broadcast::Sender::new(BROADCAST);
        let (health, committed) = (watch::Sender::default(), AtomicI64::new(committed));
        (Self { health, events: events.downgrade(), committed }, events)
    }

    pub(super) fn subscribe(&self) -> broadcast::Receiver<Arc<Stored>> {
        self.events.upgrade().map_or_else(|| broadcast::channel(1).1, |events| events.subscribe())
    }

    /// The newest durable event.
    pub(super) fn committed(&self) -> i64 {
        self.committed.load(Ordering::Acquire)
    }

    pub(super) fn set_committed(&self, seq: i64) {
        self.committed.store(seq, Ordering::Release);
    }

    pub(super) fn failing(&self) -> bool {
        self.health.borrow().failure.is_some()
    }

    pub(super) fn lose(&self) {
        self.health.send_modify(|health| health.lost += 1);
    }

    pub(super) fn set_failure(&self, failure: Option<String>) {
        self.health.send_if_modified(|health| {
            let changed = health.failure != failure;
            health.failure = failure;
            changed
        });
    }
}
