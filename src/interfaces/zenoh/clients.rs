//! Leases that end with their client: bound to its Zenoh session, or to its liveliness token.
//!
//! - `lease.take?zid=ID` binds a lease to the session of that Zenoh id, where this session is connected to the gateway
//!   itself. Zenoh reports the end of such a connection, and no other client can delay or cause that report.
//! - Otherwise the token `wsg/v1/{gateway}/client/{holder}` binds the lease. Zenoh does not tell which session has declared
//!   a token, and reports its end only after the last session of that key is gone. Access control has to say who may declare it.
//!
//! A bound lease that was taken without a `ttl_ms` needs no use. The answer to `lease.take` says what the lease is bound to.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::{TransportEvent, ZenohId};

use crate::fleet::keys::{Keys, last_part};
use crate::gripper::model::Name;
use crate::interfaces::metrics::{Connected, Metrics};
use crate::operations::ConnectionLease;

/// Queries that may be under way, of those that may take their time, of those that don't, of those that only stop, and of
/// those that keep or end a lease. More are refused as `overloaded`, but for FAST STOPs.
pub(super) const MAX_QUERIES: usize = 64;

/// Client tokens that are kept. Any session on the network may declare any number of tokens, so this list may be full of
/// foreign ones: the token of a client that takes a lease is looked up in Zenoh then.
const MAX_TOKENS: usize = 1024;

/// The longest name of a token that is kept, in bytes: a lease's holder has no more.
const MAX_NAME_BYTES: usize = 32;

/// How long Zenoh may take to look up a token.
const LOOKED_UP_WITHIN: Duration = Duration::from_millis(500);

/// The clients of one gateway.
#[derive(Debug)]
pub struct Clients {
    keys: Keys,
    runtime: Handle,
    metrics: Metrics,
    session: OnceLock<zenoh::Session>,
    known: Mutex<Known>,
}

#[derive(Debug, Default)]
struct Known {
    tokens: HashMap<String, Connected>,
    /// The sessions that are connected to the gateway itself. Zenoh bounds their number: `transport/unicast/max_sessions`.
    sessions: HashSet<ZenohId>,
    /// The newest lease of each gripper that was taken through Zenoh.
    leases: HashMap<Name, Bound>,
}

#[derive(Debug)]
struct Bound {
    bond: Option<Bond>,
    taken: Arc<ConnectionLease>,
    places: Places,
}

/// Places of one lease's queries, apart from everybody else's: of those that wait for a command's end, of those that only
/// stop, and of all others.
#[derive(Debug, Clone, Default)]
pub struct Places {
    pub waiting: Option<Arc<Semaphore>>,
    pub stops: Option<Arc<Semaphore>>,
    pub others: Option<Arc<Semaphore>>,
}

/// What ends a lease with its end.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Bond {
    /// The client's connection to the gateway.
    Session(ZenohId),
    /// The liveliness token of the holder's name.
    Token(String),
}

impl Bond {
    /// The word for it in the answer to `lease.take`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Session(_) => "session",
            Self::Token(_) => "token",
        }
    }
}

impl Known {
    fn has(&self, bond: &Bond) -> bool {
        match bond {
            Bond::Session(zid) => self.sessions.contains(zid),
            Bond::Token(name) => self.tokens.contains_key(name),
        }
    }

    fn lease(&self, gripper: &str, token: &str) -> Option<&Bound> {
        let bound = self.leases.get(&gripper.parse::<Name>().ok()?)?;
        bound.taken.is(token).then_some(bound)
    }

    /// Makes room for the token of a client that takes a lease, in place of one that holds none.
    fn make_room(&mut self) {
        if self.tokens.len() >= MAX_TOKENS {
            let holds = |name: &String| self.leases.values().any(|bound| bound.bond == Some(Bond::Token(name.clone())));
            let foreign = self.tokens.keys().find(|name| !holds(name)).cloned();
            foreign.map(|name| self.tokens.remove(&name));
        }
    }
}

impl Clients {
    /// No clients yet, of the gateway with these keys.
    pub fn new(keys: Keys, runtime: Handle, metrics: Metrics) -> Self {
        Self { keys, runtime, metrics, session: OnceLock::new(), known: Mutex::default() }
    }

    /// Watches client tokens and connections, present ones included.
    pub async fn declare(self: &Arc<Self>, session: &zenoh::Session) -> zenoh::Result<()> {
        let clients = self.clone();
        let watch = move |event: TransportEvent| clients.connection(*event.transport().zid(), event.kind());
        session.info().transport_events_listener().history(true).callback(watch).background().await?;
        let clients = self.clone();
        let watch = move |token: Sample| clients.token(last_part(token.key_expr().as_str()), token.kind());
        let tokens = session.liveliness().declare_subscriber(self.keys.own("client/*")).history(true);
        tokens.callback(watch).background().await?;
        // A second session would be that of a second gateway.
        let _ = self.session.set(session.clone());
        Ok(())
    }

    /// What a lease of this holder can be bound to: its session, if that is connected here, or else its token.
    pub async fn bond(&self, holder: Option<String>, zid: Option<ZenohId>) -> Option<Bond> {
        let (session, token) = (zid.map(Bond::Session), holder.clone().map(Bond::Token));
        let is_full = {
            let known = self.known();
            if let Some(bond) = session.into_iter().chain(token.clone()).find(|bond| known.has(bond)) {
                return Some(bond);
            }
            known.tokens.len() >= MAX_TOKENS
        };
        let holder = holder?;
        if !is_full || !self.is_declared(&holder).await {
            return None;
        }
        {
            let mut known = self.known();
            known.make_room();
            known.tokens.insert(holder.clone(), self.metrics.connected());
        }
        // The token's end may have come in between, when it was not known here.
        if self.is_declared(&holder).await {
            return token;
        }
        self.known().tokens.remove(&holder);
        None
    }

    /// Whether this token is that of a lease whose end comes with its holder's: its open queries keep it until then.
    pub fn has_bound(&self, gripper: &str, token: &str) -> bool {
        let known = self.known();
        let is_bound = |bound: &Bound| bound.bond.as_ref().is_some_and(|bond| known.has(bond));
        known.lease(gripper, token).is_some_and(is_bound)
    }

    /// The places of the lease with this token, if it is the newest one of a gripper that was taken through Zenoh.
    pub fn places_of(&self, gripper: &str, token: &str) -> Option<Places> {
        self.known().lease(gripper, token).map(|bound| bound.places.clone())
    }

    /// Keeps track of a lease that was just taken. Without a bond it runs out without use; one whose bond has ended
    /// since the client asked is lost.
    pub fn bind(&self, bond: Option<Bond>, taken: Arc<ConnectionLease>) {
        let mut known = self.known();
        if bond.as_ref().is_some_and(|bond| !known.has(bond)) {
            drop(known);
            self.lose(taken);
            return;
        }
        let taken = if bond.is_some() { taken } else { Arc::new(taken.without_keep()) };
        let [waiting, stops, others] = [MAX_QUERIES; 3].map(|places| Some(Arc::new(Semaphore::new(places))));
        let places = Places { waiting, stops, others };
        known.leases.insert(taken.gripper().clone(), Bound { bond, taken, places });
    }

    fn connection(&self, zid: ZenohId, kind: SampleKind) {
        match kind {
            SampleKind::Put => drop(self.known().sessions.insert(zid)),
            SampleKind::Delete => {
                let mut known = self.known();
                known.sessions.remove(&zid);
                self.end(known, &Bond::Session(zid));
            }
        }
    }

    fn token(&self, name: &str, kind: SampleKind) {
        let mut known = self.known();
        match kind {
            SampleKind::Put => {
                let has_room = known.tokens.len() < MAX_TOKENS && name.len() <= MAX_NAME_BYTES;
                match known.tokens.entry(name.to_owned()) {
                    Entry::Vacant(entry) if has_room => drop(entry.insert(self.metrics.connected())),
                    Entry::Vacant(_) => tracing::debug!(client = name, MAX_TOKENS, "client token not kept"),
                    Entry::Occupied(_) => {}
                }
            }
            SampleKind::Delete => {
                known.tokens.remove(name);
                self.end(known, &Bond::Token(name.to_owned()));
            }
        }
    }

    /// Whether Zenoh knows the token of this client now.
    async fn is_declared(&self, name: &str) -> bool {
        let Some(session) = self.session.get() else { return false };
        let key = self.keys.own(&format!("client/{name}"));
        let Ok(found) = session.liveliness().get(key).timeout(LOOKED_UP_WITHIN).await else { return false };
        found.recv_async().await.is_ok_and(|reply| reply.result().is_ok())
    }

    fn end(&self, mut known: std::sync::MutexGuard<'_, Known>, bond: &Bond) {
        for (_, bound) in known.leases.extract_if(|_, bound| bound.bond.as_ref() == Some(bond)) {
            self.lose(bound.taken);
        }
    }

    fn lose(&self, taken: Arc<ConnectionLease>) {
        self.runtime.spawn(async move { taken.lose().await });
    }

    fn known(&self) -> std::sync::MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
