//! Following: what was, then what comes, without a gap or a repetition between the two.

use std::collections::VecDeque;
use std::sync::Arc;

use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError;

use super::query::{Cursor, EventQuery, Filter, Limit, Order};
use super::reader::{Pool, Reader};
use super::row::{EventKind, Stored};
use super::shared::Shared;
use super::source::ReadError;

/// Events that are read at once: a thousand followers that read nothing hold as many each.
const PAGE: u64 = 16;

/// What a follower is told.
#[derive(Debug, PartialEq)]
pub enum StreamItem {
    /// An event.
    Event(Arc<Stored>),
    /// So many events behind this one that are not there any more, of whatever gripper.
    Removed {
        /// The last one before them.
        behind: i64,
        /// How many they are: 1 or more.
        missed: i64,
    },
}

/// The events behind one, in order.
#[derive(Debug)]
pub struct EventStream {
    live: broadcast::Receiver<Arc<Stored>>,
    shared: Arc<Shared>,
    pool: Pool,
    filter: Filter<EventKind>,
    /// Up to this one, events have been returned, are in `read`, or don't match.
    after: i64,
    /// Up to this one, events come from the file.
    until: i64,
    read: VecDeque<StreamItem>,
    /// Whether there may be no such event yet as the one that is gone on behind.
    is_ahead: bool,
}

impl EventStream {
    pub(super) fn new(shared: &Arc<Shared>, pool: &Pool, after: Option<i64>, filter: Filter<EventKind>) -> Self {
        // Before it is looked what there is already: what comes between the two is seen twice rather than never.
        let live = shared.subscribe();
        let until = shared.committed();
        let after = after.unwrap_or(until);
        let (is_ahead, read) = (after > until, VecDeque::new());
        Self { live, shared: shared.clone(), pool: pool.clone(), filter, after, until, read, is_ahead }
    }

    /// The next event, once it is durable, or what is missing before it; none after the journal was closed. Nothing is lost where the caller gives up
    /// waiting.
    ///
    /// # Errors
    /// [`ReadError`], where older events can't be read. They are tried again by the next call.
    pub async fn next(&mut self) -> Result<Option<StreamItem>, ReadError> {
        loop {
            if let Some(read) = self.read.pop_front() {
                return Ok(Some(read));
            }
            if self.is_ahead {
                // Who has seen more than there is has seen another journal, and nothing of this one.
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
        let (after, until) = (self.after, self.until);
        let (filter, cursor) = (self.filter.clone(), Some(Cursor::behind(after)));
        let query = EventQuery {
            filter,
            cursor,
            order: Order::Oldest,
            limit: Limit::new(PAGE).unwrap_or_default(),
            ..EventQuery::default()
        };
        let (first, page) = self.pool.read(move |reader| reader.events_and_first(&query, until)).await?;
        let read = page.bodies.into_iter().map(|body| Stored::of(body).map(Arc::new));
        let read = read.collect::<Result<Vec<_>, _>>();
        let read = read.map_err(|error| ReadError(format!("an event is damaged: {error}")))?;
        self.after = match (page.next_cursor, read.last()) {
            (Some(_), Some(last)) => last.seq,
            _ => until,
        };
        // What is removed beyond is told by the next look.
        let missed = first.map_or(until, |first| until.min(first - 1)) - after;
        self.read.extend((missed > 0).then_some(StreamItem::Removed { behind: after, missed }));
        self.read.extend(read.into_iter().map(StreamItem::Event));
        Ok(())
    }
}
