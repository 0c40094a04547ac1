//! The connection that writes: one at a time, and alone.

use std::collections::BTreeMap;
use std::fs::{DirBuilder, File, TryLockError};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};

use super::chain::{Chain, Tip, memory_hash};
use super::presence::Presence;
use super::row::{EventKind, Row, word};
use super::schema::{self, APPLICATION_ID, Content, SPAN_BITS, VERSION, content};
use super::source::{BUSY_TIMEOUT, Place, Source, no_file};
use crate::gripper::model::{Name, PersistedKey};

/// How large the write-ahead log gets while readers don't need more of it, in bytes.
const LOG_BYTES: u64 = 16 << 20;

/// How long the log waits to be emptied for who reads from it.
const EMPTY_LOG_WITHIN: Duration = Duration::from_millis(100);

/// How many links a path may lead over: as many as Linux follows.
const MAX_LINKS: usize = 40;

/// The newest values to remember; none forgets one.
pub(super) type Memories = BTreeMap<(Name, PersistedKey), Option<String>>;

/// Why a journal was not opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// Its directory can't be made, or its lock not be had.
    #[error(
        "the journal's {path} can't be made: {cause}: let the gateway's user write there, or say another --journal"
    )]
    Directory {
        /// What can't be made.
        path: PathBuf,
        /// Why.
        cause: io::Error,
    },
    /// Another gateway writes it.
    #[error(
        "the journal {0} belongs to a gateway that is running: end it, or give this one a --name or --journal of its own"
    )]
    Locked(PathBuf),
    /// The file isn't a journal, or not of this version.
    #[error("{0}")]
    NoJournal(String),
    /// The file can't be used.
    #[error("{0}")]
    Unusable(String),
}

impl Content {
    /// Why it can't be used as a journal, and what to do about it.
    pub(super) fn words(self, path: &Path) -> String {
        let path = path.display();
        match self {
            Self::Version(found) => format!(
                "the journal {path} is of version {found}, and this gateway reads and writes version {VERSION}: \
                 use the gateway that wrote it, or move the file away to begin anew"
            ),
            _ => format!(
                "{path} is no journal (application id {APPLICATION_ID:#x} is not in it): name another file, or move \
                 it away"
            ),
        }
    }
}

/// The writing connection.
#[derive(Debug)]
pub(super) struct Store {
    pub(super) source: Source,
    pub(super) connection: Connection,
    /// The open files; none of a journal in memory.
    presence: Option<Presence>,
    /// Held as long as the journal is open.
    _lock: Option<File>,
}

impl Store {
    pub(super) fn open(place: Place) -> Result<Self, OpenError> {
        let lock = match &place {
            Place::File(path) => match no_file(path) {
                Some(no_file) => return Err(OpenError::NoJournal(no_file)),
                None => Some(lock(path)?),
            },
            Place::Memory => None,
        };
        let source = Source::new(place);
        let unusable = |error: rusqlite::Error| OpenError::Unusable(source.words(&error));
        let mut connection = source.writing().map_err(unusable)?;
        match content(&connection).map_err(unusable)? {
            Content::Journal => {}
            Content::Nothing => {
                // Takes effect only before there are tables.
                connection.pragma_update(None, "auto_vacuum", "INCREMENTAL").map_err(unusable)?;
                write_ahead(&connection).map_err(unusable)?;
                schema::create(&mut connection).map_err(unusable)?;
            }
            other => return Err(OpenError::NoJournal(other.words(Path::new(&source.place.to_string())))),
        }
        write_ahead(&connection).map_err(unusable)?;
        // Makes SQLite create the write-ahead log and its index now.
        content(&connection).map_err(unusable)?;
        let presence = Presence::new(&source.place, &connection);
        let presence =
            presence.map_err(|error| OpenError::Unusable(format!("the journal {}: {error}", source.place)))?;
        Ok(Self { source, connection, presence, _lock: lock })
    }

    /// Whether records written now would be in the files at the journal's path.
    ///
    /// # Errors
    /// The file that is lost, and the remedy.
    pub(super) fn check_files(&mut self) -> Result<(), String> {
        self.presence.as_mut().map_or(Ok(()), Presence::check)
    }

    /// The same after a write, which may have changed the file's size.
    ///
    /// # Errors
    /// As [`Store::check_files`].
    pub(super) fn check_written(&mut self) -> Result<(), String> {
        self.presence.as_mut().map_or(Ok(()), Presence::wrote)
    }

    /// Brings what only a lost write-ahead log has into the database, which may still be in its place.
    pub(super) fn rescue(&mut self) {
        if self.presence.as_ref().is_some_and(|presence| !presence.is_truncated())
            && let Err(error) = self.checkpoint()
        {
            tracing::warn!(%error, "the newest records could not be brought into the journal's file");
        }
    }

    /// The end of a chain.
    pub(super) fn end(&self, chain: Chain) -> rusqlite::Result<Tip> {
        let newest = format!("SELECT seq, hash FROM {} ORDER BY seq DESC LIMIT 1", chain.name());
        let tip = |row: &rusqlite::Row<'_>| Ok(Tip { seq: row.get(0)?, hash: row.get(1)? });
        match self.connection.query_row(&newest, [], tip).optional()? {
            Some(end) => Ok(end),
            None => anchor(&self.connection, chain),
        }
    }

    /// The ends of the chains: of events and of grip records.
    pub(super) fn ends(&self) -> rusqlite::Result<[Tip; 2]> {
        Ok([self.end(Chain::Events)?, self.end(Chain::Grips)?])
    }

    /// Makes records and memories durable, all or none.
    pub(super) fn commit(&mut self, rows: &[Row], memories: &Memories) -> rusqlite::Result<()> {
        let transaction = self.begin()?;
        for row in rows {
            insert(&transaction, row)?;
        }
        for ((gripper, key), value) in memories {
            remember(&transaction, gripper.as_str(), &word(key), value.as_deref())?;
        }
        transaction.commit()
    }

    pub(super) fn begin(&mut self) -> rusqlite::Result<Transaction<'_>> {
        self.connection.transaction_with_behavior(TransactionBehavior::Immediate)
    }

    /// Brings the write-ahead log into the file, and empties it, unless somebody reads from it for long.
    pub(super) fn checkpoint(&mut self) -> rusqlite::Result<()> {
        // A truncation is noted before the sizes change by this process.
        let _ = self.check_files();
        self.connection.busy_timeout(EMPTY_LOG_WITHIN)?;
        let emptied = self.connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()));
        self.connection.busy_timeout(BUSY_TIMEOUT)?;
        // What is wrong with the files is found again, and said, at the next commit.
        let _ = self.check_written();
        emptied
    }

    /// Whether the write-ahead log is larger than it has to be.
    pub(super) fn log_is_large(&self) -> bool {
        let log = self.connection.path().map(|path| format!("{path}-wal"));
        log.and_then(|log| std::fs::metadata(log).ok()).is_some_and(|log| log.len() > LOG_BYTES)
    }
}

/// The last removed record of a chain; the chain's beginning where none was removed.
pub(super) fn anchor(connection: &Connection, chain: Chain) -> rusqlite::Result<Tip> {
    let tip = |row: &rusqlite::Row<'_>| Ok(Tip { seq: row.get(0)?, hash: row.get(1)? });
    let anchor = connection.query_row("SELECT seq, hash FROM anchors WHERE chain = ?", [chain.name()], tip);
    Ok(anchor.optional()?.unwrap_or_default())
}

pub(super) fn insert(connection: &Connection, row: &Row) -> rusqlite::Result<()> {
    let chain = row.chain.name();
    let sql = format!("INSERT INTO {chain}(seq, at, body, curve, hash) VALUES (?, ?, ?, ?, ?)");
    let values = params![row.tip.seq, row.at, &*row.body, row.curve, row.tip.hash];
    connection.prepare_cached(&sql)?.execute(values)?;
    let span = "INSERT INTO spans(chain, span, oldest, newest) VALUES (?1, ?2, ?3, ?3) ON CONFLICT DO UPDATE
                SET oldest = min(oldest, excluded.oldest), newest = max(newest, excluded.newest)";
    connection.prepare_cached(span)?.execute(params![chain, row.tip.seq >> SPAN_BITS, row.at])?;
    let Some(event) = row.event.as_ref().filter(|event| event.kind == EventKind::Command) else { return Ok(()) };
    let Some(id) = event.command_id.map(|id| id.to_string()) else { return Ok(()) };
    if event.outcome.is_none() {
        let admitted = "INSERT OR REPLACE INTO running(command_id, seq) VALUES (?, ?)";
        connection.prepare_cached(admitted)?.execute(params![id, row.tip.seq])?;
    } else {
        connection.prepare_cached("DELETE FROM running WHERE command_id = ?")?.execute([id])?;
    }
    Ok(())
}

fn remember(connection: &Connection, gripper: &str, key: &str, value: Option<&str>) -> rusqlite::Result<()> {
    let Some(value) = value else {
        let sql = "DELETE FROM memory WHERE gripper = ? AND key = ?";
        return connection.prepare_cached(sql)?.execute([gripper, key]).map(drop);
    };
    let sql = "INSERT OR REPLACE INTO memory(gripper, key, value, hash) VALUES (?, ?, ?, ?)";
    let values = params![gripper, key, value, memory_hash(gripper, key, value)];
    connection.prepare_cached(sql)?.execute(values).map(drop)
}

/// Readers don't wait for the writer, and each commit is on the disk when it returns.
fn write_ahead(connection: &Connection) -> rusqlite::Result<()> {
    connection.pragma_update_and_check(None, "journal_mode", "WAL", |_| Ok(()))?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    connection.pragma_update_and_check(None, "journal_size_limit", LOG_BYTES.cast_signed(), |_| Ok(()))
}

/// Keeps a second gateway from writing the same file. Readers take no notice of it.
fn lock(path: &Path) -> Result<File, OpenError> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |cause| OpenError::Directory { path, cause }
    };
    if let Some(directory) = path.parent().filter(|directory| !directory.as_os_str().is_empty()) {
        DirBuilder::new().recursive(true).mode(0o700).create(directory).map_err(failed(directory))?;
    }
    let mut name = real(path).map_err(failed(path))?.into_os_string();
    name.push("-lock");
    let name = PathBuf::from(name);
    let lock = File::options().write(true).create(true).truncate(false).open(&name).map_err(failed(&name))?;
    match lock.try_lock() {
        Ok(()) => Ok(lock),
        Err(TryLockError::WouldBlock) => Err(OpenError::Locked(path.to_owned())),
        Err(TryLockError::Error(cause)) => Err(failed(&name)(cause)),
    }
}

/// The file's one name, whatever links lead to it, as SQLite writes to where they lead: also where there is no file yet.
fn real(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..MAX_LINKS {
        let directory = path.parent().filter(|directory| !directory.as_os_str().is_empty());
        let directory = directory.unwrap_or(Path::new(".")).canonicalize()?;
        let file = path.file_name().map_or_else(|| directory.clone(), |name| directory.join(name));
        match file.read_link() {
            Ok(target) => path = directory.join(target),
            Err(_) => return Ok(file),
        }
    }
    Err(io::Error::other(format!("it leads over more than {MAX_LINKS} links")))
}

#[cfg(test)]
impl Store {
    /// Makes the disk as full as if there were no room for more pages.
    pub(super) fn limit_pages(&self, pages: i64) {
        self.connection.pragma_update_and_check(None, "max_page_count", pages, |_| Ok(())).unwrap();
    }
}
