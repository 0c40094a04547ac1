//! Topics whose updates are sent one by one: events, grip records and frames. Their broadcasts let a slow subscriber
//! fall behind.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use futures_util::stream::{Stream, unfold};
use serde::Serialize;
use tokio::sync::broadcast::{Receiver, error::RecvError};
use utoipa::ToSchema;

use super::{LiveUpdates, Notification, Source, Topic};
use crate::model::Name;

/// Notice sent in place of events, grip records or frames that a slow client missed, or that are no longer in the
/// journal.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({"topic": "events", "gripper": null, "seq": 4711, "missed": 12}))]
pub struct Gap {
    /// Topic with the gap: `events`, `grips` or `frames`.
    topic: Topic,
    /// Gripper of the missing frames. Null for other topics, whose count covers all grippers.
    #[schema(required)]
    gripper: Option<Name>,
    /// Sequence number of the last event, grip record or frame before the gap; 0 if this client has received none.
    /// `GET /events?order=oldest&cursor={seq}` returns the missing events, unless the journal has removed them, and
    /// `GET /grips` the missing grip records.
    seq: u64,
    /// Number of missing events, grip records or frames.
    #[schema(minimum = 1)]
    missed: u64,
}

impl Gap {
    /// A gap of `missed` events after event `seq`.
    #[must_use]
    pub fn of_events(seq: i64, missed: u64) -> Self {
        Self { topic: Topic::Events, gripper: None, seq: seq.unsigned_abs(), missed }
    }
}

/// Returns the next item of a broadcast, or the number of missed ones; `None` after its end.
async fn next<T: Clone>(receiver: &mut Receiver<T>) -> Option<Result<T, u64>> {
    match receiver.recv().await {
        Ok(item) => Some(Ok(item)),
        Err(RecvError::Lagged(missed)) => Some(Err(missed)),
        Err(RecvError::Closed) => None,
    }
}

/// Number of the last event that was sent to a subscription, was reported to it as missed, or is not wanted by it.
#[derive(Debug, Clone)]
pub(super) struct EventPosition(Arc<AtomicI64>);

impl EventPosition {
    pub(super) fn get(&self) -> i64 {
        self.0.load(Ordering::Relaxed)
    }

    pub(super) fn set(&self, seq: i64) {
        self.0.store(seq, Ordering::Relaxed);
    }
}

/// Streams the events of some grippers, or of all, from now on. Also returns the position of the stream.
pub(super) fn events(
    updates: Arc<LiveUpdates>,
    only: Option<BTreeSet<Name>>,
) -> (impl Stream<Item = Notification> + Send + 'static, EventPosition) {
    // Subscribes before it reads the newest number: events between the two are skipped below, not lost.
    let receiver = updates.journal.subscribe();
    let position = EventPosition(Arc::new(updates.journal.last_seq().into()));
    let stream = unfold((receiver, position.clone()), move |(mut receiver, position)| {
        let updates = updates.clone();
        let only = only.clone();
        async move {
            loop {
                let last = position.get();
                let event = match next(&mut receiver).await? {
                    Ok(event) if event.seq <= last => continue,
                    Ok(event) => event,
                    Err(missed) => {
                        position.set(last + missed.cast_signed());
                        let gap = Gap::of_events(last, missed);
                        return Some((Notification::new("gap", &gap)?, (receiver, position)));
                    }
                };
                position.set(event.seq);
                let is_wanted =
                    only.as_ref().is_none_or(|only| event.gripper.as_ref().is_some_and(|name| only.contains(name)));
                if is_wanted && let Some(update) = updates.event(&event) {
                    return Some((update, (receiver, position)));
                }
            }
        }
    });
    (stream, position)
}

/// Streams new and changed grip records of some grippers, or of all with `None`, from now on.
pub(super) fn grips(
    updates: &LiveUpdates,
    only: Option<BTreeSet<Name>>,
) -> impl Stream<Item = Notification> + Send + 'static {
    unfold((updates.journal.subscribe_grips(), 0), move |(mut receiver, last)| {
        let only = only.clone();
        async move {
            loop {
                match next(&mut receiver).await? {
                    Ok(grip) if only.as_ref().is_none_or(|only| only.contains(&grip.gripper)) => {
                        return Some((Notification::of_json("grip", &grip.body), (receiver, grip.seq.max(last))));
                    }
                    Ok(_) => {}
                    Err(missed) => {
                        let gap = Gap { topic: Topic::Grips, gripper: None, seq: last.unsigned_abs(), missed };
                        return Some((Notification::new("gap", &gap)?, (receiver, last)));
                    }
                }
            }
        }
    })
}

/// Streams a gripper's frames from now on, with or without automatic updates.
pub(super) fn frames(source: Arc<Source>, has_updates: bool) -> impl Stream<Item = Notification> + Send + 'static {
    let receiver = source.handle.frames();
    unfold((receiver, 0), move |(mut receiver, mut last)| {
        let source = source.clone();
        async move {
            let mut news = next(&mut receiver).await?;
            while let Ok(frame) = &news
                && !has_updates
                && frame.is_update()
            {
                last = frame.seq();
                news = next(&mut receiver).await?;
            }
            let (update, last) = match news {
                Ok(frame) => (source.frame(&frame)?, frame.seq()),
                Err(missed) => {
                    let gripper = Some(source.handle.name().clone());
                    let gap = Gap { topic: Topic::Frames, gripper, seq: last, missed };
                    (Notification::new("gap", &gap)?, last + missed)
                }
            };
            Some((update, (receiver, last)))
        }
    })
}
