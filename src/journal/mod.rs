//! The journal: events and grip records that outlive the gateway, each in a chain of hashes, in one SQLite file.
//!
//! A gripper never waits for the journal: [`Journal`] is a [`Recorder`] with a queue, and a thread of its own writes
//! many records per transaction. A caller can be notified once its record is on the disk. Readers have their own
//! connections, and get the JSON as it was written. [`verify`] finds records that were changed later.

mod backup;
mod chain;
mod check;
mod clock;
pub mod csv;
mod curve;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;
mod head;
mod identity;
mod kept_events;
mod presence;
mod prune;
mod rates;
mod reading;
mod recovery;
mod restored;
mod row;
mod schema;
mod shared;
mod source;
mod store;
#[cfg(test)]
pub(crate) mod tests;
mod verify;
mod writer;

use std::sync::mpsc::{SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tokio::sync::{Semaphore, broadcast, watch};
use uuid::Uuid;

use crate::gripper::recorder::{JournalHealth, Record, Recorder, UnknownPast};
use crate::model::{Client, CommandEvent, CommandId, CommandReport, Detail, Event, Name, PersistedState, Sample};
use check::Check;
use head::HeadFile;
use reading::reader::Pool;
use shared::Shared;
use store::Store;
use writer::{JournalWriter, WriterInput};

pub use backup::{BackupError, back_up};
pub use clock::is_synchronised;
pub use head::{Head, InvalidHead};
pub use reading::commands::command_of;
pub use reading::event_stream::{EventStream, StreamItem};
pub use reading::query::{
    Cursor, EventQuery, Filter, GripQuery, InvalidCursor, InvalidLimit, Limit, Order, Page, Query,
};
pub use reading::reader::Reader;
pub use reading::statistics::{Distribution, GripStatistics, NEWEST_WEIGHS, StatisticsQuery};
pub use recovery::Recovered;
pub use row::{EventKind, GripUpdate, Stored};
pub use schema::VERSION;
pub use source::{JournalLocation, ReadError};
pub use store::{OpenError, is_in_use};
pub use verify::{Finding, Report, verify, verify_with_progress};

/// Records that can wait for the writing thread: enough for a disk that stalls for some seconds.
const QUEUE: usize = 8192;

/// Further places, for ends of commands only: more than run at once. A command without its end would be `UNKNOWN` at
/// the next start, and would keep all later events from being removed.
const ENDS: usize = 1024;

/// Default size limit of a journal in memory, in bytes.
const MEMORY_BYTES: u64 = 64 << 20;

/// Limits beyond which the oldest records are removed. A running command's events, and all later ones, stay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Retention {
    /// Age at which records are removed; never if absent.
    pub max_age: Option<Duration>,
    /// Size limit of the file in bytes, without its write-ahead log.
    pub max_bytes: Option<u64>,
}

/// An open journal. Clones share it.
#[derive(Debug, Clone)]
pub struct Journal {
    writing: Arc<Writing>,
    shared: Arc<Shared>,
    pool: Pool,
    /// Permit for computing statistics: only one computation runs at a time.
    statistics: Arc<Semaphore>,
    id: Uuid,
    /// The time without records, if the journal was restored.
    unknown_past: Option<Arc<UnknownPast>>,
}

/// Handle of the writing thread, which ends with the last [`Journal`].
#[derive(Debug)]
struct Writing {
    inputs: SyncSender<WriterInput>,
    check: Mutex<Option<Check>>,
    thread: Mutex<Option<JoinHandle<Result<(), String>>>>,
}

/// Error of a journal that was closed before all records were written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CloseError(String);

impl Journal {
    /// Opens a journal, and records the end of commands that its last run left open. A failing disk is not an error: it
    /// shows in [`JournalHealth`], and the write is retried.
    ///
    /// # Errors
    /// [`OpenError`], if another gateway uses the journal, or the file is not a journal or cannot be created or read.
    pub fn open(place: JournalLocation, retention: Retention) -> Result<(Self, Recovered), OpenError> {
        let in_memory = place == JournalLocation::Memory;
        let max_bytes = retention.max_bytes.or(in_memory.then_some(MEMORY_BYTES));
        let store = Store::open(place)?;
        let source = store.source.clone();
        let opened = restored::look(&store);
        let id = opened.id;
        let recovered = recovery::recover(&store.connection);
        let (mut recovered, mut events) = recovered.map_err(|error| OpenError::Unusable(source.describe(&error)))?;
        recovered.unknown_past.clone_from(&opened.unknown_past);
        events.extend(opened.event);
        let head = HeadFile::of(&store, id);
        let retention = Retention { max_bytes, ..retention };
        let writer = JournalWriter::new(store, head, retention, events);
        let writer = writer.map_err(|error| OpenError::Unusable(source.describe(&error)))?;
        tracing::info!(head = %writer.head(), journal = %source.place, "journal opened");
        let shared = writer.shared();
        shared.set_restored(opened.unknown_past.as_ref().map(|past| past.cause().to_owned()));
        let check = Check::start(&source, shared.clone())?;
        let (inputs, queue) = sync_channel(QUEUE + ENDS);
        let watched = shared.clone();
        let place = source.place.clone();
        // The watch ends with the writing thread.
        spawn("journal-watch", move || watched.watch(&place))?;
        let thread = spawn("journal", move || writer.run(&queue))?;
        let writing = Arc::new(Writing { inputs, check: Mutex::new(check), thread: Mutex::new(Some(thread)) });
        let statistics = Arc::new(Semaphore::new(1));
        let unknown_past = opened.unknown_past;
        Ok((Self { writing, shared, pool: Pool::new(&source), statistics, id, unknown_past }, recovered))
    }

    /// Writes the waiting records and the orderly end of the gateway, then stops writing. Later records are lost.
    ///
    /// # Errors
    /// [`CloseError`], if some records could not be written.
    pub async fn close(&self) -> Result<(), CloseError> {
        let writing = self.writing.clone();
        let closing = tokio::task::spawn_blocking(move || writing.end(true));
        closing.await.map_err(|error| CloseError(error.to_string()))?.map_err(CloseError)
    }

    /// Notes that a person knows of the restored journal: unknown request ids are accepted again.
    pub fn confirm_restored(&self) {
        if let Some(past) = &self.unknown_past {
            past.confirm();
            self.shared.set_restored(None);
            self.send(WriterInput::ConfirmRestored);
        }
    }

    /// Notes that a person trusts the wall clock.
    pub fn confirm_clock(&self) {
        self.send(WriterInput::ConfirmClock);
    }

    /// Sends an input that a full queue may delay.
    fn send(&self, input: WriterInput) {
        let inputs = self.writing.inputs.clone();
        // The thread ends only with the journal.
        if let Err(TrySendError::Full(input)) = inputs.try_send(input) {
            tokio::task::spawn_blocking(move || inputs.send(input));
        }
    }

    /// Returns the journal's id, which no other journal has.
    #[must_use]
    pub fn id(&self) -> Uuid {
        self.id
    }

    /// Returns the sequence number of the newest durable event; 0 before the first.
    #[must_use]
    pub fn last_seq(&self) -> i64 {
        self.shared.committed()
    }

    /// Whether a client may make another change that has a record of its own: some thousand at once, then about one a
    /// second.
    #[must_use]
    pub fn allows_change(&self, client: &Client) -> bool {
        self.shared.rates.allows(Instant::now(), client)
    }

    /// Subscribes to events as they become durable. A receiver that lags misses some, and gets their number.
    #[must_use]
    pub fn subscribe(&self) -> broadcast::Receiver<Arc<Stored>> {
        self.shared.subscribe()
    }

    /// Subscribes to grip records as they become durable, and as they change. A receiver that lags misses some.
    #[must_use]
    pub fn subscribe_grips(&self) -> broadcast::Receiver<Arc<GripUpdate>> {
        self.shared.subscribe_grips()
    }

    /// Streams the events after one, or those from now on. A slow follower misses only events that retention has
    /// removed, and gets their number.
    #[must_use]
    pub fn follow(&self, after: Option<i64>, filter: Filter<EventKind>) -> EventStream {
        EventStream::new(&self.shared, &self.pool, after, filter)
    }

    /// See [`Reader::events`].
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub async fn events(&self, query: EventQuery) -> Result<Page, ReadError> {
        self.pool.read(move |reader| reader.events(&query)).await
    }

    /// See [`Reader::grips`].
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub async fn grips(&self, query: GripQuery) -> Result<Page, ReadError> {
        self.pool.read(move |reader| reader.grips(&query)).await
    }

    /// See [`Reader::grip`].
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub async fn grip(&self, id: CommandId) -> Result<Option<Arc<str>>, ReadError> {
        self.pool.read(move |reader| reader.grip(id)).await
    }

    /// See [`Reader::curve`].
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub async fn curve(&self, id: CommandId) -> Result<Option<Vec<Sample>>, ReadError> {
        self.pool.read(move |reader| reader.curve(id)).await
    }

    /// Returns the data of this run and of earlier ones, for grippers that are added while the gateway runs.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub async fn recall(&self) -> Result<Recovered, ReadError> {
        let recovered = self.pool.read(Reader::recall).await?;
        Ok(Recovered { unknown_past: self.unknown_past.clone(), ..recovered })
    }

    /// See [`Reader::statistics`]. One request at a time is computed, since it can read a million records.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub async fn statistics(&self, query: StatisticsQuery) -> Result<GripStatistics, ReadError> {
        let turn = self.statistics.clone().acquire_owned().await.map_err(|error| ReadError(error.to_string()))?;
        // A computation goes on without its client, so it keeps the permit itself.
        let computed = self.pool.read(move |reader| {
            let _turn = turn;
            reader.statistics(&query)
        });
        computed.await
    }

    /// See [`Reader::command`].
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub async fn command(&self, gripper: Name, id: CommandId) -> Result<Option<CommandReport>, ReadError> {
        self.pool.read(move |reader| reader.command(&gripper, id)).await
    }
}

fn spawn<T: Send + 'static>(name: &str, run: impl FnOnce() -> T + Send + 'static) -> Result<JoinHandle<T>, OpenError> {
    let thread = std::thread::Builder::new().name(name.to_owned()).spawn(run);
    thread.map_err(|error| OpenError::Unusable(format!("cannot start a journal thread: {error}")))
}

impl Recorder for Journal {
    fn record(&self, record: Record) {
        let record = match record {
            Record::Event(event, waiter) => {
                let Some(event) = self.shared.rates.take(Instant::now(), event) else {
                    // A Stop beyond its client's rate is counted with the next one, so its waiter need not wait.
                    let _ = waiter.map(|waiter| waiter.send(()));
                    return;
                };
                // While the disk fails, the waiter is dropped at once: a retry could take too long.
                Record::Event(event, waiter.filter(|_| !self.shared.failing()))
            }
            Record::Persisted(value) => return self.persist(value),
            record @ Record::Grip(_) => record,
        };
        let has_place = self.shared.reserve_place(places(&record, QUEUE));
        if has_place && self.writing.inputs.try_send(WriterInput::Record(Box::new(record))).is_ok() {
            return;
        }
        if has_place {
            self.shared.release_place();
        }
        self.shared.lose();
    }

    fn health(&self) -> watch::Receiver<JournalHealth> {
        self.shared.health.subscribe()
    }
}

impl Journal {
    /// Stores a value however long the queue is, because it replaces the value before.
    fn persist(&self, value: PersistedState) {
        self.shared.persist(value);
        // With a full queue the thread is awake anyway, and takes the value with its next batch.
        if let Err(TrySendError::Disconnected(_)) = self.writing.inputs.try_send(WriterInput::PersistedValues) {
            self.shared.lose();
        }
    }
}

/// Number of waiting records below which this record is accepted.
fn places(record: &Record, places: usize) -> usize {
    let Record::Event(Event { detail, .. }, _) = record else { return places };
    match detail {
        Detail::Command(CommandEvent::Done(_)) | Detail::FastStop(_) | Detail::Acknowledge(_) => places + ENDS,
        _ => places,
    }
}

impl Writing {
    fn end(&self, orderly: bool) -> Result<(), String> {
        let Some(thread) = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take() else { return Ok(()) };
        if let Some(check) = self.check.lock().unwrap_or_else(PoisonError::into_inner).take() {
            check.end();
        }
        // If the thread has already ended, `join` returns the cause.
        let _ = self.inputs.send(WriterInput::End { orderly });
        thread.join().unwrap_or_else(|_| Err("the journal thread panicked".to_owned()))
    }
}

impl Drop for Writing {
    fn drop(&mut self) {
        if let Err(cause) = self.end(false) {
            tracing::error!(cause, "journal closed with an error");
        }
    }
}
