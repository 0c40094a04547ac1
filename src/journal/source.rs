//! Where a journal is, how to connect to it, and what its errors mean.

use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::{Connection, ErrorCode, OpenFlags};
use uuid::Uuid;

/// How long a connection waits for another's lock: readers of a journal in memory keep its writer waiting.
pub(super) const BUSY_TIMEOUT: Duration = Duration::from_secs(5);

/// How many prepared statements a connection keeps: each filter combination has one.
const STATEMENTS: usize = 64;

/// Where a journal is kept.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// In a file, which is made where there is none, with the directories above it.
    File(PathBuf),
    /// In memory, until the gateway ends.
    Memory,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Memory => f.write_str(":memory:"),
        }
    }
}

/// What all connections to one journal share.
#[derive(Debug, Clone)]
pub(super) struct Source {
    pub(super) place: Place,
    name: PathBuf,
}

impl Source {
    pub(super) fn new(place: Place) -> Self {
        let name = match &place {
            Place::File(path) => path.clone(),
            Place::Memory => format!("file:/wsg-gateway-{}?vfs=memdb", Uuid::now_v7()).into(),
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
            Place::File(_) => OpenFlags::empty(),
            Place::Memory => OpenFlags::SQLITE_OPEN_URI,
        };
        let connection = Connection::open_with_flags(&self.name, mode | uri | OpenFlags::SQLITE_OPEN_NO_MUTEX)?;
        connection.busy_timeout(BUSY_TIMEOUT)?;
        connection.set_prepared_statement_cache_capacity(STATEMENTS);
        Ok(connection)
    }

    /// What went wrong, and what to do about it.
    pub(super) fn words(&self, error: &rusqlite::Error) -> String {
        format!("the journal {}: {error}: {}", self.place, remedy(error))
    }
}

/// Why a path can't be a journal's file, where it can't.
pub(super) fn no_file(path: &Path) -> Option<String> {
    path.is_dir().then(|| format!("{0} is a directory: name a file, such as {0}/journal.db", path.display()))
}

/// The journal could not be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ReadError(pub(super) String);

fn remedy(error: &rusqlite::Error) -> &'static str {
    match error.sqlite_error_code() {
        Some(ErrorCode::DiskFull) => "make room on its disk, or give the journal a maximum age or size",
        Some(ErrorCode::SystemIoFailure) => "look at its disk, and at the system's log",
        Some(ErrorCode::ReadOnly | ErrorCode::PermissionDenied | ErrorCode::CannotOpen) => {
            "let the user that this runs as write the file and its directory, or read a copy of it elsewhere"
        }
        Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => "end the other program that writes it",
        Some(ErrorCode::DatabaseCorrupt | ErrorCode::NotADatabase) => {
            "put a copy of it in its place, or move the file away to begin anew"
        }
        _ => "if the file is damaged, put a copy of it in its place, or move the file away to begin anew",
    }
}
