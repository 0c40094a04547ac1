//! Bounds of the replies that other nodes of the network send. Anyone can invent gateways and answer in their names, so
//! what is held at a time is bounded as a whole, and a single session gets little of it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use zenoh::query::Reply;

/// Largest accepted reply of another gateway, in bytes.
pub(super) const MAX_REPLY_BYTES: usize = 1 << 20;

/// Maximum number of replies to one query that wait to be checked. Only one gateway is asked, and it sends one reply.
pub(super) const MAX_WAITING: usize = 16;

/// Replies of one session to one query that are taken. An honest gateway sends one.
const MAX_OF_SESSION: usize = 1;

/// Sessions whose replies to one query are counted.
const MAX_SESSIONS: usize = 64;

/// Replies to all queries that wait to be checked, in KiB.
const WAITING_KIB: usize = 32 * 1024;

/// Size up to which a reply is always collected for a client: a full page of records. Together, 128 gateways then take
/// 16 MiB.
const ALWAYS_COLLECTED_BYTES: usize = 128 * 1024;

/// Larger replies that are collected for clients, in KiB.
const LARGE_KIB: usize = 16 * 1024;

/// Requests that collect replies of all gateways at the same time. Others wait for their turn.
pub(super) const MAX_COLLECTIONS: usize = 2;

/// Room for the replies of other nodes.
#[derive(Debug)]
pub(super) struct ReplyRoom {
    waiting: Arc<Semaphore>,
    large: Arc<Semaphore>,
}

impl Default for ReplyRoom {
    fn default() -> Self {
        Self { waiting: Arc::new(Semaphore::new(WAITING_KIB)), large: Arc::new(Semaphore::new(LARGE_KIB)) }
    }
}

/// Room for a large reply, until it is dropped; nothing for a small one.
#[derive(Debug)]
pub struct CollectedRoom {
    _large: Option<OwnedSemaphorePermit>,
}

impl ReplyRoom {
    /// Returns the room for collecting a reply of this size, or `None` if large replies already take all of it.
    pub(super) fn collected(&self, bytes: usize) -> Option<CollectedRoom> {
        if bytes <= ALWAYS_COLLECTED_BYTES {
            return Some(CollectedRoom { _large: None });
        }
        let large = self.large.clone().try_acquire_many_owned(kib(bytes)).ok()?;
        Some(CollectedRoom { _large: Some(large) })
    }
}

/// A reply that waits to be checked, and its room.
pub(super) struct WaitingReply {
    pub reply: Reply,
    _room: OwnedSemaphorePermit,
}

/// Takes the replies to one query.
pub(super) struct ReplyFilter {
    waiting: Arc<Semaphore>,
    sessions: Mutex<BTreeMap<String, usize>>,
}

impl ReplyFilter {
    pub(super) fn new(room: &ReplyRoom) -> Self {
        Self { waiting: room.waiting.clone(), sessions: Mutex::default() }
    }

    /// Returns a reply with its room, or `None` if it is too large, if its session has replied already, or if no room
    /// is left.
    pub(super) fn take(&self, reply: Reply) -> Option<WaitingReply> {
        let bytes = match reply.result() {
            Ok(sample) => sample.payload().len(),
            Err(error) => error.payload().len(),
        };
        let session = reply.replier_id().map_or_else(String::new, |replier| replier.zid().to_string());
        let room = self.admit(session, bytes)?;
        Some(WaitingReply { reply, _room: room })
    }

    fn admit(&self, session: String, bytes: usize) -> Option<OwnedSemaphorePermit> {
        if bytes > MAX_REPLY_BYTES {
            return None;
        }
        let mut sessions = self.sessions.lock().unwrap_or_else(PoisonError::into_inner);
        if sessions.len() >= MAX_SESSIONS && !sessions.contains_key(&session) {
            return None;
        }
        let count = sessions.entry(session).or_default();
        if *count >= MAX_OF_SESSION {
            return None;
        }
        *count += 1;
        self.waiting.clone().try_acquire_many_owned(kib(bytes)).ok()
    }
}

/// Returns a size in KiB, rounded up. A reply has 1 MiB at most.
fn kib(bytes: usize) -> u32 {
    bytes.div_ceil(1024) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn session_is_heard_once_and_large_replies_are_bounded_as_a_whole() {
        let room = ReplyRoom::default();
        let filter = ReplyFilter::new(&room);
        assert!(filter.admit("a".to_owned(), MAX_REPLY_BYTES + 1).is_none());
        let first = filter.admit("a".to_owned(), MAX_REPLY_BYTES);
        assert!(first.is_some() && filter.admit("a".to_owned(), 1).is_none());
        let filters: Vec<_> = (0..100).map(|_| ReplyFilter::new(&room)).collect();
        let held: Vec<_> = filters.iter().filter_map(|other| other.admit("a".to_owned(), MAX_REPLY_BYTES)).collect();
        assert_eq!(held.len(), WAITING_KIB / 1024 - 1);
        drop((first, held));
        assert!(ReplyFilter::new(&room).admit("b".to_owned(), MAX_REPLY_BYTES).is_some());
    }

    #[test]
    fn pages_are_collected_however_many_large_replies_there_are() {
        let room = ReplyRoom::default();
        let large: Vec<_> = (0..128).filter_map(|_| room.collected(MAX_REPLY_BYTES)).collect();
        assert_eq!(large.len(), LARGE_KIB / 1024);
        assert!(room.collected(ALWAYS_COLLECTED_BYTES).is_some());
        drop(large);
        assert!(room.collected(MAX_REPLY_BYTES).is_some());
    }
}
