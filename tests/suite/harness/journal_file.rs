//! A journal that outlasts its gateway.

use super::Directory;

/// A journal file, removed after the test.
#[derive(Debug)]
pub struct JournalFile(Directory);

impl JournalFile {
    /// A journal in memory, if the system allows it.
    pub fn new() -> Self {
        Self(Directory::new())
    }

    /// A journal that can grow large.
    pub fn on_disk() -> Self {
        Self(Directory::on_disk())
    }

    pub fn path(&self) -> String {
        self.0.file("journal.db")
    }
}
