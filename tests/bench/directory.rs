//! Temporary files of a bench.

use std::path::{Path, PathBuf};

/// A directory that is removed after the bench.
pub struct Directory(pub PathBuf);

impl Directory {
    /// Creates the directory of this bench.
    pub fn new(bench: &str) -> std::io::Result<Self> {
        let directory = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{bench}-bench-{}", std::process::id()));
        std::fs::create_dir_all(&directory)?;
        Ok(Self(directory))
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}
