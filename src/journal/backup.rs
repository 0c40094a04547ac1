//! Copy of a journal, also while a gateway writes to it.

use std::fs::{self, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rusqlite::backup::{Backup, StepResult};
use rusqlite::{Connection, OpenFlags};

use super::identity;
use super::reading::reader::Reader;
use super::source::ReadError;

/// Pages that are copied at once: some milliseconds of reading.
const PAGES: i32 = 1024;

/// Pause while another program locks the journal.
const BUSY_FOR: Duration = Duration::from_millis(50);

/// Reason why a journal was not copied.
#[derive(Debug, thiserror::Error)]
pub enum BackupError {
    #[error(transparent)]
    Read(#[from] ReadError),
    #[error("{} exists: name a new file", .0.display())]
    Exists(PathBuf),
    #[error("{} cannot be written: {cause}", .path.display())]
    Write { path: PathBuf, cause: io::Error },
    #[error("{} cannot be written: {cause}: check its disk", .path.display())]
    Copy { path: PathBuf, cause: rusqlite::Error },
}

/// Copies a journal as it is at this moment to a new file. Calls `progress` with the copied and the total bytes.
///
/// # Errors
/// [`BackupError`]. Then nothing is written, and an existing file is unchanged.
pub fn back_up(journal: &Path, to: &Path, mut progress: impl FnMut(u64, u64)) -> Result<(), BackupError> {
    let reader = Reader::open(journal)?;
    // A crash must not leave a file that looks complete.
    let mut part = to.as_os_str().to_owned();
    part.push(".part");
    let part = PathBuf::from(part);
    if to.exists() {
        return Err(BackupError::Exists(to.to_owned()));
    }
    // Only its owner can read the copy, as with the journal.
    let created = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(&part);
    created.map_err(|cause| BackupError::Write { path: to.to_owned(), cause })?;
    let finished = match copy(reader.connection(), &part, &mut progress) {
        Ok(()) => put_in_place(&part, to).map_err(|cause| BackupError::Write { path: to.to_owned(), cause }),
        Err(cause) => Err(BackupError::Copy { path: to.to_owned(), cause }),
    };
    if finished.is_err() {
        let _ = fs::remove_file(&part);
    }
    finished
}

/// Renames the complete copy, once it is on the disk.
fn put_in_place(part: &Path, to: &Path) -> io::Result<()> {
    fs::File::open(part)?.sync_all()?;
    fs::rename(part, to)
}

fn copy(journal: &Connection, to: &Path, progress: &mut impl FnMut(u64, u64)) -> rusqlite::Result<()> {
    let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
    let mut file = Connection::open_with_flags(to, flags)?;
    let page_bytes: u64 = journal.pragma_query_value(None, "page_size", |row| row.get::<_, u32>(0))?.into();
    // One snapshot, so that the gateway's writes do not begin the copy anew.
    let snapshot = journal.unchecked_transaction()?;
    snapshot.query_row("SELECT count(*) FROM anchors", [], |_| Ok(()))?;
    let backup = Backup::new(&snapshot, &mut file)?;
    loop {
        let step = backup.step(PAGES)?;
        let left = backup.progress();
        let copied_pages = left.pagecount - left.remaining;
        progress(
            u64::from(copied_pages.unsigned_abs()) * page_bytes,
            u64::from(left.pagecount.unsigned_abs()) * page_bytes,
        );
        match step {
            StepResult::Done => break,
            StepResult::More => {}
            _ => std::thread::sleep(BUSY_FOR),
        }
    }
    drop(backup);
    identity::forget(&file)?;
    // The copy is one file, without a write-ahead log.
    file.pragma_update_and_check(None, "journal_mode", "DELETE", |_| Ok(()))
}
