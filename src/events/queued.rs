//! What comes one by one: events and frames, from broadcasts that a slow subscriber falls behind of.

use std::collections::BTreeSet;
use std::sync::Arc;

use futures_util::stream::{Stream, unfold};
use serde::Serialize;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use utoipa::ToSchema;

use super::{Notification, Source, Topic, Updates};
use crate::gripper::model::Name;

/// Told in place of what a client was too slow for, or what is too old to be there.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({"topic": "events", "gripper": null, "seq": 4711, "missed": 12}))]
pub struct Gap {
    /// Of which topic: `events` or `frames`.
    topic: Topic,
    /// Of which gripper; null for events, which are counted before they are told apart.
    #[schema(value_type = Option<String>, required, max_length = 32)]
    gripper: Option<Name>,
    /// The last one before those that are missing. `GET /events?order=oldest&cursor=` this has them, unless they are too old.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    seq: u64,
    /// How many are missing.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    missed: u64,
}

impl Gap {
    /// Of so many events behind this one.
    #[must_use]
    pub fn of_events(seq: i64, missed: u64) -> Self {
        Self { topic: Topic::Events, gripper: None, seq: seq.unsigned_abs(), missed }
    }
}

/// The next thing that a broadcast has; none after its end.
async fn next<T: Clone>(receiver: &mut Receiver<T>) -> Option<Result<T, u64>> {
    match receiver.recv().await {
        Ok(told) => Some(Ok(told)),
        Err(RecvError::Lagged(missed)) => Some(Err(missed)),
        Err(RecvError::Closed) => None,
    }
}

/// The events of these grippers, or all, from now on.
pub(super) fn events(
    updates: Arc<Updates>,
    only: Option<BTreeSet<Name>>,
) -> impl Stream<Item = Notification> + Send + 'static {
    // Before it is looked what there is already: what comes between the two is left out below rather than never told.
    let receiver = updates.journal.subscribe();
    let last = updates.journal.last_seq();
    unfold((receiver, last), move |(mut receiver, mut last)| {
        let (updates, only) = (updates.clone(), only.clone());
        async move {
            loop {
                let event = match next(&mut receiver).await? {
                    Ok(event) if event.seq <= last => continue,
                    Ok(event) => event,
                    Err(missed) => {
                        let gap = Gap::of_events(last, missed);
                        last += missed.cast_signed();
                        return Some((Notification::new("gap", &gap)?, (receiver, last)));
                    }
                };
                last = event.seq;
                let is_wanted =
                    only.as_ref().is_none_or(|only| event.gripper.as_ref().is_some_and(|name| only.contains(name)));
                if is_wanted && let Some(told) = updates.event(&event) {
                    return Some((told, (receiver, last)));
                }
            }
        }
    })
}

/// A gripper's frames from now on.
pub(super) fn frames(source: Arc<Source>) -> impl Stream<Item = Notification> + Send + 'static {
    let receiver = source.handle.frames();
    unfold((receiver, 0), move |(mut receiver, last)| {
        let source = source.clone();
        async move {
            let (told, last) = match next(&mut receiver).await? {
                Ok(frame) => (source.frame(&frame)?, frame.seq),
                Err(missed) => {
                    let gripper = Some(source.handle.name().clone());
                    let gap = Gap { topic: Topic::Frames, gripper, seq: last, missed };
                    (Notification::new("gap", &gap)?, last + missed)
                }
            };
            Some((told, (receiver, last)))
        }
    })
}
