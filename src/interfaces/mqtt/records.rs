//! The journal's events and grip records after a position, each list in order and without a gap.

use std::collections::VecDeque;
use std::sync::Arc;

use serde::Deserialize;
use serde_json::json;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;

use super::position::{Position, PublishedList, RecordStep};
use crate::journal::{
    Cursor, EventKind, EventStream, Filter, GripQuery, GripUpdate, Journal, Limit, Order, ReadError, Stored, StreamItem,
};
use crate::model::Name;

/// Grip records read at once.
const PAGE: u64 = 16;

/// A record to publish.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct JournalRecord {
    pub(super) chain: PublishedList,
    pub(super) gripper: Option<Name>,
    /// Sequence number of the record.
    pub(super) seq: i64,
    /// The record as JSON, as over HTTP.
    pub(super) body: Arc<str>,
    /// RecordStep that the publication completes; `None` for the repetition of a grip record whose part was lost.
    pub(super) step: Option<RecordStep>,
}

/// Reason why a record cannot be published.
#[derive(Debug, thiserror::Error)]
pub(super) enum RecordError {
    #[error(transparent)]
    Unreadable(#[from] ReadError),
    #[error("a grip record in the journal is damaged: {0}")]
    Damaged(#[from] serde_json::Error),
}

/// The records after a position.
pub(super) struct Records {
    gateway: Name,
    journal: Journal,
    /// `None` if events are not published.
    events: Option<EventStream>,
    /// `None` if grip records are not published.
    grips: Option<GripRecords>,
    /// An event whose changed grip record is read.
    held: Option<Arc<Stored>>,
    next: VecDeque<JournalRecord>,
}

/// Lists that are published.
#[derive(Debug, Clone, Copy)]
pub(super) struct PublishedLists {
    pub(super) events: bool,
    pub(super) grips: bool,
}

/// Returns the position behind the newest records.
pub(super) async fn newest(journal: &Journal) -> Result<Position, RecordError> {
    let events = journal.last_seq();
    let query = GripQuery { limit: Limit::new(1).unwrap_or_default(), ..GripQuery::default() };
    let page = journal.grips(query).await?;
    let grips = page.bodies.first().map_or(Ok(0), |body| parts(body).map(|grip| grip.seq))?;
    Ok(Position { events, grips })
}

impl Records {
    pub(super) fn after(position: Position, lists: PublishedLists, journal: &Journal, gateway: &Name) -> Self {
        let events = lists.events.then(|| journal.follow(Some(position.events), Filter::default()));
        let grips = lists.grips.then(|| GripRecords::after(position.grips, journal));
        let next = VecDeque::new();
        Self { gateway: gateway.clone(), journal: journal.clone(), events, grips, held: None, next }
    }

    /// Waits for the next record; `None` once the journal is closed. Cancel-safe.
    ///
    /// # Errors
    /// [`RecordError`]. The next call tries again.
    pub(super) async fn next(&mut self) -> Result<Option<JournalRecord>, RecordError> {
        loop {
            if let Some(record) = self.next.pop_front() {
                return Ok(Some(record));
            }
            if let Some(event) = &self.held {
                let changed = self.changed_grip(event).await?;
                self.next.extend(changed);
                self.next.extend(self.held.take().map(|event| of_event(&event)));
                continue;
            }
            // Grip records that were read go first: the repetition of a changed one must follow it.
            tokio::select! {
                biased;
                item = next_grip(&mut self.grips) => match item? {
                    Some(GripItem::Record(body)) => self.next.push_back(of_grip(&body)?),
                    Some(GripItem::Removed { after, missed }) => {
                        self.next.push_back(self.gap(PublishedList::Grips, after, missed));
                    }
                    None => return Ok(None),
                },
                item = next_event(&mut self.events) => match item? {
                    Some(StreamItem::Event(event)) => self.held = Some(event),
                    Some(StreamItem::Removed { after, missed }) => {
                        self.next.push_back(self.gap(PublishedList::Events, after, missed));
                    }
                    None => return Ok(None),
                },
            }
        }
    }

    /// Returns the grip record that an event has changed: its part was lost.
    async fn changed_grip(&self, event: &Stored) -> Result<Option<JournalRecord>, RecordError> {
        let lost = event.command_id.filter(|_| self.grips.is_some() && has_lost_part(event));
        let Some(id) = lost else { return Ok(None) };
        let body = self.journal.grip(id).await?;
        let record = body.map(|body| of_grip(&body)).transpose()?;
        Ok(record.map(|record| JournalRecord { step: None, ..record }))
    }

    /// Returns the notice of removed records.
    fn gap(&self, chain: PublishedList, after: i64, missed: i64) -> JournalRecord {
        let seq = after + missed;
        let body = json!({"kind": "gap", "gateway": self.gateway, "seq": after, "missed": missed});
        let step = Some(RecordStep { chain, seq });
        JournalRecord { chain, gripper: None, seq: after, body: body.to_string().into(), step }
    }
}

fn has_lost_part(event: &Stored) -> bool {
    #[derive(Deserialize)]
    struct Parts {
        event: String,
    }
    event.kind == EventKind::Device
        && serde_json::from_str::<Parts>(&event.body).is_ok_and(|parts| parts.event == "part_lost")
}

fn of_event(event: &Stored) -> JournalRecord {
    let step = Some(RecordStep { chain: PublishedList::Events, seq: event.seq });
    JournalRecord {
        chain: PublishedList::Events,
        gripper: event.gripper.clone(),
        seq: event.seq,
        body: event.body.clone(),
        step,
    }
}

fn of_grip(body: &Arc<str>) -> Result<JournalRecord, RecordError> {
    let GripParts { seq, gripper } = parts(body)?;
    let step = Some(RecordStep { chain: PublishedList::Grips, seq });
    Ok(JournalRecord { chain: PublishedList::Grips, gripper: Some(gripper), seq, body: body.clone(), step })
}

#[derive(Deserialize)]
struct GripParts {
    seq: i64,
    gripper: Name,
}

fn parts(body: &str) -> Result<GripParts, RecordError> {
    Ok(serde_json::from_str(body)?)
}

async fn next_event(events: &mut Option<EventStream>) -> Result<Option<StreamItem>, ReadError> {
    match events {
        Some(events) => events.next().await,
        None => std::future::pending().await,
    }
}

async fn next_grip(grips: &mut Option<GripRecords>) -> Result<Option<GripItem>, RecordError> {
    match grips {
        Some(grips) => grips.next().await,
        None => std::future::pending().await,
    }
}

#[derive(Debug, PartialEq, Eq)]
enum GripItem {
    Record(Arc<str>),
    /// Records that retention has removed.
    Removed {
        /// Sequence number of the last record before them.
        after: i64,
        missed: i64,
    },
}

/// The grip records after a given one, in order.
struct GripRecords {
    journal: Journal,
    written: broadcast::Receiver<Arc<GripUpdate>>,
    after: i64,
    page: VecDeque<Arc<str>>,
    /// Whether the file can have records after `after` that are not in `page`.
    is_behind: bool,
    /// Whether `after` was compared with the newest record.
    is_checked: bool,
}

impl GripRecords {
    fn after(after: i64, journal: &Journal) -> Self {
        // Subscribes before the first read, so that no record is lost between the two.
        let written = journal.subscribe_grips();
        let page = VecDeque::new();
        Self { journal: journal.clone(), written, after, page, is_behind: true, is_checked: false }
    }

    /// Waits for the next record; `None` once the journal is closed. Cancel-safe.
    async fn next(&mut self) -> Result<Option<GripItem>, RecordError> {
        loop {
            if let Some(body) = self.page.front() {
                let GripParts { seq, .. } = parts(body)?;
                let missed = seq - self.after - 1;
                if missed > 0 {
                    let after = self.after;
                    self.after += missed;
                    return Ok(Some(GripItem::Removed { after, missed }));
                }
                self.after = seq;
                return Ok(self.page.pop_front().map(GripItem::Record));
            }
            if self.is_behind {
                self.read().await?;
                continue;
            }
            match self.written.recv().await {
                Ok(grip) => self.is_behind = grip.seq > self.after,
                Err(RecvError::Lagged(_)) => self.is_behind = true,
                Err(RecvError::Closed) => return Ok(None),
            }
        }
    }

    async fn read(&mut self) -> Result<(), RecordError> {
        if !self.is_checked {
            // A position beyond the newest record belongs to another journal, so the records start at the beginning.
            if newest(&self.journal).await?.grips < self.after {
                self.after = 0;
            }
            self.is_checked = true;
        }
        let query = GripQuery {
            cursor: Some(Cursor::after(self.after)),
            order: Order::Oldest,
            limit: Limit::new(PAGE).unwrap_or_default(),
            ..GripQuery::default()
        };
        let page = self.journal.grips(query).await?;
        self.is_behind = !page.bodies.is_empty();
        self.page.extend(page.bodies);
        Ok(())
    }
}
