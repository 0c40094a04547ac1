//! Temporary files.

use std::path::{Path, PathBuf};

/// Directory in memory. A busy disk can exceed the 500 ms after which a gateway refuses motion.
const MEMORY: &str = "/dev/shm";

const DISK: &str = env!("CARGO_TARGET_TMPDIR");

/// A directory that is removed when this is dropped.
#[derive(Debug)]
pub struct Directory(PathBuf);

impl Directory {
    /// A directory in memory, if the system allows it.
    pub fn new() -> Self {
        Self::below(if Path::new(MEMORY).is_dir() { MEMORY } else { DISK })
    }

    /// A directory for files that can grow large.
    pub fn on_disk() -> Self {
        Self::below(DISK)
    }

    fn below(parent: &str) -> Self {
        let directory = Path::new(parent).join(format!("wsg-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir(&directory).unwrap();
        Self(directory)
    }

    pub fn path(&self) -> &str {
        self.0.to_str().unwrap()
    }

    /// Returns the path of a file, which need not exist.
    pub fn file(&self, name: &str) -> String {
        self.0.join(name).to_str().unwrap().to_owned()
    }

    /// Writes a file, and returns its path.
    pub fn write(&self, name: &str, text: &str) -> String {
        let path = self.file(name);
        std::fs::write(&path, text).unwrap();
        path
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        // A killed gateway may still be writing.
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
