//! Reading: one connection, and a few of them for many readers.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use rusqlite::{Connection, InterruptHandle, OptionalExtension, params};
use tokio::sync::Semaphore;

use super::chain::Chain;
use super::commands::command_of;
use super::curve;
use super::query::{EventQuery, Filter, GripQuery, Page, page};
use super::schema::{Content, content};
use super::source::{Place, ReadError, Source, no_file};
use crate::gripper::model::{Command, CommandId, Name, Sample};

/// How many read at once: what more than the cores do only waits longer.
const READERS: usize = 4;

/// A connection that only reads. It may be of another process than the gateway that writes.
#[derive(Debug)]
pub struct Reader {
    source: Source,
    connection: Connection,
}

impl Reader {
    /// Opens a journal's file, which a gateway may be writing.
    ///
    /// # Errors
    /// [`ReadError`], where there is no file, it is no journal, or not of this version.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        if !path.exists() {
            return Err(ReadError(format!("there is no journal {}: name the gateway's file", path.display())));
        }
        if let Some(no_file) = no_file(path) {
            return Err(ReadError(no_file));
        }
        let reader = Self::connect(&Source::new(Place::File(path.to_owned())))?;
        match reader.with(content)? {
            Content::Journal => Ok(reader),
            other => Err(ReadError(other.words(path))),
        }
    }

    pub(super) fn connect(source: &Source) -> Result<Self, ReadError> {
        let connection = source.reading().map_err(|error| ReadError(source.words(&error)))?;
        Ok(Self { source: source.clone(), connection })
    }

    pub(super) fn interrupt_handle(&self) -> InterruptHandle {
        self.connection.get_interrupt_handle()
    }

    pub(super) fn with<T>(&self, read: impl FnOnce(&Connection) -> rusqlite::Result<T>) -> Result<T, ReadError> {
        read(&self.connection).map_err(|error| ReadError(self.source.words(&error)))
    }

    /// A page of events.
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub fn events(&self, query: &EventQuery) -> Result<Page, ReadError> {
        self.events_until(query, i64::MAX)
    }

    /// A page of events none of which is newer than `until`.
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub fn events_until(&self, query: &EventQuery, until: i64) -> Result<Page, ReadError> {
        self.with(|connection| page(connection, query, until))
    }

    /// The same, and the oldest event's sequence number at that time; none where there is none.
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub(super) fn events_and_first(&self, query: &EventQuery, until: i64) -> Result<(Option<i64>, Page), ReadError> {
        self.with(|connection| {
            // Both see the journal as it is now, whatever is removed meanwhile.
            let now = connection.unchecked_transaction()?;
            let sql = format!("SELECT min(seq) FROM {}", Chain::Events.name());
            let first = now.prepare_cached(&sql)?.query_row([], |row| row.get(0))?;
            Ok((first, page(&now, query, until)?))
        })
    }

    /// A page of grip records, each with `part_lost_at`, which is null while the part was not lost.
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub fn grips(&self, query: &GripQuery) -> Result<Page, ReadError> {
        self.with(|connection| page(connection, query, i64::MAX))
    }

    /// The grip record of a command, as on a page.
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub fn grip(&self, id: CommandId) -> Result<Option<Arc<str>>, ReadError> {
        let filter = Filter { command_id: Some(id), ..Filter::default() };
        Ok(self.grips(&GripQuery { filter, ..GripQuery::default() })?.bodies.pop())
    }

    /// The curve of a grip record.
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub fn curve(&self, id: CommandId) -> Result<Option<Vec<Sample>>, ReadError> {
        let bytes: Option<Vec<u8>> = self.with(|connection| {
            let mut statement = connection.prepare_cached("SELECT curve FROM grips WHERE command_id = ?")?;
            statement.query_row([id.to_string()], |row| row.get(0)).optional()
        })?;
        let damaged = |error| ReadError(format!("the journal {}: grip {id}: {error}", self.source.place));
        bytes.map(|bytes| curve::decode(&bytes).map_err(damaged)).transpose()
    }

    /// A command of a gripper, as far as the journal knows it.
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub fn command(&self, gripper: &Name, id: CommandId) -> Result<Option<Command>, ReadError> {
        let body: Option<String> = self.with(|connection| {
            let mut statement = connection.prepare_cached(
                "SELECT body FROM events INDEXED BY events_command_id
                 WHERE command_id = ? AND kind = 'command' AND gripper = ? ORDER BY seq DESC LIMIT 1",
            )?;
            statement.query_row(params![id.to_string(), gripper.as_str()], |row| row.get(0)).optional()
        })?;
        Ok(body.and_then(|body| command_of(&body)))
    }

    /// The newest event's sequence number; 0 where there is none.
    ///
    /// # Errors
    /// [`ReadError`], where the journal can't be read.
    pub fn last_seq(&self) -> Result<i64, ReadError> {
        self.with(|connection| {
            let sql = format!("SELECT coalesce(max(seq), 0) FROM {}", Chain::Events.name());
            connection.prepare_cached(&sql)?.query_row([], |row| row.get(0))
        })
    }
}

/// Readers for an asynchronous program.
#[derive(Debug, Clone)]
pub(super) struct Pool {
    source: Arc<Source>,
    idle: Arc<Mutex<Vec<Reader>>>,
    permits: Arc<Semaphore>,
}

impl Pool {
    pub(super) fn new(source: &Source) -> Self {
        let permits = Arc::new(Semaphore::new(READERS));
        Self { source: Arc::new(source.clone()), idle: Arc::default(), permits }
    }

    pub(super) async fn read<T: Send + 'static>(
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
