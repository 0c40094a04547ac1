//! Clients that say that they live, and the leases that are bound to that.
//!
//! A client declares the liveliness token `wsg/v1/{gateway}/client/{name}`. A lease that is taken through Zenoh with
//! that name as its `holder` is lost when the token goes: when the client ends, is killed, or its connection does. Where
//! the token was there before the lease was taken, and no `ttl_ms` was asked for, the lease needs no use meanwhile.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::runtime::Handle;
use zenoh::sample::{Sample, SampleKind};

use crate::frontend::http::Taken;
use crate::frontend::metrics::{Connected, Metrics};
use crate::frontend::network::keys::{Keys, last_part};
use crate::gripper::model::Name;

/// Clients that may say so at a time. A lease of one more is like that of one that doesn't.
const MAX_CLIENTS: usize = 1024;

/// Those of one gateway.
#[derive(Debug)]
pub struct Clients {
    runtime: Handle,
    metrics: Metrics,
    known: Mutex<Known>,
}

#[derive(Debug, Default)]
struct Known {
    alive: HashMap<String, Connected>,
    /// The newest lease of each gripper that was taken through Zenoh.
    leases: HashMap<Name, Bound>,
}

#[derive(Debug)]
struct Bound {
    holder: String,
    taken: Arc<Taken>,
}

impl Clients {
    /// None yet.
    pub fn new(runtime: Handle, metrics: Metrics) -> Self {
        Self { runtime, metrics, known: Mutex::default() }
    }

    /// Watches their tokens, those that are there already among them.
    pub async fn declare(self: &Arc<Self>, session: &zenoh::Session, keys: &Keys) -> zenoh::Result<()> {
        let clients = self.clone();
        let watch = move |token: Sample| {
            let name = last_part(token.key_expr().as_str());
            match token.kind() {
                SampleKind::Put => clients.came(name),
                SampleKind::Delete => clients.went(name),
            }
        };
        let liveliness = session.liveliness();
        liveliness.declare_subscriber(keys.own("client/*")).history(true).callback(watch).background().await
    }

    /// Whether the client of this name is known to live.
    pub fn is_alive(&self, name: &str) -> bool {
        self.known().alive.contains_key(name)
    }

    /// Whether this token is that of a lease whose end comes with its holder's: its open queries keep it until then.
    pub fn has_bound(&self, gripper: &str, token: &str) -> bool {
        let known = self.known();
        let bound = gripper.parse().ok().and_then(|gripper: Name| known.leases.get(&gripper));
        bound.is_some_and(|bound| bound.taken.is(token) && known.alive.contains_key(&bound.holder))
    }

    /// Takes a lease that was taken by this holder, who was known to live when he asked.
    pub fn bind(&self, holder: &str, taken: Arc<Taken>, was_alive: bool) {
        let mut known = self.known();
        let taken = match (known.alive.contains_key(holder), was_alive) {
            (true, _) => taken,
            (false, false) => Arc::new(taken.without_keep()),
            (false, true) => {
                drop(known);
                self.lose(taken);
                return;
            }
        };
        known.leases.insert(taken.gripper().clone(), Bound { holder: holder.to_owned(), taken });
    }

    fn came(&self, name: &str) {
        let mut known = self.known();
        let is_full = known.alive.len() >= MAX_CLIENTS;
        match known.alive.entry(name.to_owned()) {
            Entry::Occupied(_) => {}
            Entry::Vacant(_) if is_full => tracing::warn!(client = name, MAX_CLIENTS, "too many Zenoh clients"),
            Entry::Vacant(entry) => {
                entry.insert(self.metrics.connected());
            }
        }
    }

    fn went(&self, name: &str) {
        let mut known = self.known();
        known.alive.remove(name);
        for (_, bound) in known.leases.extract_if(|_, bound| bound.holder == name) {
            self.lose(bound.taken);
        }
    }

    fn lose(&self, taken: Arc<Taken>) {
        self.runtime.spawn(async move { taken.lose().await });
    }

    fn known(&self) -> std::sync::MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
