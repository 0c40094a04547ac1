//! Location of a journal, connections to it, and remedies for its errors.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, ErrorCode, OpenFlags};
use uuid::Uuid;

/// Time for which a connection waits for another's lock. Readers of a journal in memory make its writer wait.
pub(super) const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// Prepared statements that a connection keeps: each combination of filters has one.
const STATEMENTS: usize = 64;

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JournalLocation {
    /// In a file. A missing file and its directories are created.
    File(PathBuf),
    /// In memory, until the gateway ends.
    Memory,
}

impl fmt::Display for JournalLocation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Memory => f.write_str(":memory:"),
        }
    }
}

/// Parameters that all connections to a journal share.
#[derive(Debug, Clone)]
pub(super) struct Source {
    pub(super) place: JournalLocation,
    name: PathBuf,
}

impl Source {
    pub(super) fn new(place: JournalLocation) -> Self {
        let name = match &place {
            JournalLocation::File(path) => path.clone(),
            JournalLocation::Memory => format!("file:/wsg-gateway-{}?vfs=memdb", Uuid::now_v7()).into(),
        };
        Self { place, name }
    }

    pub(super) fn reading(&self) -> rusqlite::Result<Connection> {
        self.connect(OpenFlags::SQLITE_OPEN_READ_ONLY)
    }

    pub(super) fn writing(&self) -> rusqlite::Result<Connection> {
        self.connect(OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_CREATE)
    }

    fn connect(&self, mode: OpenFlags) -> rusqlite::Result<Connection> {
        let uri = match self.place {
            JournalLocation::File(_) => OpenFlags::empty(),
            JournalLocation::Memory => OpenFlags::SQLITE_OPEN_URI,
        };
        let connection = Connection::open_with_flags(&self.name, mode | uri | OpenFlags::SQLITE_OPEN_NO_MUTEX)?;
        connection.busy_timeout(BUSY_TIMEOUT)?;
        connection.set_prepared_statement_cache_capacity(STATEMENTS);
        Ok(connection)
    }

    /// Describes an error, with the journal and the remedy.
    pub(super) fn describe(&self, error: &rusqlite::Error) -> String {
        format!("the journal {}: {error}: {}", self.place, remedy(error))
    }
}

/// Returns why a path cannot be a journal file; `None` if it can.
pub(super) fn no_file(path: &Path) -> Option<String> {
    path.is_dir().then(|| format!("{0} is a directory: name a file, such as {0}/journal.db", path.display()))
}

/// Error of a journal that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ReadError(pub(super) String);

fn remedy(error: &rusqlite::Error) -> &'static str {
    match error.sqlite_error_code() {
        Some(ErrorCode::DiskFull) => "make room on its disk, or limit the journal's age or size",
        Some(ErrorCode::SystemIoFailure) => "check its disk and the system log",
        Some(ErrorCode::ReadOnly | ErrorCode::PermissionDenied | ErrorCode::CannotOpen) => {
            "give this program's user write access to the file and its directory, or read a copy elsewhere"
        }
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => "stop the other program that writes to it",
        Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => {
            "replace it with an intact copy, or move the file away to begin a new journal"
        }
        _ => "if the file is damaged, replace it with an intact copy, or move the file away to begin a new journal",
    }
}
