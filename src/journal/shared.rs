//! State that the journal's handles and its writing thread share.

use std::sync::atomic::{AtomicI64, AtomicUsize, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, watch};

use super::rates::Rates;
use super::row::{GripUpdate, Stored};
use super::source::JournalLocation;
use super::store::PersistedValues;
use crate::gripper::recorder::JournalHealth;
use crate::model::PersistedState;

/// Events by which a follower can lag before it reads them from the file.
const BROADCAST: usize = 1024;

/// Grip records by which a subscriber can lag.
const GRIPS_BROADCAST: usize = 64;

/// Senders of the writing thread. The end of the thread ends all receivers.
#[derive(Debug)]
pub(super) struct Senders {
    pub(super) events: broadcast::Sender<Arc<Stored>>,
    pub(super) grips: broadcast::Sender<Arc<GripUpdate>>,
}

/// Duration of a write after which the journal counts as failed: as long as a motion waits for its own record.
const WRITTEN_WITHIN: Duration = Duration::from_millis(500);

/// Activity of the writing thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Work {
    Idle,
    /// A write to the disk began at this time.
    Writing(Instant),
    /// The thread has ended.
    Over,
}

#[derive(Debug)]
pub(super) struct Shared {
    pub(super) health: watch::Sender<JournalHealth>,
    pub(super) rates: Rates,
    /// Broadcasts of the writing thread.
    events: broadcast::WeakSender<Arc<Stored>>,
    grips: broadcast::WeakSender<Arc<GripUpdate>>,
    committed: AtomicI64,
    /// Number of records that wait for the writing thread.
    waiting: AtomicUsize,
    /// Newest persisted values that wait for the writing thread: at most as many as the grippers have.
    persisted: Mutex<PersistedValues>,
    work: Mutex<Work>,
    /// Notified of each change of `work`.
    work_changed: Condvar,
}

impl Shared {
    /// Returns the shared state, and the sender that the writing thread owns.
    pub(super) fn new(committed: i64) -> (Self, Senders) {
        let events = broadcast::Sender::new(BROADCAST);
        let grips = broadcast::Sender::new(GRIPS_BROADCAST);
        let health = watch::Sender::default();
        let committed = AtomicI64::new(committed);
        let work = Mutex::new(Work::Idle);
        let work_changed = Condvar::new();
        let waiting = AtomicUsize::new(0);
        let persisted = Mutex::default();
        let rates = Rates::default();
        let weak = (events.downgrade(), grips.downgrade());
        let shared =
            Self { health, rates, events: weak.0, grips: weak.1, committed, waiting, persisted, work, work_changed };
        (shared, Senders { events, grips })
    }

    pub(super) fn subscribe(&self) -> broadcast::Receiver<Arc<Stored>> {
        self.events.upgrade().map_or_else(|| broadcast::channel(1).1, |events| events.subscribe())
    }

    pub(super) fn subscribe_grips(&self) -> broadcast::Receiver<Arc<GripUpdate>> {
        self.grips.upgrade().map_or_else(|| broadcast::channel(1).1, |grips| grips.subscribe())
    }

    /// Returns the sequence number of the newest durable event.
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

    /// Reports damage of earlier records. New ones are still written.
    pub(super) fn set_damage(&self, damage: String) {
        self.health.send_modify(|health| health.damage = Some(damage));
    }

    pub(super) fn set_restored(&self, cause: Option<String>) {
        self.health.send_modify(|health| health.restored = cause);
    }

    pub(super) fn set_clock(&self, cause: Option<String>) {
        self.health.send_if_modified(|health| {
            let changed = health.clock != cause;
            health.clock = cause;
            changed
        });
    }

    /// Counts one more waiting record; returns false if `places` records wait already.
    pub(super) fn reserve_place(&self, places: usize) -> bool {
        let reserved = self
            .waiting
            .fetch_update(Ordering::AcqRel, Ordering::Acquire, |waiting| (waiting < places).then_some(waiting + 1));
        reserved.is_ok()
    }

    pub(super) fn release_place(&self) {
        self.waiting.fetch_sub(1, Ordering::AcqRel);
    }

    pub(super) fn persist(&self, value: PersistedState) {
        self.persisted().insert((value.gripper, value.key), value.value);
    }

    /// Takes the persisted values that wait for the writing thread.
    pub(super) fn take_persisted(&self) -> PersistedValues {
        std::mem::take(&mut *self.persisted())
    }

    fn persisted(&self) -> MutexGuard<'_, PersistedValues> {
        self.persisted.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs a write under the watch that reports slow ones.
    pub(super) fn while_watched<T>(&self, write: impl FnOnce() -> T) -> T {
        self.work_is(Work::Writing(Instant::now()));
        let written = write();
        self.work_is(Work::Idle);
        written
    }

    /// Reports that the writing thread has ended.
    pub(super) fn over(&self) {
        self.work_is(Work::Over);
        self.set_failure(Some("the journal is closed: no more records are written".to_owned()));
    }

    fn work_is(&self, work: Work) {
        *self.work() = work;
        self.work_changed.notify_all();
    }

    fn work(&self) -> MutexGuard<'_, Work> {
        self.work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Reports each slow write while it lasts. The writing thread cannot, because it waits for the disk.
    pub(super) fn watch(&self, place: &JournalLocation) {
        let mut work = self.work();
        let mut reported = None;
        while *work != Work::Over {
            let left = match *work {
                Work::Writing(since) if reported != Some(since) => WRITTEN_WITHIN.checked_sub(since.elapsed()),
                _ => Some(Duration::MAX),
            };
            work = match left {
                Some(Duration::MAX) => self.work_changed.wait(work).unwrap_or_else(PoisonError::into_inner),
                Some(left) => self.work_changed.wait_timeout(work, left).unwrap_or_else(PoisonError::into_inner).0,
                None => {
                    if let Work::Writing(since) = *work {
                        reported = Some(since);
                    }
                    let limit_ms = WRITTEN_WITHIN.as_millis();
                    let failure = format!(
                        "the journal {place}: the disk took no record within {limit_ms} ms: check the disk and the \
                         system log"
                    );
                    tracing::error!(failure, "journal write stalled");
                    // Under the lock, so that the report of a finished write comes after this one.
                    self.set_failure(Some(failure));
                    work
                }
            };
        }
    }
}
