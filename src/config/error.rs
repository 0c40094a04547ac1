//! Errors in a configuration, with their places.

use std::fmt;
use std::path::PathBuf;

/// Place of a setting, as errors name it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ConfigPlace {
    /// A flag or its environment variable.
    Flag(&'static str),
    /// A file that cannot be read.
    WholeFile(PathBuf),
    /// A line of a file.
    File {
        path: PathBuf,
        /// Counted from 1.
        line: usize,
    },
    /// No place: the default applies.
    Default,
}

impl fmt::Display for ConfigPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flag(flag) => f.write_str(flag),
            Self::WholeFile(path) => path.display().fmt(f),
            Self::File { path, line } => write!(f, "{}:{line}", path.display()),
            Self::Default => f.write_str("default"),
        }
    }
}

/// An error in a configuration, with its place and remedy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {detail}")]
pub struct ConfigError {
    pub place: ConfigPlace,
    /// Description with the remedy.
    pub detail: String,
}

impl ConfigError {
    pub fn at(place: &ConfigPlace, detail: impl fmt::Display) -> Self {
        Self { place: place.clone(), detail: detail.to_string() }
    }
}
