//! Journals that do not continue that of the last run: restored copies, new files, and files from which records were
//! deleted. The gateway begins a new life with them: lease epochs and numbers of motions continue above all that can have
//! been used, and unknown request ids are refused for a while.

use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::{SignedDuration, Timestamp};
use rusqlite::Connection;
use serde::{Deserialize, Serialize};
use uuid::Uuid;

use super::head::discontinuity;
use super::identity::{self, JournalIdentity};
use super::recovery::REPLAYED_FOR;
use super::row::now;
use super::source::JournalLocation;
use super::store::Store;
use crate::gripper::recorder::UnknownPast;
use crate::model::{Detail, Event, GatewayEvent};

/// Longest time since a restoration that is believed.
const BELIEVED_AGE: SignedDuration = SignedDuration::from_hours(6);

/// Key of the [`Restoration`], until it is confirmed.
const KEY: &str = "restored";

#[derive(Debug, Serialize, Deserialize)]
struct Restoration {
    at: Timestamp,
    cause: String,
}

/// A journal as it is opened.
pub(super) struct Opened {
    pub(super) id: Uuid,
    /// The time without records, unless a person has confirmed it.
    pub(super) unknown_past: Option<Arc<UnknownPast>>,
    /// Event of a restoration that was found now.
    pub(super) event: Option<Event>,
}

/// Finds out whether a journal continues that of the last run.
pub(super) fn look(store: &Store) -> Opened {
    let JournalIdentity { id, is_known } = identity::identify(&store.connection);
    let JournalLocation::File(path) = &store.source.place else {
        return Opened { id, unknown_past: None, event: None };
    };
    let Some(cause) = discontinuity(path, store, id, is_known) else {
        let unknown_past = unconfirmed(&store.connection).map(past);
        return Opened { id, unknown_past, event: None };
    };
    let cause = format!("the journal does not continue that of the last run: {cause}");
    tracing::error!(cause, "journal restored, or records deleted: unknown request ids are refused for 10 minutes");
    let id = if is_known { renamed(&store.connection) } else { id };
    let restoration = Restoration { at: now(), cause: cause.clone() };
    let stored = serde_json::to_string(&restoration).map(|value| identity::store(&store.connection, KEY, &value));
    if !matches!(stored, Ok(Ok(()))) {
        tracing::warn!("restoration of the journal not stored: it is forgotten at the next start");
    }
    let event = Event::new(restoration.at, None, Detail::Gateway(GatewayEvent::Restored { cause }));
    Opened { id, unknown_past: Some(past(restoration)), event: Some(event) }
}

/// Gives a journal a new id, since its sequence numbers stand for other records than before.
fn renamed(connection: &Connection) -> Uuid {
    let id = Uuid::now_v7();
    if let Err(error) = identity::store_id(connection, id) {
        tracing::warn!(%error, "new journal id not stored: the next start creates another one");
    }
    id
}

fn unconfirmed(connection: &Connection) -> Option<Restoration> {
    serde_json::from_str(&identity::value(connection, KEY).ok()??).ok()
}

/// Request ids are valid for some minutes, so those of the time without records expire that long after the first start.
fn past(restoration: Restoration) -> Arc<UnknownPast> {
    let age = now().duration_since(restoration.at).max(SignedDuration::ZERO);
    // A machine without a clock of its own can have started in 1970, and got the time since.
    let age = if age > BELIEVED_AGE { SignedDuration::ZERO } else { age };
    let left = Duration::try_from(REPLAYED_FOR.saturating_sub(age)).unwrap_or_default();
    Arc::new(UnknownPast::new(restoration.cause, Instant::now() + left))
}

/// Forgets a restoration that a person has confirmed.
pub(super) fn confirm(connection: &Connection) -> rusqlite::Result<()> {
    identity::remove(connection, KEY)
}
