//! The writing connection. A lock file keeps a second gateway from the same journal.

use std::collections::BTreeMap;
use std::fs::{DirBuilder, File, TryLockError};
use std::io;
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, OptionalExtension, Transaction, TransactionBehavior, params};

use super::chain::{Chain, Tip, memory_hash};
use super::kept_events;
use super::presence::FilePresence;
use super::reading::statistics;
use super::row::{EventKind, Row, word};
use super::schema::{self, APPLICATION_ID, Content, SPAN_BITS, VERSION, content};
use super::source::{BUSY_TIMEOUT, JournalLocation, Source, no_file};
use crate::model::{Name, PersistedKey};

/// Size limit of the write-ahead log in bytes, while no reader needs more of it.
const LOG_BYTES: u64 = 16 << 20;

/// Time for which emptying the log waits for readers.
const EMPTY_LOG_WITHIN: Duration = Duration::from_millis(100);

/// Maximum number of symbolic links in a path, the same as in Linux.
const MAX_LINKS: usize = 40;

/// Newest persisted values by gripper and key; `None` deletes one.
pub(super) type PersistedValues = BTreeMap<(Name, PersistedKey), Option<String>>;

/// Error of a journal that cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    /// The directory or the lock file cannot be created.
    #[error(
        "cannot create {path} for the journal: {cause}: let the gateway's user write there, or set another --journal"
    )]
    Directory { path: PathBuf, cause: io::Error },
    /// Another gateway uses the journal.
    #[error(
        "the journal {0} is in use by another gateway: stop that one, or give this one its own --name or --journal"
    )]
    Locked(PathBuf),
    /// The file is not a journal, or has another version.
    #[error("{0}")]
    NoJournal(String),
    /// The file cannot be used.
    #[error("{0}")]
    Unusable(String),
}

impl Content {
    /// Describes why this content cannot be used as a journal, with the remedy.
    pub(super) fn describe(self, path: &Path) -> String {
        let path = path.display();
        match self {
            Self::Version(found) => format!(
                "the journal {path} has version {found}, but this gateway needs version {VERSION}: use the gateway \
                 that wrote it, restore the backup from before the upgrade, or move the file away to begin a new journal"
            ),
            _ => format!(
                "{path} is not a journal (it lacks application id {APPLICATION_ID:#x}): name another file, or move \
                 this one away"
            ),
        }
    }
}

/// The writing connection.
#[derive(Debug)]
pub(super) struct Store {
    pub(super) source: Source,
    pub(super) connection: Connection,
    /// Open files; `None` for a journal in memory.
    presence: Option<FilePresence>,
    /// Lock that is held while the journal is open.
    _lock: Option<Lock>,
}

impl Store {
    pub(super) fn open(place: JournalLocation) -> Result<Self, OpenError> {
        let lock = match &place {
            JournalLocation::File(path) => match no_file(path) {
                Some(no_file) => return Err(OpenError::NoJournal(no_file)),
                None => Some(lock(path)?),
            },
            JournalLocation::Memory => None,
        };
        let source = Source::new(place);
        let opened = connect(&source).map_err(|error| OpenError::Unusable(source.describe(&error)))?;
        let connection = match opened {
            Ok(connection) => connection,
            Err(other) => return Err(OpenError::NoJournal(other.describe(Path::new(&source.place.to_string())))),
        };
        let presence = FilePresence::new(&source.place, &connection);
        let presence =
            presence.map_err(|error| OpenError::Unusable(format!("the journal {}: {error}", source.place)))?;
        Ok(Self { source, connection, presence, _lock: lock })
    }

    /// Checks that new records would be in the files at the journal's path.
    ///
    /// # Errors
    /// The lost file, and the remedy.
    pub(super) fn check_files(&mut self) -> Result<(), String> {
        self.presence.as_mut().map_or(Ok(()), FilePresence::check)
    }

    /// Checks the same after a write, which can change the files' sizes.
    ///
    /// # Errors
    /// As [`Store::check_files`].
    pub(super) fn check_written(&mut self) -> Result<(), String> {
        self.presence.as_mut().map_or(Ok(()), FilePresence::wrote)
    }

    /// Copies records from a lost write-ahead log into the database, which may still be in its place.
    pub(super) fn rescue(&mut self) {
        if self.presence.as_ref().is_some_and(|presence| !presence.is_truncated())
            && let Err(error) = self.checkpoint()
        {
            tracing::warn!(%error, "newest records not copied into the journal file");
        }
    }

    pub(super) fn end(&self, chain: Chain) -> rusqlite::Result<Tip> {
        end_of(&self.connection, chain)
    }

    /// Returns the ends of the chains of events and grip records.
    pub(super) fn ends(&self) -> rusqlite::Result<[Tip; 2]> {
        Ok([self.end(Chain::Events)?, self.end(Chain::Grips)?])
    }

    /// Makes records and persisted values durable, all or none.
    pub(super) fn commit(&mut self, rows: &[Row], persisted: &PersistedValues) -> rusqlite::Result<()> {
        let transaction = self.begin()?;
        for row in rows {
            insert(&transaction, row)?;
        }
        for ((gripper, key), value) in persisted {
            persist(&transaction, gripper.as_str(), &word(key), value.as_deref())?;
        }
        transaction.commit()
    }

    pub(super) fn begin(&mut self) -> rusqlite::Result<Transaction<'_>> {
        self.connection.transaction_with_behavior(TransactionBehavior::Immediate)
    }

    /// Copies the write-ahead log into the file and empties it, unless a long read keeps it in use.
    pub(super) fn checkpoint(&mut self) -> rusqlite::Result<()> {
        // Notes a truncation before this process changes the sizes.
        let _ = self.check_files();
        self.connection.busy_timeout(EMPTY_LOG_WITHIN)?;
        let emptied = self.connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()));
        self.connection.busy_timeout(BUSY_TIMEOUT)?;
        // The next commit finds and reports a fault of the files again.
        let _ = self.check_written();
        emptied
    }

    /// Whether the write-ahead log is larger than its limit.
    pub(super) fn log_is_large(&self) -> bool {
        let log = self.connection.path().map(|path| format!("{path}-wal"));
        log.and_then(|log| std::fs::metadata(log).ok()).is_some_and(|log| log.len() > LOG_BYTES)
    }
}

/// Returns the last removed record of a chain; the chain's beginning if none was removed.
pub(super) fn anchor(connection: &Connection, chain: Chain) -> rusqlite::Result<Tip> {
    let anchor = connection.query_row("SELECT seq, hash FROM anchors WHERE chain = ?", [chain.name()], Tip::of_row);
    Ok(anchor.optional()?.unwrap_or_default())
}

/// Returns the newest record of a chain; the last removed one if none is left.
pub(super) fn end_of(connection: &Connection, chain: Chain) -> rusqlite::Result<Tip> {
    let newest = format!("SELECT seq, hash FROM {} ORDER BY seq DESC LIMIT 1", chain.name());
    let newest = connection.query_row(&newest, [], Tip::of_row).optional()?;
    let removed = anchor(connection, chain)?;
    Ok(newest.filter(|newest| newest.seq >= removed.seq).unwrap_or(removed))
}

/// Removes the spans without records among those of removed records, from `first` to `last`.
pub(super) fn remove_spans(connection: &Connection, chain: Chain, first: i64, last: i64) -> rusqlite::Result<()> {
    let table = chain.name();
    let sql = format!(
        "DELETE FROM spans WHERE chain = '{table}' AND span BETWEEN ?1 AND ?2 AND NOT EXISTS
             (SELECT 1 FROM {table} WHERE seq BETWEEN span << {SPAN_BITS} AND (span + 1 << {SPAN_BITS}) - 1)"
    );
    // Further records can follow in the last span.
    let last_span = ((last + 1) >> SPAN_BITS) - 1;
    connection.execute(&sql, [first >> SPAN_BITS, last_span]).map(drop)
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

fn persist(connection: &Connection, gripper: &str, key: &str, value: Option<&str>) -> rusqlite::Result<()> {
    let Some(value) = value else {
        let sql = "DELETE FROM memory WHERE gripper = ? AND key = ?";
        return connection.prepare_cached(sql)?.execute([gripper, key]).map(drop);
    };
    let sql = "INSERT OR REPLACE INTO memory(gripper, key, value, hash) VALUES (?, ?, ?, ?)";
    let values = params![gripper, key, value, memory_hash(gripper, key, value)];
    connection.prepare_cached(sql)?.execute(values).map(drop)
}

/// Opens a journal's file, and makes an empty file a journal. Returns the content of a file that is not a journal.
fn connect(source: &Source) -> rusqlite::Result<Result<Connection, Content>> {
    let mut connection = source.writing()?;
    match content(&connection)? {
        Content::Journal => {
            // Files of version 0.1.0 lack these. Only statistics and removals need them, so a full disk must not
            // prevent the start.
            if let Err(error) = connection.execute_batch(statistics::INDEX) {
                tracing::warn!(%error, "index for statistics not created: statistics are unavailable");
            }
            if let Err(error) = connection.execute_batch(kept_events::TABLE) {
                tracing::warn!(%error, "table of kept events not created: no record is removed");
            }
        }
        Content::Nothing => {
            // This pragma has an effect only before the tables exist.
            connection.pragma_update(None, "auto_vacuum", "INCREMENTAL")?;
            write_ahead(&connection)?;
            schema::create(&mut connection)?;
        }
        other => return Ok(Err(other)),
    }
    write_ahead(&connection)?;
    // Makes SQLite create the write-ahead log and its index now.
    content(&connection)?;
    Ok(Ok(connection))
}

/// Configures a connection so that readers don't wait for the writer, and each commit is on the disk when it returns.
fn write_ahead(connection: &Connection) -> rusqlite::Result<()> {
    connection.pragma_update_and_check(None, "journal_mode", "WAL", |_| Ok(()))?;
    connection.pragma_update(None, "synchronous", "FULL")?;
    connection.pragma_update_and_check(None, "journal_size_limit", LOG_BYTES.cast_signed(), |_| Ok(()))
}

/// The lock that keeps a second gateway from the same file. Readers ignore it.
#[derive(Debug)]
struct Lock(File);

impl Drop for Lock {
    /// Unlocks explicitly, because closing the file is not enough: a child process shares the open file until it executes
    /// its program.
    fn drop(&mut self) {
        let _ = self.0.unlock();
    }
}

fn lock(path: &Path) -> Result<Lock, OpenError> {
    if let Some(directory) = path.parent().filter(|directory| !directory.as_os_str().is_empty()) {
        let created = DirBuilder::new().recursive(true).mode(0o700).create(directory);
        created.map_err(|cause| OpenError::Directory { path: directory.to_owned(), cause })?;
    }
    let name = lock_file(path).map_err(|cause| OpenError::Directory { path: path.to_owned(), cause })?;
    let opened = File::options().write(true).create(true).truncate(false).open(&name);
    let lock = opened.map_err(|cause| OpenError::Directory { path: name.clone(), cause })?;
    match lock.try_lock() {
        Ok(()) => Ok(Lock(lock)),
        Err(TryLockError::WouldBlock) => Err(OpenError::Locked(path.to_owned())),
        Err(TryLockError::Error(cause)) => Err(OpenError::Directory { path: name, cause }),
    }
}

fn lock_file(path: &Path) -> io::Result<PathBuf> {
    let mut name = real(path)?.into_os_string();
    name.push("-lock");
    Ok(name.into())
}

/// Whether a gateway uses the journal at this moment; `None` if its lock file cannot be opened.
#[must_use]
pub fn is_in_use(path: &Path) -> Option<bool> {
    let lock = lock_file(path).and_then(File::open).ok()?;
    Some(matches!(lock.try_lock_shared(), Err(TryLockError::WouldBlock)))
}

/// Resolves all links to the file, because SQLite writes to their target. The file need not exist yet.
pub(super) fn real(path: &Path) -> io::Result<PathBuf> {
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
    Err(io::Error::other(format!("the path has more than {MAX_LINKS} links")))
}

#[cfg(test)]
impl Store {
    /// Limits the file's size, as a full disk does.
    pub(super) fn limit_pages(&self, pages: i64) {
        self.connection.pragma_update_and_check(None, "max_page_count", pages, |_| Ok(())).unwrap();
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::Directory;
    use super::*;

    #[test]
    fn lock_is_released_while_a_child_shares_its_file() {
        let directory = Directory::new();
        let held = lock(&directory.journal()).unwrap();
        let _shared = held.0.try_clone().unwrap();
        assert!(matches!(lock(&directory.journal()), Err(OpenError::Locked(_))));
        drop(held);
        assert!(lock(&directory.journal()).is_ok());
    }
}
