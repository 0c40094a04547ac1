//! Accepting connections, with one rule for all interfaces.
//!
//! [`Admission`] decides which connections are kept. Evicted connections keep their descriptors until they have ended. While
//! too many of them are ending, a further connection is accepted nevertheless, since it can bring a FAST STOP: it gets a
//! moment to send its first bytes, and is served if they are those of a FAST STOP. A listener therefore waits for nothing
//! that other clients can prolong, and the kernel's queue does not overflow.

use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use rustix::net::RecvFlags;
use socket2::{Domain, Socket, Type};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::OwnedSemaphorePermit;
use tokio::task::JoinSet;
use tokio::time::{Instant, sleep, timeout};
use tokio_util::sync::CancellationToken;

use super::admission::{Admission, Patience, UndecidedSlot};

/// Connections that the kernel queues until they are accepted. A FAST STOP waits in this queue during a flood of
/// connects, so a larger backlog delays it longer. With a smaller one, the kernel drops connects, which clients repeat only
/// after a second.
const BACKLOG: i32 = 2048;

/// Pause after a failed accept: long enough not to spin while the process is out of file descriptors, short enough not
/// to be noticed.
const ACCEPT_PAUSE: Duration = Duration::from_millis(5);

/// Time that accepting waits for evicted connections to end.
const ROOM_WITHIN: Duration = Duration::from_millis(10);

/// Pause after a wait for evicted connections that freed nothing.
const STALLED_FOR: Duration = Duration::from_millis(200);

/// Bytes that are searched for a FAST STOP, which is usually whole within them.
pub const FIRST_BYTES: usize = 1024;

/// Time for the first bytes of a connection that has found no room, and for the rest of a first line after its beginning.
pub const FIRST_BYTES_WITHIN: Duration = Duration::from_millis(20);

/// Time for the rest of a FAST STOP whose first bytes have arrived. It is short, since a FAST STOP waits for nothing else.
pub const REST_WITHIN: Duration = Duration::from_millis(1);

/// Listens on an address. The listener is not registered with a runtime.
///
/// # Errors
/// The operating system's error.
pub fn listen(address: SocketAddr) -> io::Result<std::net::TcpListener> {
    let socket = Socket::new(Domain::for_address(address), Type::STREAM, None)?;
    // A restarted gateway must not wait for the connections of its last run to time out.
    socket.set_reuse_address(true)?;
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    socket.listen(BACKLOG)?;
    Ok(socket.into())
}

/// The waits of a listener between two connections.
#[derive(Debug, Default)]
pub struct Acceptor {
    stalled_at: Option<Instant>,
    patience: Patience,
}

impl Acceptor {
    /// Waits until the next connection should be accepted, a few milliseconds at most.
    pub async fn ready(&mut self, admission: &Admission) {
        // Evicted connections usually end at once.
        if admission.is_crowded() && self.stalled_at.is_none_or(|at| at.elapsed() > STALLED_FOR) {
            let has_room = timeout(ROOM_WITHIN, admission.has_room()).await.is_ok();
            self.stalled_at = (!has_room).then(Instant::now);
        }
        self.patience.wait(admission).await;
    }

    /// Handles a failed accept.
    pub async fn failed(&self, admission: &Admission, error: io::Error) {
        tracing::warn!(%error, "connection could not be accepted");
        admission.evict_one();
        sleep(ACCEPT_PAUSE).await;
    }
}

/// How an interface recognises a FAST STOP in the first bytes of a connection.
#[derive(Debug, Clone, Copy)]
pub struct FastStopRule {
    /// Whether bytes can be the first of a FAST STOP.
    pub may_begin: fn(&[u8]) -> bool,
    /// Whether bytes begin with a whole FAST STOP.
    pub is_whole: fn(&[u8]) -> bool,
}

/// Slot of a connection that has found no room.
#[derive(Debug)]
pub enum CrowdSlot {
    Reserved(OwnedSemaphorePermit),
    /// Gives way to newer connections.
    Undecided(UndecidedSlot),
}

impl CrowdSlot {
    /// Completes when a newer connection has got the slot.
    async fn gives_way(&self) {
        match self {
            Self::Reserved(_) => std::future::pending().await,
            Self::Undecided(slot) => slot.gives_way().await,
        }
    }
}

/// Returns a slot for a connection that has found no room, unless its first bytes are not those of a FAST STOP. A client
/// whose processor is busy sends them only some milliseconds after its connect. Some slots are reserved for those that have
/// sent a whole FAST STOP.
pub async fn slot_in_crowd(admission: &Admission, stream: &TcpStream, rule: FastStopRule) -> Option<CrowdSlot> {
    let mut first = [0; FIRST_BYTES];
    let seen = peek_now(stream, &mut first);
    let first = first.get(..seen).unwrap_or_default();
    if !first.is_empty() && !(rule.may_begin)(first) {
        return None;
    }
    match admission.reserved((rule.is_whole)(first)) {
        Some(slot) => Some(CrowdSlot::Reserved(slot)),
        None => admission.undecided().await.map(CrowdSlot::Undecided),
    }
}

/// Waits a moment for the FAST STOP of a connection that has found no room. Returns the slot in which it is admitted, if it
/// has brought one. One whose rest is late needs a reserved slot: a flood of those would otherwise take the processor from
/// whole ones.
pub async fn fast_stop_in_crowd(
    admission: &Admission,
    stream: &TcpStream,
    slot: CrowdSlot,
    rule: FastStopRule,
) -> Option<OwnedSemaphorePermit> {
    let mut first = [0; FIRST_BYTES];
    let arrives = async {
        let seen = timeout(FIRST_BYTES_WITHIN, stream.peek(&mut first)).await;
        let seen = seen.map_or(0, Result::unwrap_or_default);
        let is_whole = (rule.is_whole)(first.get(..seen).unwrap_or_default());
        if !is_whole && matches!(slot, CrowdSlot::Undecided(_)) {
            sleep(REST_WITHIN).await;
        }
    };
    tokio::select! {
        biased;
        () = slot.gives_way() => {}
        () = arrives => {}
    }
    // Bytes that arrived before it gave way still count.
    let seen = peek_now(stream, &mut first);
    let first = first.get(..seen).unwrap_or_default();
    if !(rule.may_begin)(first) {
        return None;
    }
    let is_whole = (rule.is_whole)(first);
    match slot {
        CrowdSlot::Reserved(slot) => Some(slot),
        CrowdSlot::Undecided(slot) if is_whole => slot.keep().or_else(|| admission.reserved(true)),
        CrowdSlot::Undecided(_) => admission.reserved(false),
    }
}

/// Peeks without waiting for tokio's readiness, which a fresh stream does not have yet.
pub fn peek_now(stream: &TcpStream, buffer: &mut [u8]) -> usize {
    rustix::net::recv(stream, buffer, RecvFlags::PEEK | RecvFlags::DONTWAIT).map_or(0, |(_, bytes)| bytes)
}

/// Accepts clients until `draining`, and runs what `admit` returns for each. Returns the clients that are still served.
pub async fn each<A, F>(
    listener: &TcpListener,
    admission: &Arc<Admission>,
    draining: &CancellationToken,
    rule: FastStopRule,
    admit: A,
) -> JoinSet<()>
where
    A: Fn(TcpStream, SocketAddr) -> Option<F> + Clone + Send + 'static,
    F: Future<Output = ()> + Send + 'static,
{
    let mut clients = JoinSet::new();
    let mut acceptor = Acceptor::default();
    loop {
        let accepted = tokio::select! {
            biased;
            () = draining.cancelled() => return clients,
            Some(_) = clients.join_next() => continue,
            accepted = async {
                acceptor.ready(admission).await;
                listener.accept().await
            } => accepted,
        };
        let (stream, peer) = match accepted {
            Ok(accepted) => accepted,
            Err(error) => {
                acceptor.failed(admission, error).await;
                continue;
            }
        };
        if !admission.is_crowded() {
            if let Some(served) = admit(stream, peer) {
                clients.spawn(served);
            }
            continue;
        }
        let Some(slot) = slot_in_crowd(admission, &stream, rule).await else { continue };
        let admission = admission.clone();
        let admit = admit.clone();
        clients.spawn(async move {
            let slot = fast_stop_in_crowd(&admission, &stream, slot, rule).await;
            let is_served = slot.is_some();
            drop(slot);
            if is_served && let Some(served) = admit(stream, peer) {
                served.await;
            }
        });
    }
}
