//! Detection of a journal whose file was removed, replaced or truncated while it is open.
//!
//! SQLite keeps writing to an open file that was removed: every commit succeeds, but every record is gone once the
//! process ends. So the writer compares the files at the path with those that it has open, before and after each
//! commit.

use std::io::{self, ErrorKind};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::Connection;

use super::source::JournalLocation;

/// Time between two checks of an idle journal. Each commit also checks, which takes three `stat` calls, about 3 µs.
pub(super) const CHECK_EVERY: Duration = Duration::from_secs(1);

/// The files of an open journal: the database, its write-ahead log and the log's index.
#[derive(Debug)]
pub(super) struct FilePresence {
    files: Vec<OpenFile>,
    /// The error after a truncation. It stays until the process ends, because the lost pages do not come back.
    truncated: Option<String>,
}

#[derive(Debug)]
struct OpenFile {
    path: PathBuf,
    device: u64,
    inode: u64,
    /// Size after this process wrote to it last. No other program makes it smaller.
    bytes: u64,
}

impl OpenFile {
    fn new(path: PathBuf) -> io::Result<Self> {
        let metadata = std::fs::metadata(&path)?;
        Ok(Self { path, device: metadata.dev(), inode: metadata.ino(), bytes: metadata.len() })
    }

    /// Returns the size of the file at the path, which has to be the open one.
    fn identify(&self) -> Result<u64, String> {
        let metadata = std::fs::metadata(&self.path).map_err(|error| lost(&self.path, &cause(&error)))?;
        let same = (metadata.dev(), metadata.ino()) == (self.device, self.inode);
        same.then_some(metadata.len()).ok_or_else(|| lost(&self.path, "was replaced by another file"))
    }
}

impl FilePresence {
    /// Notes the files that a connection has opened, by path: closing a second descriptor of a database would drop
    /// SQLite's own locks.
    ///
    /// # Errors
    /// Any file whose metadata cannot be read.
    pub(super) fn new(place: &JournalLocation, connection: &Connection) -> io::Result<Option<Self>> {
        let JournalLocation::File(path) = place else { return Ok(None) };
        // SQLite follows links to the database, and keeps the other two files beside it.
        let beside = connection.path().into_iter().flat_map(|real| ["-wal", "-shm"].map(|end| format!("{real}{end}")));
        let files = std::iter::once(path.clone()).chain(beside.map(PathBuf::from)).map(OpenFile::new);
        Ok(Some(Self { files: files.collect::<io::Result<_>>()?, truncated: None }))
    }

    /// Compares the files at their paths with the open ones.
    ///
    /// # Errors
    /// The file, what happened to it, and the remedy.
    pub(super) fn check(&mut self) -> Result<(), String> {
        if let Some(truncated) = &self.truncated {
            return Err(truncated.clone());
        }
        for file in &self.files {
            let bytes = file.identify()?;
            if bytes < file.bytes {
                let truncated = format!(
                    "the journal file {} was truncated from {} to {bytes} bytes: \
                     restart the gateway with an intact copy of the journal, or move its files away to begin a new one",
                    file.path.display(),
                    file.bytes
                );
                return Err(self.truncated.insert(truncated).clone());
            }
        }
        Ok(())
    }

    /// Compares the files after this process has written to them, and takes their new sizes as its own.
    ///
    /// # Errors
    /// As [`FilePresence::check`].
    pub(super) fn wrote(&mut self) -> Result<(), String> {
        let mut present = Ok(());
        for file in &mut self.files {
            match file.identify() {
                Ok(bytes) => file.bytes = bytes,
                // The other files' sizes are still noted.
                Err(lost) => present = present.and(Err(lost)),
            }
        }
        present
    }

    /// Whether a file was found truncated, which no write can repair.
    pub(super) fn is_truncated(&self) -> bool {
        self.truncated.is_some()
    }
}

fn cause(error: &io::Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => "was removed or renamed".to_owned(),
        _ => format!("cannot be checked ({error})"),
    }
}

fn lost(path: &Path, cause: &str) -> String {
    format!(
        "the journal file {} {cause} while the gateway runs, so new records would be lost: \
         put the same file back, or restart the gateway to use whatever is at this path",
        path.display()
    )
}
