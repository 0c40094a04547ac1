//! Event streams: past events, then new ones, without a gap or a repetition between the two.

use std::collections::VecDeque;
use std::sync::Arc;

use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;

use super::query::{Cursor, EventQuery, Filter, Limit, Order};
use super::reader::{Pool, Reader};
use crate::journal::row::{EventKind, Stored};
use crate::journal::shared::Shared;
use crate::journal::source::ReadError;

/// Events read at once. Each of a thousand followers can hold this many if its client stops reading.
const PAGE: u64 = 16;

#[derive(Debug, PartialEq)]
pub enum StreamItem {
    Event(Arc<Stored>),
    /// Events of any gripper that retention has removed. Events that it has left can be among them, and follow.
    Removed {
        /// Sequence number of the last event before them.
        after: i64,
        /// Number of removed events, at least 1.
        missed: i64,
    },
}

/// The events after a given one, in order.
#[derive(Debug)]
pub struct EventStream {
    live: broadcast::Receiver<Arc<Stored>>,
    shared: Arc<Shared>,
    pool: Pool,
    filter: Filter<EventKind>,
    /// Events up to this one were returned, are in `read`, or don't match the filter.
    after: i64,
    /// Events up to this one come from the file.
    until: i64,
    read: VecDeque<StreamItem>,
    /// Whether the resume cursor may lie beyond the newest event.
    is_ahead: bool,
}

impl EventStream {
    pub(in crate::journal) fn new(
        shared: &Arc<Shared>,
        pool: &Pool,
        after: Option<i64>,
        filter: Filter<EventKind>,
    ) -> Self {
        // Subscribes before it reads the newest number, so that no event is lost between the two. Repeats are skipped.
        let live = shared.subscribe();
        let until = shared.committed();
        let after = after.unwrap_or(until);
        let is_ahead = after > until;
        let read = VecDeque::new();
        Self { live, shared: shared.clone(), pool: pool.clone(), filter, after, until, read, is_ahead }
    }

    /// Waits for the next durable event or a notice of removed ones; `None` once the journal is closed. Cancel-safe.
    ///
    /// # Errors
    /// [`ReadError`], if older events cannot be read. The next call tries again.
    pub async fn next(&mut self) -> Result<Option<StreamItem>, ReadError> {
        loop {
            if let Some(read) = self.read.pop_front() {
                return Ok(Some(read));
            }
            if self.is_ahead {
                // A cursor beyond the newest event belongs to another journal, so the stream starts at the beginning.
                if self.after > self.pool.read(Reader::last_seq).await? {
                    self.after = 0;
                }
                self.is_ahead = false;
            }
            if self.after < self.until {
                self.catch_up().await?;
                continue;
            }
            match self.live.recv().await {
                Ok(event) if event.seq <= self.after => {}
                Ok(event) if event.seq == self.after + 1 => {
                    self.after = event.seq;
                    if self.filter.matches(&event) {
                        return Ok(Some(StreamItem::Event(event)));
                    }
                }
                Ok(event) => self.until = event.seq,
                Err(RecvError::Lagged(_)) => self.until = self.shared.committed(),
                Err(RecvError::Closed) => return Ok(None),
            }
        }
    }

    async fn catch_up(&mut self) -> Result<(), ReadError> {
        let after = self.after;
        let until = self.until;
        let filter = self.filter.clone();
        let cursor = Some(Cursor::after(after));
        let query = EventQuery {
            filter,
            cursor,
            order: Order::Oldest,
            limit: Limit::new(PAGE).unwrap_or_default(),
            ..EventQuery::default()
        };
        let (missed, page) = self.pool.read(move |reader| reader.events_and_removed(&query, until)).await?;
        let read = page.bodies.into_iter().map(|body| Stored::of(body).map(Arc::new));
        let read = read.collect::<Result<Vec<_>, _>>();
        let read = read.map_err(|error| ReadError(format!("an event in the journal is damaged: {error}")))?;
        self.after = match (page.next_cursor, read.last()) {
            (Some(_), Some(last)) => last.seq,
            _ => until,
        };
        // Events removed beyond `until` show at the next read.
        self.read.extend((missed > 0).then_some(StreamItem::Removed { after, missed }));
        self.read.extend(read.into_iter().map(StreamItem::Event));
        Ok(())
    }
}
