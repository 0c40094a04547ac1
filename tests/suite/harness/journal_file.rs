//! A journal that outlasts its gateway.

use std::path::{Path, PathBuf};

/// Directory in memory. A busy disk can exceed the 500 ms after which a gateway refuses motion.
const MEMORY: &str = "/dev/shm";

const DISK: &str = env!("CARGO_TARGET_TMPDIR");

/// A journal file, removed after the test.
#[derive(Debug)]
pub struct JournalFile {
    directory: PathBuf,
}

impl JournalFile {
    /// A journal in memory, if the system allows it.
    pub fn new() -> Self {
        Self::in_directory(if Path::new(MEMORY).is_dir() { MEMORY } else { DISK })
    }

    /// A journal that can grow large.
    pub fn on_disk() -> Self {
        Self::in_directory(DISK)
    }

    fn in_directory(parent: &str) -> Self {
        let directory = Path::new(parent).join(format!("wsg-{}-{}", std::process::id(), uuid::Uuid::now_v7()));
        std::fs::create_dir(&directory).unwrap();
        Self { directory }
    }

    pub fn path(&self) -> String {
        self.directory.join("journal.db").to_str().unwrap().to_owned()
    }
}

impl Drop for JournalFile {
    fn drop(&mut self) {
        // A killed gateway may still be writing.
        let _ = std::fs::remove_dir_all(&self.directory);
    }
}
