//! Slots for connections that have found no room, and may still bring a FAST STOP. The newest wins: a flood leaves each
//! of them the time in which it fills all slots, a few milliseconds, in place of none.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::task::yield_now;
use tokio_util::sync::CancellationToken;

/// The slots of one listener.
#[derive(Debug)]
pub(super) struct Undecided {
    slots: Arc<Semaphore>,
    /// Maximum number of connections that have given way and have not ended yet. Each still has a descriptor.
    max_giving_way: usize,
    taken: Mutex<Taken>,
}

#[derive(Debug, Default)]
struct Taken {
    next: u64,
    /// Slots of the connections that can give way, the oldest first.
    slots: BTreeMap<u64, (CancellationToken, OwnedSemaphorePermit)>,
    giving_way: usize,
}

impl Undecided {
    /// Shares descriptors between the slots and the connections that have given way.
    pub(super) fn new(descriptors: usize) -> Arc<Self> {
        let max_giving_way = descriptors / 3;
        let slots = Arc::new(Semaphore::new(descriptors - max_giving_way));
        Arc::new(Self { slots, max_giving_way, taken: Mutex::default() })
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
        let permit = self.lasting()?;
        Some(self.take(&mut self.taken(), permit))
    }

    /// Returns a slot; if all are taken, that of the oldest connection. `None` if no connection gives way. Waits for nothing
    /// but the tasks that are ready to run.
    pub(super) async fn newest(self: &Arc<Self>) -> Option<UndecidedSlot> {
        if let Some(slot) = self.free() {
            return Some(slot);
        }
        if self.taken().giving_way >= self.max_giving_way {
            yield_now().await;
        }
        let mut taken = self.taken();
        if taken.giving_way >= self.max_giving_way {
            return None;
        }
        let (_, (oldest, permit)) = taken.slots.pop_first()?;
        taken.giving_way += 1;
        let slot = self.take(&mut taken, permit);
        drop(taken);
        oldest.cancel();
        Some(slot)
    }

    fn take(self: &Arc<Self>, taken: &mut Taken, permit: OwnedSemaphorePermit) -> UndecidedSlot {
        let gives_way = CancellationToken::new();
        let number = taken.next;
        taken.next += 1;
        taken.slots.insert(number, (gives_way.clone(), permit));
        UndecidedSlot { number, gives_way, undecided: self.clone(), is_kept: false }
    }

    /// Locks the table. A poisoned lock is safe to use: a panic leaves no operation half done.
    fn taken(&self) -> MutexGuard<'_, Taken> {
        self.taken.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A slot, held until it is dropped or given way.
#[derive(Debug)]
pub struct UndecidedSlot {
    number: u64,
    gives_way: CancellationToken,
    undecided: Arc<Undecided>,
    is_kept: bool,
}

impl UndecidedSlot {
    /// Completes when a newer connection has got the slot.
    pub async fn gives_way(&self) {
        self.gives_way.cancelled().await;
    }

    /// Keeps the slot from newer connections; `None` if one has got it already.
    pub fn keep(mut self) -> Option<OwnedSemaphorePermit> {
        let kept = self.undecided.taken().slots.remove(&self.number);
        self.is_kept = kept.is_some();
        kept.map(|(_, permit)| permit)
    }
}

impl Drop for UndecidedSlot {
    fn drop(&mut self) {
        let mut taken = self.undecided.taken();
        if !self.is_kept && taken.slots.remove(&self.number).is_none() {
            taken.giving_way -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt as _;

    use super::*;

    #[tokio::test]
    async fn oldest_gives_way_to_the_newest() {
        let undecided = Undecided::new(3);
        let oldest = undecided.newest().await.unwrap();
        let other = undecided.newest().await.unwrap();
        assert!(undecided.free().is_none());
        let newest = undecided.newest().await.unwrap();
        oldest.gives_way().await;
        assert!(oldest.keep().is_none(), "its slot is that of the newest");
        assert!(other.gives_way().now_or_never().is_none());
        drop((other, newest));
        assert_eq!(undecided.available(), 2);
        assert_eq!(undecided.taken().giving_way, 0);
    }

    #[tokio::test]
    async fn kept_slot_does_not_give_way() {
        let undecided = Undecided::new(3);
        let lasting = undecided.lasting().unwrap();
        let kept = undecided.newest().await.unwrap().keep().unwrap();
        assert!(undecided.newest().await.is_none());
        drop(kept);
        assert!(undecided.newest().await.is_some());
        drop(lasting);
        assert_eq!(undecided.available(), 2);
    }

    #[tokio::test]
    async fn connections_that_give_way_are_bounded() {
        let undecided = Undecided::new(9);
        let mut all = Vec::new();
        for _ in 0..9 {
            all.push(undecided.newest().await.unwrap());
        }
        assert!(undecided.newest().await.is_none(), "three have given way and have not ended");
        all.remove(0);
        assert!(undecided.newest().await.is_some());
    }
}
