//! Admission: decides which of a listener's connections are kept and which give way to others.
//!
//! A connection is in one [`Class`] at a time, and each class has its own bound, so that no kind of traffic can use up
//! the slots of another. If the class of connections without a complete request is full, the oldest of them is closed
//! to admit the newest, so that a FAST STOP always finds a slot. A connection that has sent nothing yet may bring a FAST
//! STOP: for its first milliseconds, a connection that has sent something is closed in its place. The peer with the most
//! connections in that class loses one, so that one address cannot shut out the others.
//!
//! The total bytes held for connections are bounded, too: beyond [`Bounds::held_bytes`] the connection that holds the
//! most is closed first.

mod bounds;
mod metrics;
mod patience;
mod table;
mod undecided;

use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tokio_util::task::task_tracker::TaskTrackerToken;

pub use bounds::{Bounds, Class};
pub use metrics::Usage;
pub use patience::Patience;
pub use table::peer;
use table::{Id, Table};
use undecided::Undecided;
pub use undecided::UndecidedSlot;

/// Time for an evicted connection to deliver its response, also to a FAST STOP whose first bytes arrived before the
/// eviction.
const LINGER: Duration = Duration::from_millis(100);

/// Time for an evicted connection to get the answer to a whole request: as long as a FAST STOP waits for its confirmation,
/// and a little more.
const LINGER_FOR_ANSWER: Duration = Duration::from_millis(300);

/// Extra slots for connections that begin with a whole FAST STOP. They leave their slot within microseconds, so their
/// descriptors are among those that the gateway keeps for itself.
const FOR_WHOLE_FAST_STOPS: usize = 4;

/// The connections of one listener.
#[derive(Debug)]
pub struct Admission {
    table: Mutex<Table>,
    /// Notified when an evicted connection has ended.
    ended: Notify,
    /// Notified when a claim was dropped.
    released: Notify,
    tracker: TaskTracker,
    /// Slots for inspecting connections while too many others are leaving.
    reserve: Arc<Semaphore>,
    /// Slots for connections that were evicted before their first byte, or that have found no room, and may still bring a
    /// FAST STOP.
    undecided: Arc<Undecided>,
}

impl Admission {
    #[must_use]
    pub fn new(bounds: Bounds) -> Arc<Self> {
        let table = Mutex::new(Table::new(bounds));
        let tracker = TaskTracker::new();
        let reserve = Arc::new(Semaphore::new(bounds.reserved + FOR_WHOLE_FAST_STOPS));
        let undecided = Undecided::new(bounds.displaced);
        Arc::new(Self { table, ended: Notify::new(), released: Notify::new(), tracker, reserve, undecided })
    }

    /// Admits a connection as [`Class::Incoming`]. Cancelling `closing` evicts the connection, too.
    pub fn admit(self: &Arc<Self>, peer: IpAddr, closing: &CancellationToken) -> ConnectionPermit {
        let evicted = closing.child_token();
        let id = self.table().admit(peer, now(), evicted.clone());
        let tracked = self.tracker.token();
        ConnectionPermit { id, evicted, has_served: AtomicBool::new(false), admission: self.clone(), _tracked: tracked }
    }

    /// Waits until few enough evicted connections are still ending. Each keeps its descriptor until it has ended.
    pub async fn has_room(&self) {
        loop {
            let ended = self.ended.notified();
            if !self.is_crowded() {
                return;
            }
            ended.await;
        }
    }

    /// Whether one more connection would evict one that has had no time to send its first bytes, and that would find no
    /// displaced slot. Evicted connections that are still ending may each take such a slot.
    fn would_displace(&self) -> bool {
        let table = self.table();
        !table.is_crowded() && table.is_full_of_silent(now()) && self.undecided.available() <= table.leaving()
    }

    /// Whether so many evicted connections are still ending that no further connection is admitted.
    pub fn is_crowded(&self) -> bool {
        self.table().is_crowded()
    }

    /// Returns a slot for inspecting a connection while too many others are leaving. Some slots are reserved for
    /// connections that begin with a whole FAST STOP, which need them for microseconds only.
    pub fn reserved(&self, has_fast_stop: bool) -> Option<OwnedSemaphorePermit> {
        let has_room = has_fast_stop || self.reserve.available_permits() > FOR_WHOLE_FAST_STOPS;
        has_room.then(|| self.reserve.clone().try_acquire_owned().ok()).flatten()
    }

    /// Returns a free slot for a connection that was evicted before its first byte. It may begin a FAST STOP.
    pub fn displaced(&self) -> Option<UndecidedSlot> {
        self.undecided.free()
    }

    /// Returns a free slot for a connection that has found no room, and does not give way.
    pub fn lasting(&self) -> Option<OwnedSemaphorePermit> {
        self.undecided.lasting()
    }

    /// Returns a slot for a connection that has found no room, and may still bring a FAST STOP. Of the connections in such
    /// slots, the oldest gives way.
    pub async fn undecided(&self) -> Option<UndecidedSlot> {
        self.undecided.newest().await
    }

    /// Closes the oldest connection without a claim, because the process is out of descriptors.
    pub fn evict_one(&self) {
        self.table().evict_unclaimed();
    }

    pub async fn all_ended(&self) {
        self.tracker.close();
        self.tracker.wait().await;
    }

    /// Locks the table. A poisoned lock is safe to use: a panic leaves no operation half done.
    fn table(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns the time by tokio's clock, which tests can pause.
fn now() -> Instant {
    tokio::time::Instant::now().into_std()
}

/// A connection's slot, held until the permit is dropped.
#[derive(Debug)]
pub struct ConnectionPermit {
    id: Id,
    evicted: CancellationToken,
    has_served: AtomicBool,
    admission: Arc<Admission>,
    _tracked: TaskTrackerToken,
}

impl ConnectionPermit {
    /// Completes when the connection has to end.
    pub async fn evicted(&self) {
        self.evicted.cancelled().await;
    }

    /// Whether the connection has to end.
    pub fn is_evicted(&self) -> bool {
        self.evicted.is_cancelled()
    }

    /// Whether no complete request has arrived yet.
    pub fn is_unused(&self) -> bool {
        !self.has_served.load(Ordering::Relaxed)
    }

    /// Returns the time for an evicted connection to deliver its response; zero while many others are ending.
    pub fn linger(&self) -> Duration {
        self.linger_besides(0)
    }

    /// Returns the time for an evicted connection to get the answer to a whole request; zero only while too many others
    /// are ending.
    pub fn linger_for_answer(&self) -> Duration {
        if self.admission.is_crowded() { Duration::ZERO } else { LINGER_FOR_ANSWER }
    }

    /// Whether a whole request of this connection is being answered.
    pub fn has_whole_request(&self) -> bool {
        self.admission.table().has_claim(self.id)
    }

    /// Gives the slot of a connection back that was evicted before its first byte, and returns one in which it can wait a
    /// moment for the first bytes; `None` if all of these are taken.
    pub fn displaced(&self) -> Option<OwnedSemaphorePermit> {
        self.closed();
        self.admission.lasting()
    }

    /// Frees the slot of an evicted connection whose socket is closed. A FAST STOP can still use the permit.
    pub fn closed(&self) {
        self.admission.table().remove(self.id);
        self.admission.ended.notify_one();
    }

    /// Like [`Self::linger`], for a connection whose FAST STOP has only begun to arrive. It does not count itself, so that it can linger
    /// even with few descriptors.
    pub fn linger_for_fast_stop(&self) -> Duration {
        self.linger_besides(1)
    }

    fn linger_besides(&self, leaving: usize) -> Duration {
        if self.admission.table().is_half_crowded(leaving) { Duration::ZERO } else { LINGER }
    }

    /// Marks that the first bytes have arrived, unless they may be those of a FAST STOP.
    pub fn begun(&self) {
        self.admission.table().begun(self.id);
    }

    /// Marks this connection as the newest idle one, because its client sent something.
    pub fn heard(&self) {
        self.admission.table().heard(self.id, now());
    }

    /// Marks that a request has begun to arrive. The connection has no claim until the request is complete.
    pub fn receiving(&self) {
        self.admission.table().receiving(self.id, now());
    }

    /// Marks that the client exceeded its share. Until its next request is answered, the connection gives way like a
    /// silent one.
    pub fn demote(&self) {
        self.admission.table().demote(self.id);
    }

    /// Puts the connection into a class until the claim is dropped; afterwards it is idle. Returns `None` if the class
    /// is full and none of its connections has to give way.
    pub fn claim(self: &Arc<Self>, class: Class) -> Option<Claim> {
        self.has_served.store(true, Ordering::Relaxed);
        let yielded = CancellationToken::new();
        self.admission.table().claim(self.id, class, now(), &yielded)?;
        if matches!(class, Class::Waiting | Class::Streaming) {
            // The connection has left its former class.
            self.admission.released.notify_one();
        }
        Some(Claim { permit: self.clone(), class, yielded })
    }

    /// Claims a slot like [`Self::claim`], waiting until the class has room.
    pub async fn turn(self: &Arc<Self>, class: Class) -> Claim {
        loop {
            let released = self.admission.released.notified();
            tokio::pin!(released);
            // Registered before the check, so that a slot freed in between is noticed.
            released.as_mut().enable();
            if let Some(claim) = self.claim(class) {
                return claim;
            }
            released.await;
        }
    }

    /// Returns a counter, initially zero, of bytes that the gateway holds for this connection.
    pub fn held(self: &Arc<Self>) -> HeldBytes {
        HeldBytes { permit: self.clone(), bytes: 0 }
    }
}

impl Drop for ConnectionPermit {
    fn drop(&mut self) {
        self.admission.table().remove(self.id);
        self.admission.ended.notify_one();
    }
}

/// A connection's slot in a class, held until the claim is dropped.
#[derive(Debug)]
pub struct Claim {
    permit: Arc<ConnectionPermit>,
    class: Class,
    yielded: CancellationToken,
}

impl Claim {
    /// Completes when this claim has to give way to another peer's. Only claims of [`Class::Waiting`] yield; in other
    /// classes the whole connection is evicted.
    pub async fn yielded(&self) {
        self.yielded.cancelled().await;
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.permit.admission.table().release(self.permit.id, self.class, now());
        self.permit.admission.released.notify_one();
    }
}

/// Count of bytes that the gateway holds for a connection: requests in progress, or responses not yet received.
#[derive(Debug)]
pub struct HeldBytes {
    permit: Arc<ConnectionPermit>,
    bytes: usize,
}

impl HeldBytes {
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    pub fn set(&mut self, bytes: usize) {
        self.permit.admission.table().hold(self.permit.id, self.bytes, bytes);
        self.bytes = bytes;
    }
}

impl Drop for HeldBytes {
    fn drop(&mut self) {
        self.set(0);
    }
}

#[cfg(test)]
mod tests;
