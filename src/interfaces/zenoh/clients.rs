//! Leases that end with their client, bound to its Zenoh session or to its liveliness token.
//!
//! - `lease.take?zid=ID` binds a lease to the session with that Zenoh id, if the session is connected to the gateway
//!   directly. Zenoh reports the end of that connection, and no other client can delay or cause the report.
//! - Otherwise the token `wsg/v1/{gateway}/client/{holder}` binds the lease. Zenoh does not reveal which session
//!   declared a token, and reports its end only after the last session with that key is gone. Use Zenoh's access control
//!   to restrict who may declare it.
//!
//! Once a second, the rights of each holder are checked. A holder that may no longer move the gripper loses the lease.
//!
//! A bound lease taken without a `ttl_ms` does not expire without use. The reply to `lease.take` says what the lease is
//! bound to.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use zenoh::sample::{Sample, SampleKind};
use zenoh::session::{TransportEvent, ZenohId};

use super::client::identity;
use crate::access::{Access, Credential, Right};
use crate::connections::metrics::{Connected, InterfaceMetrics};
use crate::fleet::keys::{ZenohKeys, last_part};
use crate::model::{LossCause, Name};
use crate::operations::ConnectionLease;

/// Maximum number of concurrent queries of each kind: waiting, not waiting, stopping, and keeping or ending a lease.
/// More are refused as `overloaded`; FAST STOPs have their own limit.
pub(super) const MAX_QUERIES: usize = 64;

/// Maximum number of known client tokens. Any session on the network can declare any number of tokens and fill this
/// list. The token of a client that takes a lease is then looked up in Zenoh.
const MAX_TOKENS: usize = 1024;

/// Maximum length of a token's name, in bytes: that of a lease holder.
const MAX_NAME_BYTES: usize = 32;

/// Time limit for looking up a token in Zenoh.
const LOOKED_UP_WITHIN: Duration = Duration::from_millis(500);

/// Interval in which the rights of lease holders are checked.
const RIGHTS_CHECKED_EVERY: Duration = Duration::from_secs(1);

/// The Zenoh clients of one gateway and their leases.
#[derive(Debug)]
pub struct Clients {
    keys: ZenohKeys,
    runtime: Handle,
    metrics: InterfaceMetrics,
    access: Arc<Access>,
    session: OnceLock<zenoh::Session>,
    known: Mutex<KnownClients>,
}

#[derive(Debug, Default)]
struct KnownClients {
    tokens: HashMap<String, Connected>,
    /// Sessions that are directly connected to the gateway. Zenoh's `transport/unicast/max_sessions` bounds their
    /// number.
    sessions: HashSet<ZenohId>,
    /// The newest lease of each gripper that was taken via Zenoh.
    leases: HashMap<Name, BoundLease>,
}

#[derive(Debug)]
struct BoundLease {
    bond: Option<Bond>,
    taken: Arc<ConnectionLease>,
    /// Credential with which the lease was taken.
    credential: Credential,
    slots: QuerySlots,
}

/// Separate slots for one lease holder's queries: those that wait for a command's end, those that only stop, and
/// others.
#[derive(Debug, Clone, Default)]
pub struct QuerySlots {
    pub waiting: Option<Arc<Semaphore>>,
    pub stops: Option<Arc<Semaphore>>,
    pub others: Option<Arc<Semaphore>>,
}

/// The session or token that a lease is bound to. The lease is lost when it ends.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Bond {
    /// The client's connection to the gateway.
    Session(ZenohId),
    /// The liveliness token of the holder's name.
    Token(String),
}

impl Bond {
    /// Returns the name used in the reply to `lease.take`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Session(_) => "session",
            Self::Token(_) => "token",
        }
    }
}

impl KnownClients {
    fn has(&self, bond: &Bond) -> bool {
        match bond {
            Bond::Session(zid) => self.sessions.contains(zid),
            Bond::Token(name) => self.tokens.contains_key(name),
        }
    }

    fn lease(&self, gripper: &str, token: &str) -> Option<&BoundLease> {
        let bound = self.leases.get(&gripper.parse::<Name>().ok()?)?;
        bound.taken.is(token).then_some(bound)
    }

    /// Makes room for the token of a client that takes a lease, by dropping a token without a lease.
    fn make_room(&mut self) {
        if self.tokens.len() < MAX_TOKENS {
            return;
        }
        let foreign = self.tokens.keys().find(|name| !self.binds_lease(name)).cloned();
        if let Some(name) = foreign {
            self.tokens.remove(&name);
        }
    }

    /// Whether a lease is bound to the token of this name.
    fn binds_lease(&self, name: &str) -> bool {
        self.leases.values().any(|bound| matches!(&bound.bond, Some(Bond::Token(token)) if token == name))
    }
}

impl Clients {
    pub fn new(keys: ZenohKeys, runtime: Handle, metrics: InterfaceMetrics, access: Arc<Access>) -> Self {
        Self { keys, runtime, metrics, access, session: OnceLock::new(), known: Mutex::default() }
    }

    /// Watches client tokens and connections, including existing ones.
    pub async fn declare(self: &Arc<Self>, session: &zenoh::Session) -> zenoh::Result<()> {
        let clients = self.clone();
        let info = session.info();
        let events = info.transport_events_listener().history(true);
        let events = events.callback(move |event: TransportEvent| {
            clients.connection(*event.transport().zid(), event.kind());
        });
        events.background().await?;
        let clients = self.clone();
        let tokens = session.liveliness().declare_subscriber(self.keys.own("client/*")).history(true);
        let tokens = tokens.callback(move |token: Sample| {
            clients.token(last_part(token.key_expr().as_str()), token.kind());
        });
        tokens.background().await?;
        // Each gateway has one session, so this is the first call.
        let _ = self.session.set(session.clone());
        Ok(())
    }

    /// Returns what a lease of this holder can be bound to: its session if that is connected here, else its token.
    pub async fn bond(&self, holder: Option<String>, zid: Option<ZenohId>) -> Option<Bond> {
        let session = zid.map(Bond::Session);
        let token = holder.clone().map(Bond::Token);
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
        // The token can have ended in between, while it was not in the list.
        if self.is_declared(&holder).await {
            return token;
        }
        self.known().tokens.remove(&holder);
        None
    }

    /// Whether this token belongs to a bound lease. Open queries keep a bound lease alive until its bond ends.
    pub fn has_bound(&self, gripper: &str, token: &str) -> bool {
        let known = self.known();
        let bond = known.lease(gripper, token).and_then(|bound| bound.bond.as_ref());
        bond.is_some_and(|bond| known.has(bond))
    }

    /// Returns the slots of the lease with this token, if it is the gripper's newest lease taken via Zenoh.
    pub fn slots_of(&self, gripper: &str, token: &str) -> Option<QuerySlots> {
        self.known().lease(gripper, token).map(|bound| bound.slots.clone())
    }

    /// Tracks a lease that was just taken. Without a bond, the lease expires without use. If its bond has ended since
    /// the request, the lease is lost.
    pub fn bind(&self, bond: Option<Bond>, taken: Arc<ConnectionLease>, credential: Credential) {
        let mut known = self.known();
        if bond.as_ref().is_some_and(|bond| !known.has(bond)) {
            drop(known);
            self.lose(taken, LossCause::Disconnected);
            return;
        }
        let taken = if bond.is_some() { taken } else { Arc::new(taken.without_keep()) };
        let [waiting, stops, others] = [MAX_QUERIES; 3].map(|slots| Some(Arc::new(Semaphore::new(slots))));
        let slots = QuerySlots { waiting, stops, others };
        known.leases.insert(taken.gripper().clone(), BoundLease { bond, taken, credential, slots });
    }

    /// Ends the leases of holders that may no longer move the gripper. Never returns.
    pub async fn check_rights(self: Arc<Self>) {
        loop {
            tokio::time::sleep(RIGHTS_CHECKED_EVERY).await;
            self.lose_forbidden_leases();
        }
    }

    fn lose_forbidden_leases(&self) {
        let holders: Vec<_> =
            self.known().leases.values().map(|bound| (bound.taken.clone(), bound.credential.clone())).collect();
        for (taken, credential) in holders {
            let identity = identity(&self.access, &credential);
            if identity.is_ok_and(|identity| identity.may(Right::Operate, Some(taken.gripper()))) {
                continue;
            }
            // The gripper can have a newer lease by now.
            self.known().leases.retain(|_, bound| !Arc::ptr_eq(&bound.taken, &taken));
            self.lose(taken, LossCause::Forbidden);
        }
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

    /// Whether the token of this client is declared now, according to Zenoh.
    async fn is_declared(&self, name: &str) -> bool {
        let Some(session) = self.session.get() else { return false };
        let key = self.keys.own(&format!("client/{name}"));
        let Ok(found) = session.liveliness().get(key).timeout(LOOKED_UP_WITHIN).await else { return false };
        found.recv_async().await.is_ok_and(|reply| reply.result().is_ok())
    }

    fn end(&self, mut known: std::sync::MutexGuard<'_, KnownClients>, bond: &Bond) {
        for (_, bound) in known.leases.extract_if(|_, bound| bound.bond.as_ref() == Some(bond)) {
            self.lose(bound.taken, LossCause::Disconnected);
        }
    }

    fn lose(&self, taken: Arc<ConnectionLease>, cause: LossCause) {
        self.runtime.spawn(async move { taken.lose(cause).await });
    }

    fn known(&self) -> std::sync::MutexGuard<'_, KnownClients> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
