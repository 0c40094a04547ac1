//! Other gateways with this one's name. Each of them would carry out a request to that name.
//!
//! Any session can declare an `instance` token, so a token alone proves nothing: a twin is a session that answers at
//! its own instance key, as a gateway does.

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::sync::{Notify, Semaphore};
use tokio::time::{Instant, timeout};
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Reply};
use zenoh::sample::Locality;
use zenoh::{Session, Wait as _};

use super::keys::{ZenohKeys, last_part};

/// Interval between searches for twins. A new token starts a search of its own.
const LOOKS_EVERY: Duration = Duration::from_secs(2);

/// Shortest interval between searches, however many tokens come and go.
const LOOKS_AT_MOST_EVERY: Duration = Duration::from_millis(250);

/// Time for twins to answer.
const ANSWERS_WITHIN: Duration = Duration::from_secs(1);

/// Maximum number of twins that are distinguished. Even one is too many.
const MAX_TWINS: usize = 16;

/// Shortest interval between log lines about tokens without a gateway.
const SAID_EVERY: Duration = Duration::from_mins(1);

/// The twins of one gateway.
#[derive(Debug, Default)]
pub(super) struct Twins {
    found: Mutex<BTreeSet<String>>,
    claims: Notify,
}

impl Twins {
    /// Whether this gateway has a twin.
    pub(super) fn any(&self) -> bool {
        !self.found.lock().unwrap_or_else(PoisonError::into_inner).is_empty()
    }

    /// Starts a search soon, after a session has declared or withdrawn an `instance` token with this name.
    pub(super) fn look(&self) {
        self.claims.notify_one();
    }

    /// Answers at this gateway's own instance key.
    pub(super) async fn answer(session: &Session, keys: &ZenohKeys) -> zenoh::Result<()> {
        let key = keys.own(&format!("instance/{}", session.zid()));
        let answered = key.clone();
        let runtime = Handle::current();
        let places = Arc::new(Semaphore::new(MAX_TWINS));
        let instance = session.declare_queryable(key).callback(move |query: Query| {
            let Ok(place) = places.clone().try_acquire_owned() else { return };
            let key = answered.clone();
            // A reply can wait for a client that takes none, so it gets a thread on which nothing else waits.
            runtime.spawn_blocking(move || {
                if let Err(error) = query.reply(key, "").wait() {
                    tracing::debug!(%error, "instance query not answered");
                }
                drop((query, place));
            });
        });
        instance.background().await
    }

    /// Looks for twins for as long as it is polled.
    pub(super) async fn watch(self: Arc<Self>, session: Session, keys: ZenohKeys) {
        let mut said_at: Option<Instant> = None;
        loop {
            let is_claimed = timeout(LOOKS_EVERY, self.claims.notified()).await.is_ok();
            let was_alone = !self.any();
            let found = self.round(&session, &keys).await;
            let is_alone = found.is_empty();
            *self.found.lock().unwrap_or_else(PoisonError::into_inner) = found;
            match (was_alone, is_alone) {
                (true, false) => tracing::error!(
                    "another gateway on this Zenoh network has the same name, so motions over Zenoh are refused: give \
                     each gateway its own --name"
                ),
                (false, true) => tracing::info!("no other gateway has this gateway's name any more"),
                (true, true) if is_claimed && said_at.is_none_or(|at| at.elapsed() >= SAID_EVERY) => {
                    said_at = Some(Instant::now());
                    tracing::warn!(
                        "a session that is not a gateway declares or withdraws this gateway's instance token: restrict \
                         the token to gateways by access control (deploy/guide/zenoh.md)"
                    );
                }
                _ => {}
            }
            tokio::time::sleep(LOOKS_AT_MOST_EVERY).await;
        }
    }

    /// Returns the twins that answer, and those that answered before and still have their token. A frozen one could
    /// resume.
    async fn round(&self, session: &Session, keys: &ZenohKeys) -> BTreeSet<String> {
        let mut candidates = answering(session, keys).await;
        candidates.extend(self.found.lock().unwrap_or_else(PoisonError::into_inner).iter().cloned());
        let mut found = BTreeSet::new();
        for id in candidates {
            if found.len() < MAX_TWINS && has_token(session, keys, &id).await {
                found.insert(id);
            }
        }
        found
    }
}

/// The ids of the other gateways that answer as this name's instances.
async fn answering(session: &Session, keys: &ZenohKeys) -> BTreeSet<String> {
    let own = session.zid().to_string();
    let get = session.get(keys.own("instance/*")).target(QueryTarget::All).consolidation(ConsolidationMode::None);
    let Ok(replies) = get.allowed_destination(Locality::Remote).timeout(ANSWERS_WITHIN).await else {
        return BTreeSet::new();
    };
    let mut found = BTreeSet::new();
    // The query's time-out ends the loop, whatever arrives until then.
    while found.len() < MAX_TWINS
        && let Ok(reply) = replies.recv_async().await
    {
        found.extend(instance(&reply).filter(|id| *id != own));
    }
    found
}

/// The id of the instance that a reply comes from; `None` if another session answers at its key.
fn instance(reply: &Reply) -> Option<String> {
    let id = last_part(reply.result().ok()?.key_expr().as_str()).to_owned();
    (reply.replier_id()?.zid().to_string() == id).then_some(id)
}

/// Whether the session with this id declares itself to be the gateway with these keys.
pub(super) async fn has_token(session: &Session, keys: &ZenohKeys, id: &str) -> bool {
    let key = keys.own(&format!("instance/{id}"));
    let Ok(tokens) = session.liveliness().get(key).timeout(ANSWERS_WITHIN).await else { return false };
    tokens.recv_async().await.is_ok_and(|reply| reply.result().is_ok())
}
