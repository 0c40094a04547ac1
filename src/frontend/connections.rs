//! The open connections, and which of them has been idle the longest: it goes when a new one needs its place.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tokio_util::task::task_tracker::TaskTrackerToken;

/// All of them.
#[derive(Debug)]
pub struct Connections {
    limit: usize,
    reserved: usize,
    open: Mutex<Open>,
    /// Counts the guests, to wait for their end.
    guests: TaskTracker,
}

#[derive(Debug, Default)]
struct Open {
    next: u64,
    guests: BTreeMap<u64, Entry>,
}

#[derive(Debug)]
struct Entry {
    /// What keeps it busy: requests that are being answered.
    busy: usize,
    /// When it was busy last.
    idle_since: Instant,
    /// Whether it is a WebSocket, which is never idle.
    stays: bool,
    leave: CancellationToken,
}

impl Connections {
    /// At most `limit`, the last `reserved` of which are kept free as far as there are idle ones.
    pub fn new(limit: usize, reserved: usize) -> Self {
        Self { limit, reserved: reserved.min(limit / 2), open: Mutex::default(), guests: TaskTracker::new() }
    }

    /// A place for a new one, unless all are taken by connections that are being answered.
    pub fn admit(self: &Arc<Self>, closing: &CancellationToken) -> Option<Guest> {
        let mut open = self.open();
        if open.guests.len() >= self.limit - self.reserved {
            let idle = open.guests.iter().filter(|(_, entry)| entry.busy == 0 && !entry.stays);
            let longest = idle.map(|(id, entry)| (entry.idle_since, *id)).min();
            // It is forgotten at once, so that nobody else is sent away in its stead while it leaves.
            if let Some(entry) = longest.and_then(|(_, id)| open.guests.remove(&id)) {
                entry.leave.cancel();
            }
        }
        if open.guests.len() >= self.limit {
            return None;
        }
        let (id, leave) = (open.next, closing.child_token());
        open.next += 1;
        open.guests.insert(id, Entry { busy: 0, idle_since: Instant::now(), stays: false, leave: leave.clone() });
        let (used, counted) = (AtomicBool::new(false), self.guests.token());
        Some(Guest { id, leave, used, connections: self.clone(), _counted: counted })
    }

    /// Waits until all have ended.
    pub async fn all_ended(&self) {
        self.guests.close();
        self.guests.wait().await;
    }

    /// A panic while it was locked has left nothing half done.
    fn open(&self) -> MutexGuard<'_, Open> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn change(&self, id: u64, change: impl FnOnce(&mut Entry)) {
        if let Some(entry) = self.open().guests.get_mut(&id) {
            change(entry);
        }
    }
}

/// A connection's place, until it is dropped.
#[derive(Debug)]
pub struct Guest {
    id: u64,
    leave: CancellationToken,
    used: AtomicBool,
    connections: Arc<Connections>,
    _counted: TaskTrackerToken,
}

impl Guest {
    /// When the connection has to end.
    pub async fn asked_to_leave(&self) {
        self.leave.cancelled().await;
    }

    /// Whether no request has come yet, or not all of its header.
    pub fn is_unused(&self) -> bool {
        !self.used.load(Ordering::Relaxed)
    }

    /// Keeps the place for as long as the client likes, from now on. Not where nothing but the reserve would be left.
    pub fn stay(&self) -> bool {
        let mut open = self.connections.open();
        let staying = open.guests.values().filter(|entry| entry.stays).count();
        let room = staying < self.connections.limit - self.connections.reserved;
        if let Some(entry) = open.guests.get_mut(&self.id).filter(|_| room) {
            entry.stays = true;
        }
        room
    }

    /// Marks what keeps the connection, until it is dropped: a request that is being answered.
    pub fn busy(self: &Arc<Self>) -> Busy {
        self.used.store(true, Ordering::Relaxed);
        self.connections.change(self.id, |entry| entry.busy += 1);
        Busy(self.clone())
    }
}

impl Drop for Guest {
    fn drop(&mut self) {
        self.connections.open().guests.remove(&self.id);
    }
}

/// What keeps a connection, such as a request that is being answered.
#[derive(Debug)]
pub struct Busy(Arc<Guest>);

impl Drop for Busy {
    fn drop(&mut self) {
        self.0.connections.change(self.0.id, |entry| {
            entry.busy = entry.busy.saturating_sub(1);
            entry.idle_since = Instant::now();
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn admit(connections: &Arc<Connections>) -> Option<Arc<Guest>> {
        connections.admit(&CancellationToken::new()).map(Arc::new)
    }

    #[test]
    fn the_longest_idle_one_makes_room() {
        let connections = Arc::new(Connections::new(3, 1));
        let (first, second) = (admit(&connections).unwrap(), admit(&connections).unwrap());
        drop(first.busy());
        let _third = admit(&connections).unwrap();
        assert!(second.leave.is_cancelled() && !first.leave.is_cancelled());
    }

    #[test]
    fn what_is_being_answered_is_never_sent_away() {
        let connections = Arc::new(Connections::new(2, 0));
        let (first, second) = (admit(&connections).unwrap(), admit(&connections).unwrap());
        let busy = (first.busy(), second.busy());
        assert!(admit(&connections).is_none());
        drop(busy);
        assert!(admit(&connections).is_some());
    }

    #[test]
    fn what_is_busy_twice_is_busy_until_both_have_ended() {
        let connections = Arc::new(Connections::new(1, 0));
        let guest = admit(&connections).unwrap();
        let (first, second) = (guest.busy(), guest.busy());
        drop(first);
        assert!(admit(&connections).is_none());
        drop(second);
        assert!(admit(&connections).is_some());
    }

    #[test]
    fn who_stays_is_never_sent_away_and_leaves_the_reserve_free() {
        let connections = Arc::new(Connections::new(4, 2));
        let stays: Vec<_> = (0..2).map(|_| admit(&connections).unwrap()).collect();
        assert!(stays.iter().all(|guest| guest.stay()));
        drop(stays[0].busy());
        let third = admit(&connections).unwrap();
        assert!(!third.stay(), "only the reserve is left");
        let _fourth = admit(&connections).unwrap();
        assert!(third.leave.is_cancelled() && stays.iter().all(|guest| !guest.leave.is_cancelled()));
    }

    #[test]
    fn a_place_is_free_again_when_its_connection_has_ended() {
        let connections = Arc::new(Connections::new(1, 0));
        let first = admit(&connections).unwrap();
        let busy = first.busy();
        assert!(admit(&connections).is_none());
        drop((first, busy));
        assert!(admit(&connections).is_some());
    }

    #[test]
    fn all_are_asked_to_leave_on_closing() {
        let connections = Arc::new(Connections::new(2, 0));
        let closing = CancellationToken::new();
        let guest = connections.admit(&closing).unwrap();
        closing.cancel();
        assert!(guest.leave.is_cancelled());
    }
}
