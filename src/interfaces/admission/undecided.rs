//! Slots for connections that have found no room, and may still bring a FAST STOP. The newest wins: a flood leaves each
//! of them the time in which it fills all slots, a few milliseconds, in place of none.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

/// Time for a connection that gives way to free its slot. It does so at once, unless the runtime is busy.
const FREE_WITHIN: Duration = Duration::from_millis(5);

/// The slots of one listener.
#[derive(Debug)]
pub(super) struct Undecided {
    slots: Arc<Semaphore>,
    taken: Mutex<Taken>,
}

/// Connections in these slots that can give way, the oldest first.
#[derive(Debug, Default)]
struct Taken {
    next: u64,
    tokens: BTreeMap<u64, CancellationToken>,
}

impl Undecided {
    pub(super) fn new(slots: usize) -> Arc<Self> {
        Arc::new(Self { slots: Arc::new(Semaphore::new(slots)), taken: Mutex::default() })
    }

    pub(super) fn available(&self) -> usize {
        self.slots.available_permits()
    }

    /// Returns a free slot, whose connection does not give way.
    pub(super) fn lasting(&self) -> Option<OwnedSemaphorePermit> {
        self.slots.clone().try_acquire_owned().ok()
    }

    /// Returns a free slot.
    pub(super) fn free(self: &Arc<Self>) -> Option<UndecidedSlot> {
        self.lasting().map(|permit| UndecidedSlot::new(self, permit))
    }

    /// Returns a slot; if all are taken, that of the oldest connection. `None` if no connection gives way.
    pub(super) async fn newest(self: &Arc<Self>) -> Option<UndecidedSlot> {
        if let Some(slot) = self.free() {
            return Some(slot);
        }
        let oldest = self.taken().tokens.pop_first();
        oldest?.1.cancel();
        let permit = timeout(FREE_WITHIN, self.slots.clone().acquire_owned()).await.ok()?.ok()?;
        Some(UndecidedSlot::new(self, permit))
    }

    /// Locks the table. A poisoned lock is safe to use: a panic leaves no operation half done.
    fn taken(&self) -> MutexGuard<'_, Taken> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A slot, held until it is dropped.
#[derive(Debug)]
pub struct UndecidedSlot {
    number: u64,
    gives_way: CancellationToken,
    undecided: Arc<Undecided>,
    _permit: OwnedSemaphorePermit,
}

impl UndecidedSlot {
    fn new(undecided: &Arc<Undecided>, permit: OwnedSemaphorePermit) -> Self {
        let gives_way = CancellationToken::new();
        let mut taken = undecided.taken();
        let number = taken.next;
        taken.next += 1;
        taken.tokens.insert(number, gives_way.clone());
        drop(taken);
        Self { number, gives_way, undecided: undecided.clone(), _permit: permit }
    }

    /// Completes when a newer connection needs the slot.
    pub async fn gives_way(&self) {
        self.gives_way.cancelled().await;
    }
}

impl Drop for UndecidedSlot {
    fn drop(&mut self) {
        self.undecided.taken().tokens.remove(&self.number);
    }
}

#[cfg(test)]
mod tests {
    use std::pin::pin;

    use futures_util::FutureExt as _;

    use super::*;

    #[tokio::test]
    async fn oldest_gives_way_to_the_newest() {
        let undecided = Undecided::new(2);
        let oldest = undecided.newest().await.unwrap();
        let other = undecided.newest().await.unwrap();
        assert!(undecided.free().is_none());
        let mut newest = pin!(undecided.newest());
        assert!(newest.as_mut().now_or_never().is_none(), "the oldest still has its slot");
        oldest.gives_way().await;
        drop(oldest);
        assert!(newest.await.is_some());
        assert!(other.gives_way().now_or_never().is_none());
    }

    #[tokio::test(start_paused = true)]
    async fn lasting_slot_does_not_give_way() {
        let undecided = Undecided::new(1);
        let lasting = undecided.lasting().unwrap();
        assert!(undecided.newest().await.is_none());
        drop(lasting);
        assert!(undecided.newest().await.is_some());
    }
}
