//! The table behind [`super::Admission`]: each connection's class and age, and which connection gives way. A pure
//! machine: the caller passes the time, and a cancellation token notifies the evicted connection.

use std::collections::{BTreeSet, HashMap};
use std::net::{IpAddr, Ipv6Addr};
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use super::bounds::{Bounds, CLASSES, Class, WhenFull};

/// A connection's number, never reused.
pub(super) type Id = u64;

/// One peer: an IPv4 address, or an IPv6 /64 network, since one machine can use all of its addresses.
pub type Peer = IpAddr;

/// Advantage in rank of a connection that has sent nothing yet, because it may still bring a FAST STOP. A client sends
/// its first bytes within a millisecond, unless its machine is busy.
pub(super) const SILENT_FOR: Duration = Duration::from_millis(5);

#[derive(Debug)]
pub(super) struct Table {
    bounds: Bounds,
    next: Id,
    entries: HashMap<Id, Entry>,
    classes: [Members; CLASSES],
    /// Evicted connections that have not ended.
    leaving: usize,
    /// Bytes held for the connections that are not leaving.
    held_bytes: usize,
    evicted: u64,
}

/// The connections of one class, each peer's oldest first.
#[derive(Debug, Default)]
struct Members {
    count: usize,
    /// Ranks and numbers of the connections.
    peers: HashMap<Peer, BTreeSet<(Instant, Id)>>,
}

#[derive(Debug)]
struct Entry {
    peer: Peer,
    /// Class of the connection while it has no claim: [`Class::Incoming`] or [`Class::Idle`].
    base: Class,
    /// Whether no bytes have been seen yet, apart from those of a FAST STOP.
    is_silent: bool,
    /// Whether the client exceeded its share: without a claim its connection is [`Class::Incoming`], even when idle.
    is_demoted: bool,
    claims: [u32; CLASSES],
    since: Instant,
    evicted: CancellationToken,
    /// Cancels the claim of [`Class::Waiting`].
    yielded: Option<CancellationToken>,
    held_bytes: usize,
    is_leaving: bool,
}

impl Entry {
    fn class(&self) -> Class {
        use Class::{Answering, Pinned, Streaming, Urgent, Waiting};
        let unclaimed = if self.is_demoted { Class::Incoming } else { self.base };
        let mut by_precedence = [Pinned, Streaming, Waiting, Urgent, Answering].into_iter();
        by_precedence.find(|class| self.claims[*class as usize] > 0).unwrap_or(unclaimed)
    }

    /// Whether the connection is not evicted for its bytes.
    fn is_spared(&self) -> bool {
        self.is_leaving || self.class() == Class::Pinned
    }

    /// Rank among the connections of a class and peer: the lowest gives way first.
    fn rank(&self) -> Instant {
        if self.is_silent { self.since + SILENT_FOR } else { self.since }
    }
}

impl Table {
    pub(super) fn new(bounds: Bounds) -> Self {
        let entries = HashMap::new();
        let classes = std::array::from_fn(|_| Members::default());
        Self { bounds, next: 0, entries, classes, leaving: 0, held_bytes: 0, evicted: 0 }
    }

    pub(super) fn admit(&mut self, address: IpAddr, now: Instant, evicted: CancellationToken) -> Id {
        let id = self.next;
        let peer = peer(address);
        let base = Class::Incoming;
        self.next += 1;
        self.make_room(base, peer);
        let entry = Entry {
            peer,
            base,
            is_silent: true,
            is_demoted: false,
            claims: [0; CLASSES],
            since: now,
            evicted,
            yielded: None,
            held_bytes: 0,
            is_leaving: false,
        };
        self.classes[base as usize].insert(peer, entry.rank(), id);
        self.entries.insert(id, entry);
        id
    }

    pub(super) fn heard(&mut self, id: Id, now: Instant) {
        self.change(id, |entry| (entry.base, entry.since) = (Class::Idle, now));
    }

    pub(super) fn begun(&mut self, id: Id) {
        self.change(id, |_| {});
    }

    /// Treats the connection as incoming between requests, until its next request is answered.
    pub(super) fn demote(&mut self, id: Id) {
        self.change(id, |entry| entry.is_demoted = true);
    }

    /// Marks that a request has begun to arrive. A first request keeps the age of its connection: a newer connection
    /// that has not sent anything yet may carry a FAST STOP.
    pub(super) fn receiving(&mut self, id: Id, now: Instant) {
        self.change(id, |entry| {
            if entry.base != Class::Incoming {
                (entry.base, entry.since) = (Class::Incoming, now);
            }
        });
    }

    /// Adds a claim. Returns `None` if the class stays full.
    pub(super) fn claim(&mut self, id: Id, class: Class, now: Instant, yielded: &CancellationToken) -> Option<()> {
        // An evicted connection can finish its request, but can't start a wait or a stream.
        let lasts = matches!(class, Class::Waiting | Class::Streaming);
        let Some(Entry { peer, is_leaving: false, claims, .. }) = self.entries.get(&id) else {
            return (!lasts).then_some(());
        };
        let peer = *peer;
        // A request that is passed on within the gateway already has its slot.
        if claims[class as usize] == 0 && !self.make_room(class, peer) {
            return None;
        }
        self.change(id, |entry| {
            entry.claims[class as usize] += 1;
            entry.since = now;
            if class == Class::Answering {
                entry.is_demoted = false;
            }
            if class == Class::Waiting {
                entry.yielded = Some(yielded.clone());
            }
        });
        Some(())
    }

    pub(super) fn release(&mut self, id: Id, class: Class, now: Instant) {
        self.change(id, |entry| {
            let claims = &mut entry.claims[class as usize];
            *claims = claims.saturating_sub(1);
            entry.since = now;
            if class != Class::Pinned {
                entry.base = Class::Idle;
            }
        });
    }

    pub(super) fn remove(&mut self, id: Id) {
        if let Some(entry) = self.entries.remove(&id) {
            if entry.is_leaving {
                self.leaving -= 1;
            } else {
                self.held_bytes -= entry.held_bytes;
                self.classes[entry.class() as usize].remove(entry.peer, entry.rank(), id);
            }
        }
    }

    /// Whether the connection has a claim.
    pub(super) fn has_claim(&self, id: Id) -> bool {
        self.entries.get(&id).is_some_and(|entry| entry.claims.iter().any(|claims| *claims > 0))
    }

    /// Returns the number of connections of a class and its bound.
    pub(super) fn usage(&self, class: Class) -> (usize, usize) {
        (self.classes[class as usize].count, self.bounds.of_class(class))
    }

    pub(super) fn held_bytes(&self) -> usize {
        self.held_bytes
    }

    pub(super) fn evicted(&self) -> u64 {
        self.evicted
    }

    /// Whether one more connection would evict one that has had no time to send its first bytes.
    pub(super) fn is_full_of_silent(&self, now: Instant) -> bool {
        let is_full = self.classes[Class::Incoming as usize].count >= self.bounds.of_class(Class::Incoming);
        let next = is_full.then(|| self.greediest(Class::Incoming)).flatten().and_then(|id| self.entries.get(&id));
        next.is_some_and(|entry| entry.is_silent && entry.rank() > now)
    }

    /// Number of evicted connections that are still ending.
    pub(super) fn leaving(&self) -> usize {
        self.leaving
    }

    /// Whether so many evicted connections are still ending that no new one is admitted.
    pub(super) fn is_crowded(&self) -> bool {
        self.leaving >= self.bounds.leaving
    }

    /// Whether so many evicted connections are still ending that none gets time to linger. `besides` of them are not
    /// counted.
    pub(super) fn is_half_crowded(&self, besides: usize) -> bool {
        self.leaving.saturating_sub(besides) * 2 > self.bounds.leaving
    }

    pub(super) fn evict_unclaimed(&mut self) {
        if let Some(id) = [Class::Incoming, Class::Idle].into_iter().find_map(|class| self.greediest(class)) {
            self.evict(id);
        }
    }

    /// Updates a connection's byte count. Beyond the bound, evicts the connection with the most bytes.
    pub(super) fn hold(&mut self, id: Id, before: usize, after: usize) {
        let Some(entry) = self.entries.get_mut(&id).filter(|entry| !entry.is_leaving) else { return };
        entry.held_bytes = entry.held_bytes + after - before;
        self.held_bytes = self.held_bytes + after - before;
        if after > before && self.held_bytes > self.bounds.held_bytes {
            let staying = self.entries.iter().filter(|(_, entry)| !entry.is_spared());
            if let Some((&id, _)) = staying.max_by_key(|(_, entry)| entry.held_bytes) {
                self.evict(id);
            }
        }
    }

    /// Makes room for one more connection of this peer in a class. Returns whether there is room.
    fn make_room(&mut self, class: Class, newcomer: Peer) -> bool {
        let members = &self.classes[class as usize];
        let most = self.bounds.of_class(class);
        if class == Class::Pinned {
            return members.count < self.bounds.pinned();
        }
        if class.when_full() == WhenFull::Refuse && members.of_peer(newcomer) >= (most - most / 4).max(1) {
            return false;
        }
        if members.count < most {
            return true;
        }
        let Some(id) = self.greediest(class) else { return true };
        let gives_way = match class.when_full() {
            WhenFull::Evict => true,
            WhenFull::Share => {
                let entry = self.entries.get(&id);
                entry.is_some_and(|entry| members.of_peer(entry.peer) > members.of_peer(newcomer) + 1)
            }
            WhenFull::Refuse => false,
        };
        if gives_way {
            self.give_way(id, class);
        }
        gives_way
    }

    /// Returns the oldest connection of the peer with the most connections in this class.
    fn greediest(&self, class: Class) -> Option<Id> {
        let peers = self.classes[class as usize].peers.values();
        let oldest = peers.filter_map(|ids| Some((ids.len(), std::cmp::Reverse(*ids.first()?))));
        oldest.max().map(|(_, std::cmp::Reverse((_, id)))| id)
    }

    fn give_way(&mut self, id: Id, class: Class) {
        if class != Class::Waiting {
            return self.evict(id);
        }
        // A long poll is answered early, and its connection stays open.
        self.change(id, |entry| {
            entry.claims[class as usize] = 0;
            if let Some(yielded) = entry.yielded.take() {
                yielded.cancel();
            }
        });
    }

    fn evict(&mut self, id: Id) {
        if let Some(entry) = self.entries.get_mut(&id).filter(|entry| !entry.is_leaving) {
            self.classes[entry.class() as usize].remove(entry.peer, entry.rank(), id);
            entry.is_leaving = true;
            // These bytes are freed within milliseconds. Counting them on would evict connections that hold little.
            self.held_bytes -= entry.held_bytes;
            entry.evicted.cancel();
            self.leaving += 1;
            self.evicted += 1;
        }
    }

    /// Marks an entry as no longer silent, changes it, and moves it to its new class. A connection that enters a full
    /// class of [`WhenFull::Evict`] evicts another one.
    fn change(&mut self, id: Id, change: impl FnOnce(&mut Entry)) {
        let Some(entry) = self.entries.get_mut(&id) else { return };
        let class = entry.class();
        let rank = entry.rank();
        entry.is_silent = false;
        change(entry);
        if entry.is_leaving {
            return;
        }
        let peer = entry.peer;
        let after = entry.class();
        let new_rank = entry.rank();
        self.classes[class as usize].remove(peer, rank, id);
        if after != class && after.when_full() == WhenFull::Evict {
            self.make_room(after, peer);
        }
        self.classes[after as usize].insert(peer, new_rank, id);
    }
}

impl Members {
    /// Number of connections of a peer.
    fn of_peer(&self, peer: Peer) -> usize {
        self.peers.get(&peer).map_or(0, BTreeSet::len)
    }

    fn insert(&mut self, peer: Peer, rank: Instant, id: Id) {
        self.count += usize::from(self.peers.entry(peer).or_default().insert((rank, id)));
    }

    fn remove(&mut self, peer: Peer, rank: Instant, id: Id) {
        if let Some(ids) = self.peers.get_mut(&peer) {
            self.count -= usize::from(ids.remove(&(rank, id)));
            if ids.is_empty() {
                self.peers.remove(&peer);
            }
        }
    }
}

/// Returns the peer of an address. Limits of one address apply to all addresses of a peer.
pub fn peer(address: IpAddr) -> Peer {
    match address.to_canonical() {
        IpAddr::V6(address) => Ipv6Addr::from_bits(address.to_bits() >> 64 << 64).into(),
        address @ IpAddr::V4(_) => address,
    }
}
