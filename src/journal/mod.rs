//! The journal: events and grip records that outlive the gateway, each in a chain of hashes, in one SQLite file.
//!
//! A gripper never waits for it: [`Journal`] is a [`Recorder`] whose queue a thread of its own empties, many records to
//! a transaction, and who needs to know is told once they are on the disk. Readers have connections of their own, and
//! get the JSON as it was written. [`verify`] says whether a file is as it was written.

mod chain;
mod check;
mod commands;
pub mod csv;
mod curve;
mod event_stream;
mod presence;
mod prune;
mod query;
mod rates;
mod reader;
mod recovery;
mod row;
mod runs;
mod schema;
mod shared;
mod source;
mod store;
#[cfg(test)]
mod tests;
mod verify;
mod writer;

use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, watch};

use crate::gripper::model::{Command, CommandEvent, CommandId, Detail, Event, Name, PersistedState, Sample};
use crate::gripper::recorder::{Health, Record, Recorder};
use check::Check;
use reader::Pool;
use shared::Shared;
use store::Store;
use writer::{Input, Writer};

pub use commands::command_of;
pub use event_stream::{EventStream, StreamItem};
pub use query::{Cursor, EventQuery, Filter, GripQuery, InvalidCursor, InvalidLimit, Limit, Order, Page, Query};
pub use reader::Reader;
pub use recovery::Recovered;
pub use row::{EventKind, Stored};
pub use source::{Place, ReadError};
pub use store::OpenError;
pub use verify::{Finding, Report, verify};

/// How many records may wait for the thread that writes: what comes in while a disk stalls for some seconds.
const QUEUE: usize = 8192;

/// How many ends of commands have a place besides: more than run at once. A command without its end would be `UNKNOWN`
/// at the next start, and keep all behind it from being removed.
const ENDS: usize = 1024;

/// How large a journal in memory gets where nothing else is said, in bytes.
const MEMORY_BYTES: u64 = 64 << 20;

/// How long records are kept. None of a command that has not ended is removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Retention {
    /// How old they get; for ever where there is none.
    pub max_age: Option<Duration>,
    /// How large the file gets, without its write-ahead log.
    pub max_bytes: Option<u64>,
}

/// An open journal. Its clones are the same journal.
#[derive(Debug, Clone)]
pub struct Journal {
    writing: Arc<Writing>,
    shared: Arc<Shared>,
    pool: Pool,
}

/// The thread that writes, which ends with the last handle.
#[derive(Debug)]
struct Writing {
    inputs: SyncSender<Input>,
    check: Mutex<Option<Check>>,
    thread: Mutex<Option<JoinHandle<Result<(), String>>>>,
}

/// The journal was closed without all that it was to keep.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CloseError(String);

impl Journal {
    /// Opens a journal, and ends what its last run left open. A disk that takes nothing is a [`Health`], and is tried
    /// again.
    ///
    /// # Errors
    /// [`OpenError`], where another gateway has it, where it is no journal, or can't be made or read.
    pub fn open(place: Place, retention: Retention) -> Result<(Self, Recovered), OpenError> {
        let in_memory = place == Place::Memory;
        let max_bytes = retention.max_bytes.or(in_memory.then_some(MEMORY_BYTES));
        let store = Store::open(place)?;
        let source = store.source.clone();
        let unusable = |error| OpenError::Unusable(source.words(&error));
        let (recovered, events) = recovery::recover(&store.connection).map_err(unusable)?;
        let writer = Writer::new(store, Retention { max_bytes, ..retention }, events).map_err(unusable)?;
        let shared = writer.shared();
        let check = Check::start(&source, shared.clone())?;
        let (inputs, queue) = sync_channel(QUEUE + ENDS);
        let (watched, place) = (shared.clone(), source.place.clone());
        // It ends with the thread that it watches.
        spawn("journal-watch", move || watched.watch(&place))?;
        let thread = spawn("journal", move || writer.run(&queue))?;
        let writing = Arc::new(Writing { inputs, check: Mutex::new(check), thread: Mutex::new(Some(thread)) });
        Ok((Self { writing, shared, pool: Pool::new(&source) }, recovered))
    }

    /// Writes what waits and that the gateway has ended in order, and ends the writing. What is recorded later is lost.
    ///
    /// # Errors
    /// [`CloseError`], where the disk didn't take all.
    pub async fn close(&self) -> Result<(), CloseError> {
        let writing = self.writing.clone();
        let closing = tokio::task::spawn_blocking(move || writing.end(true));
        closing.await.map_err(|error| CloseError(error.to_string()))?.map_err(CloseError)
    }

    /// The newest durable event's sequence number; 0 before the first.
    #[must_use]
    pub fn last_seq(&self) -> i64 {
        self.shared.committed()
    }

    /// Each event once it is durable. Who is too slow misses some, and is told how many.
    #[must_use]
    pub fn subscribe(&self) -> broadcast::Receiver<Arc<Stored>> {
        self.shared.subscribe()
    }

    /// The events behind one, or those from now on; slow followers miss none but those that are too old, and are told of
    /// them.
    #[must_use]
    pub fn follow(&self, after: Option<i64>, filter: Filter<EventKind>) -> EventStream {
        EventStream::new(&self.shared, &self.pool, after, filter)
    }

    /// See [`Reader::events`].
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub async fn events(&self, query: EventQuery) -> Result<Page, ReadError> {
        self.pool.read(move |reader| reader.events(&query)).await
    }

    /// See [`Reader::grips`].
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub async fn grips(&self, query: GripQuery) -> Result<Page, ReadError> {
        self.pool.read(move |reader| reader.grips(&query)).await
    }

    /// See [`Reader::grip`].
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub async fn grip(&self, id: CommandId) -> Result<Option<Arc<str>>, ReadError> {
        self.pool.read(move |reader| reader.grip(id)).await
    }

    /// See [`Reader::curve`].
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub async fn curve(&self, id: CommandId) -> Result<Option<Vec<Sample>>, ReadError> {
        self.pool.read(move |reader| reader.curve(id)).await
    }

    /// See [`Reader::command`].
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub async fn command(&self, gripper: Name, id: CommandId) -> Result<Option<Command>, ReadError> {
        self.pool.read(move |reader| reader.command(&gripper, id)).await
    }
}

fn spawn<T: Send + 'static>(name: &str, run: impl FnOnce() -> T + Send + 'static) -> Result<JoinHandle<T>, OpenError> {
    let thread = std::thread::Builder::new().name(name.to_owned()).spawn(run);
    thread.map_err(|error| OpenError::Unusable(format!("no thread for the journal: {error}")))
}

impl Recorder for Journal {
    fn record(&self, record: Record) {
        let record = match record {
            Record::Event(event, waiter) => {
                let Some(event) = self.shared.rates.take(Instant::now(), event) else {
                    // A Stop beyond its client's rate counts with the next one: nothing waits for that.
                    let _ = waiter.map(|waiter| waiter.send(()));
                    return;
                };
                // Its end would come too late, if a try to write takes long.
                Record::Event(event, waiter.filter(|_| !self.shared.failing()))
            }
            Record::Persisted(memory) => return self.remember(memory),
            record @ Record::Grip(_) => record,
        };
        let has_place = self.shared.waits(places(&record, QUEUE));
        if has_place && self.writing.inputs.try_send(Input::Record(Box::new(record))).is_ok() {
            return;
        }
        if has_place {
            self.shared.waits_no_more();
        }
        self.shared.lose();
    }

    fn health(&self) -> watch::Receiver<Health> {
        self.shared.health.subscribe()
    }
}

impl Journal {
    /// A value finds its place however much waits, since it takes that of the one before.
    fn remember(&self, memory: PersistedState) {
        self.shared.remember(memory);
        // Where there is no room for it, the thread has enough to do, and looks when it has done that.
        if let Err(TrySendError::Disconnected(_)) = self.writing.inputs.try_send(Input::Memories) {
            self.shared.lose();
        }
    }
}

/// How many records may wait for this one to have a place too.
fn places(record: &Record, places: usize) -> usize {
    match record {
        Record::Event(Event { detail: Detail::Command(CommandEvent::Done(_)), .. }, _) => places + ENDS,
        _ => places,
    }
}

impl Writing {
    fn end(&self, orderly: bool) -> Result<(), String> {
        let Some(thread) = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take() else { return Ok(()) };
        if let Some(check) = self.check.lock().unwrap_or_else(PoisonError::into_inner).take() {
            check.end();
        }
        // A thread that has gone has said why.
        let _ = self.inputs.send(Input::End { orderly });
        thread.join().unwrap_or_else(|_| Err("the journal's thread has panicked".to_owned()))
    }
}

impl Drop for Writing {
    fn drop(&mut self) {
        if let Err(cause) = self.end(false) {
            tracing::error!(cause, "the journal was closed");
        }
    }
}
