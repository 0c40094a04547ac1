//! Admission: which of a listener's connections are kept, and which give way to others.
//!
//! A connection is in one [`Class`] at a time, and each class has a bound of its own, so that no kind of traffic can use
//! up the slots of another. A connection that has not sent a complete request has no claim: where its class is full, the
//! oldest one gives way to the newest, so that a FAST STOP finds a slot whatever else is open. The peer with the
//! most connections in that class loses one, so that one address cannot shut out the others.
//!
//! The bytes that connections make the gateway hold are bounded in all, too: beyond [`Bounds::held_bytes`] the connection
//! that holds the most is closed first.

mod bounds;
mod metrics;
mod table;

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
use table::{Id, Table};

/// How long an evicted connection may take to deliver an answer, and to have a FAST STOP answered whose first bytes came
/// before its eviction.
const LINGER: Duration = Duration::from_millis(100);

/// Places beside the reserved ones for connections whose first line is there. They leave it within microseconds, so their
/// descriptors are among those that the gateway keeps for itself.
const FOR_COMPLETE_LINES: usize = 4;

/// The connections of one listener.
#[derive(Debug)]
pub struct Admission {
    table: Mutex<Table>,
    /// Notified when an evicted connection has ended.
    ended: Notify,
    /// Notified when a claim was dropped.
    released: Notify,
    tracker: TaskTracker,
    /// Connections that may be looked at while too many are leaving.
    reserve: Arc<Semaphore>,
}

impl Admission {
    /// Admission within these bounds.
    #[must_use]
    pub fn new(bounds: Bounds) -> Arc<Self> {
        let (table, tracker) = (Mutex::new(Table::new(bounds)), TaskTracker::new());
        let reserve = Arc::new(Semaphore::new(bounds.reserved + FOR_COMPLETE_LINES));
        Arc::new(Self { table, ended: Notify::new(), released: Notify::new(), tracker, reserve })
    }

    /// Admits a connection as [`Class::Incoming`]. It is asked to end on `closing`, too.
    pub fn admit(self: &Arc<Self>, peer: IpAddr, closing: &CancellationToken) -> ConnectionPermit {
        let evicted = closing.child_token();
        let id = self.table().admit(peer, Instant::now(), evicted.clone());
        let tracked = self.tracker.token();
        ConnectionPermit { id, evicted, has_served: AtomicBool::new(false), admission: self.clone(), _tracked: tracked }
    }

    /// Waits until few enough evicted connections are still ending, each of which has its descriptor until then.
    pub async fn has_room(&self) {
        loop {
            let ended = self.ended.notified();
            if !self.is_crowded() {
                return;
            }
            ended.await;
        }
    }

    /// Whether so many evicted connections are still ending that no further one may be admitted.
    pub fn is_crowded(&self) -> bool {
        self.table().is_crowded()
    }

    /// A place to look at a connection while too many are leaving, if there is one. Some are only for connections whose first
    /// line is there, and which leave their place within microseconds: others may take as long as a line may.
    pub fn reserved(&self, has_line: bool) -> Option<OwnedSemaphorePermit> {
        let has_room = has_line || self.reserve.available_permits() > FOR_COMPLETE_LINES;
        has_room.then(|| self.reserve.clone().try_acquire_owned().ok()).flatten()
    }

    /// Closes the oldest connection that has no claim, where the process is out of descriptors.
    pub fn evict_one(&self) {
        self.table().evict_unclaimed();
    }

    /// Waits until all connections have ended.
    pub async fn all_ended(&self) {
        self.tracker.close();
        self.tracker.wait().await;
    }

    /// A panic while the lock was held has left nothing half done.
    fn table(&self) -> MutexGuard<'_, Table> {
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A connection's slot, until it is dropped.
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

    /// Whether no complete request has come yet.
    pub fn is_unused(&self) -> bool {
        !self.has_served.load(Ordering::Relaxed)
    }

    /// How long an evicted connection may take to deliver an answer: no time where many are ending.
    pub fn linger(&self) -> Duration {
        if self.admission.table().is_half_crowded() { Duration::ZERO } else { LINGER }
    }

    /// Marks that the client was heard, which makes this connection the newest idle one.
    pub fn heard(&self) {
        self.admission.table().heard(self.id, Instant::now());
    }

    /// Marks that a request has begun to come: until all of it is there, the connection has no claim.
    pub fn receiving(&self) {
        self.admission.table().receiving(self.id, Instant::now());
    }

    /// Marks that the client asks for more than there is: until its next request is answered, the connection gives way as
    /// one that says nothing.
    pub fn demote(&self) {
        self.admission.table().demote(self.id);
    }

    /// Puts the connection into a class until the claim is dropped; afterwards it is idle. `None` where the class is full
    /// and nobody in it has to give way.
    pub fn claim(self: &Arc<Self>, class: Class) -> Option<Claim> {
        self.has_served.store(true, Ordering::Relaxed);
        let yielded = CancellationToken::new();
        self.admission.table().claim(self.id, class, Instant::now(), &yielded)?;
        if matches!(class, Class::Waiting | Class::Streaming) {
            // The connection has left its former class.
            self.admission.released.notify_one();
        }
        Some(Claim { permit: self.clone(), class, yielded })
    }

    /// The same, once the class has room.
    pub async fn turn(self: &Arc<Self>, class: Class) -> Claim {
        loop {
            let released = self.admission.released.notified();
            tokio::pin!(released);
            // Registered before the look, so that a slot that is freed in between is noticed.
            released.as_mut().enable();
            if let Some(claim) = self.claim(class) {
                return claim;
            }
            released.await;
        }
    }

    /// Counts bytes that the gateway holds for this connection: none yet.
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

/// A connection's place in a class, until it is dropped.
#[derive(Debug)]
pub struct Claim {
    permit: Arc<ConnectionPermit>,
    class: Class,
    yielded: CancellationToken,
}

impl Claim {
    /// Completes when this claim has to give way to another peer's. Only claims of [`Class::Waiting`] ever have to: where
    /// one of another class gives way, its connection is evicted.
    pub async fn yielded(&self) {
        self.yielded.cancelled().await;
    }
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.permit.admission.table().release(self.permit.id, self.class, Instant::now());
        self.permit.admission.released.notify_one();
    }
}

/// How many bytes the gateway holds for a connection in one place: requests under way, or answers not yet taken.
#[derive(Debug)]
pub struct HeldBytes {
    permit: Arc<ConnectionPermit>,
    bytes: usize,
}

impl HeldBytes {
    /// The count.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Corrects the count.
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
