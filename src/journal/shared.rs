//! What the journal's handles and its writing thread share.

use std::sync::atomic::{AtomicI64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, watch};

use super::rates::Rates;
use super::row::Stored;
use super::source::Place;
use super::store::Memories;
use crate::gripper::model::PersistedState;
use crate::gripper::recorder::Health;

/// How many events a slow follower may be behind before it reads them from the file.
const BROADCAST: usize = 1024;

/// How long a write may take until it is told that the journal takes no records: as long as a motion waits for its own.
const WRITTEN_WITHIN: Duration = Duration::from_millis(500);

/// What the thread that writes is doing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Work {
    Idle,
    /// It waits for the disk since then.
    Writing(Instant),
    /// It has gone.
    Over,
}

/// The newest of what is known.
#[derive(Debug)]
pub(super) struct Shared {
    pub(super) health: watch::Sender<Health>,
    pub(super) rates: Rates,
    /// Of the thread that writes: its end ends what listens.
    events: broadcast::WeakSender<Arc<Stored>>,
    committed: AtomicI64,
    /// How many records wait for the thread that writes.
    waiting: AtomicUsize,
    /// What is to be remembered, the newest of each: as many as grippers have.
    memories: Mutex<Memories>,
    work: Mutex<Work>,
    /// Told of each change of the work.
    work_changed: Condvar,
}

impl Shared {
    /// And what the thread tells of events by.
    pub(super) fn new(committed: i64) -> (Self, broadcast::Sender<Arc<Stored>>) {
        let events = broadcast::Sender::new(BROADCAST);
        let (health, committed) = (watch::Sender::default(), AtomicI64::new(committed));
        let (work, work_changed) = (Mutex::new(Work::Idle), Condvar::new());
        let (waiting, memories) = (AtomicUsize::new(0), Mutex::default());
        let rates = Rates::default();
        (Self { health, rates, events: events.downgrade(), committed, waiting, memories, work, work_changed }, events)
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

    /// Says that records of earlier are damaged, which does not keep new ones from being written.
    pub(super) fn set_damage(&self, damage: String) {
        self.health.send_modify(|health| health.damage = Some(damage));
    }

    /// One more record waits, where fewer than so many do.
    pub(super) fn waits(&self, places: usize) -> bool {
        let one_more = |waiting| (waiting < places).then_some(waiting + 1);
        self.waiting.fetch_update(Ordering::AcqRel, Ordering::Acquire, one_more).is_ok()
    }

    pub(super) fn waits_no_more(&self) {
        self.waiting.fetch_sub(1, Ordering::AcqRel);
    }

    pub(super) fn remember(&self, memory: PersistedState) {
        self.memories().insert((memory.gripper, memory.key), memory.value);
    }

    /// What is to be remembered since this was asked last.
    pub(super) fn take_memories(&self) -> Memories {
        std::mem::take(&mut *self.memories())
    }

    fn memories(&self) -> MutexGuard<'_, Memories> {
        self.memories.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Writes, and is told of if that takes long.
    pub(super) fn while_watched<T>(&self, write: impl FnOnce() -> T) -> T {
        self.work_is(Work::Writing(Instant::now()));
        let written = write();
        self.work_is(Work::Idle);
        written
    }

    /// Nothing is written from now on.
    pub(super) fn over(&self) {
        self.work_is(Work::Over);
        self.set_failure(Some("the journal is closed: nothing is written any more".to_owned()));
    }

    fn work_is(&self, work: Work) {
        *self.work() = work;
        self.work_changed.notify_all();
    }

    fn work(&self) -> MutexGuard<'_, Work> {
        self.work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells of each write that takes too long, while it does: the thread that writes can't, as it waits for the disk.
    pub(super) fn watch(&self, place: &Place) {
        let mut work = self.work();
        let mut told = None;
        while *work != Work::Over {
            let left = match *work {
                Work::Writing(since) if told != Some(since) => WRITTEN_WITHIN.checked_sub(since.elapsed()),
                _ => Some(Duration::MAX),
            };
            work = match left {
                Some(Duration::MAX) => self.work_changed.wait(work).unwrap_or_else(PoisonError::into_inner),
                Some(left) => self.work_changed.wait_timeout(work, left).unwrap_or_else(PoisonError::into_inner).0,
                None => {
                    if let Work::Writing(since) = *work {
                        told = Some(since);
                    }
                    let limit_ms = WRITTEN_WITHIN.as_millis();
                    let failure = format!(
                        "the journal {place}: its disk has not taken a record within {limit_ms} ms: look at its disk, \
                         and at the system's log"
                    );
                    tracing::error!(failure, "the journal is not written");
                    // With the work's lock: who has written meanwhile says so behind it.
                    self.set_failure(Some(failure));
                    work
                }
            };
        }
    }
}
