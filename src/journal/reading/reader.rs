//! Read connections to a journal, and a small pool of them for many readers.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use rusqlite::{Connection, InterruptHandle, OptionalExtension, params};
use tokio::sync::Semaphore;

use super::commands::command_of;
use super::query::{Cursor, EventQuery, GripQuery, Page, grip, page};
use super::statistics::{GripStatistics, SHARED_FROM, StatisticsQuery, statistics};
use crate::journal::chain::Chain;
use crate::journal::curve;
use crate::journal::head::Head;
use crate::journal::kept_events;
use crate::journal::recovery::{self, Recovered};
use crate::journal::schema::{Content, content};
use crate::journal::source::{JournalLocation, ReadError, Source, no_file};
use crate::journal::store::anchor;
use crate::model::{CommandId, CommandReport, Name, Sample};

/// Maximum number of concurrent reads. More than there are cores would only wait longer.
const READERS: usize = 4;

/// A read-only connection, possibly in another process than the gateway that writes.
#[derive(Debug)]
pub struct Reader {
    source: Source,
    connection: Connection,
}

impl Reader {
    /// Opens a journal file, even while a gateway writes to it.
    ///
    /// # Errors
    /// [`ReadError`], if the file is missing, is not a journal, or has another version.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        if !path.exists() {
            let path = path.display();
            return Err(ReadError(format!("the journal {path} does not exist: pass --journal PATH, or --name NAME")));
        }
        if let Some(no_file) = no_file(path) {
            return Err(ReadError(no_file));
        }
        let reader = Self::connect(&Source::new(JournalLocation::File(path.to_owned())))?;
        match reader.with(content)? {
            Content::Journal => Ok(reader),
            other => Err(ReadError(other.describe(path))),
        }
    }

    pub(in crate::journal) fn connect(source: &Source) -> Result<Self, ReadError> {
        let connection = source.reading().map_err(|error| ReadError(source.describe(&error)))?;
        Ok(Self { source: source.clone(), connection })
    }

    pub(in crate::journal) fn connection(&self) -> &Connection {
        &self.connection
    }

    pub(in crate::journal) fn interrupt_handle(&self) -> InterruptHandle {
        self.connection.get_interrupt_handle()
    }

    pub(in crate::journal) fn with<T>(
        &self,
        read: impl FnOnce(&Connection) -> rusqlite::Result<T>,
    ) -> Result<T, ReadError> {
        read(&self.connection).map_err(|error| ReadError(self.source.describe(&error)))
    }

    /// Reads a page of events.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub fn events(&self, query: &EventQuery) -> Result<Page, ReadError> {
        self.events_until(query, i64::MAX)
    }

    /// Reads a page of events up to sequence number `until`.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub fn events_until(&self, query: &EventQuery, until: i64) -> Result<Page, ReadError> {
        self.with(|connection| page(connection, query, until))
    }

    /// Reads a page of events from the oldest on, up to `until`, and the number of events that were removed between the
    /// cursor and the end of the page.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub(super) fn events_and_removed(&self, query: &EventQuery, until: i64) -> Result<(i64, Page), ReadError> {
        self.with(|connection| {
            // Both reads see the journal as it is now, even if events are removed meanwhile.
            let now = connection.unchecked_transaction()?;
            let page = page(&now, query, until)?;
            let after = query.cursor.map_or(0, Cursor::seq);
            let end = page.next_cursor.as_ref().and_then(|cursor| cursor.parse().ok()).map_or(until, Cursor::seq);
            let end = end.min(anchor(&now, Chain::Events)?.seq);
            let removed = if end > after { end - after - kept_events::count(&now, after, end)? } else { 0 };
            Ok((removed, page))
        })
    }

    /// Reads a page of grip records, each with `part_lost_at`, which is null unless the part was lost.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub fn grips(&self, query: &GripQuery) -> Result<Page, ReadError> {
        self.with(|connection| page(connection, query, i64::MAX))
    }

    /// Reads the grip record of a command, in the form that pages have.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub fn grip(&self, id: CommandId) -> Result<Option<Arc<str>>, ReadError> {
        self.with(|connection| grip(connection, id))
    }

    /// Reads the curve of a grip record.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub fn curve(&self, id: CommandId) -> Result<Option<Vec<Sample>>, ReadError> {
        let bytes: Option<Vec<u8>> = self.with(|connection| {
            let mut statement = connection.prepare_cached("SELECT curve FROM grips WHERE command_id = ?")?;
            statement.query_row([id.to_string()], |row| row.get(0)).optional()
        })?;
        let Some(bytes) = bytes else { return Ok(None) };
        match curve::decode(&bytes) {
            Ok(samples) => Ok(Some(samples)),
            Err(error) => Err(ReadError(format!("the journal {}: grip {id}: {error}", self.source.place))),
        }
    }

    /// Computes statistics of grips.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub fn statistics(&self, query: &StatisticsQuery) -> Result<GripStatistics, ReadError> {
        self.with(|connection| statistics(&self.source, connection, query, SHARED_FROM))
    }

    /// Reads the newest state of a gripper's command.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub fn command(&self, gripper: &Name, id: CommandId) -> Result<Option<CommandReport>, ReadError> {
        let body: Option<String> = self.with(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT body FROM events INDEXED BY events_command_id
                 WHERE command_id = ? AND kind = 'command' AND gripper = ? ORDER BY seq DESC LIMIT 1",
            )?;
            statement.query_row(params![id.to_string(), gripper.as_str()], |row| row.get(0)).optional()
        })?;
        Ok(body.and_then(|body| command_of(&body)))
    }

    /// Returns the data of this run and of earlier ones.
    pub(in crate::journal) fn recall(&self) -> Result<Recovered, ReadError> {
        self.with(recovery::recall)
    }

    /// Returns the newest event and grip record, with their hashes.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub fn head(&self) -> Result<Head, ReadError> {
        self.with(Head::read)
    }

    /// Returns the sequence number of the newest event; 0 in an empty journal.
    ///
    /// # Errors
    /// [`ReadError`], if the journal cannot be read.
    pub fn last_seq(&self) -> Result<i64, ReadError> {
        self.with(|connection| {
            let sql = format!("SELECT coalesce(max(seq), 0) FROM {}", Chain::Events.name());
            connection.prepare_cached(&sql)?.query_row([], |row| row.get(0))
        })
    }
}

/// A pool of readers for asynchronous callers.
#[derive(Debug, Clone)]
pub(in crate::journal) struct Pool {
    source: Arc<Source>,
    idle: Arc<Mutex<Vec<Reader>>>,
    permits: Arc<Semaphore>,
}

impl Pool {
    pub(in crate::journal) fn new(source: &Source) -> Self {
        let permits = Arc::new(Semaphore::new(READERS));
        Self { source: Arc::new(source.clone()), idle: Arc::default(), permits }
    }

    pub(in crate::journal) async fn read<T: Send + 'static>(
        &self,
        read: impl FnOnce(&Reader) -> Result<T, ReadError> + Send + 'static,
    ) -> Result<T, ReadError> {
        let permit = self.permits.clone().acquire_owned().await.map_err(|error| ReadError(error.to_string()))?;
        let pool = self.clone();
        let reading = tokio::task::spawn_blocking(move || {
            let _permit = permit;
            let idle = pool.idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
            let reader = idle.map_or_else(|| Reader::connect(&pool.source), Ok)?;
            let result = read(&reader);
            if result.is_ok() {
                pool.idle.lock().unwrap_or_else(PoisonError::into_inner).push(reader);
            }
            result
        });
        reading.await.map_err(|error| ReadError(error.to_string()))?
    }
}
