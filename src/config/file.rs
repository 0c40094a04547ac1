//! The TOML file.

use std::io;
use std::path::{Path, PathBuf};

use toml::Spanned;

use super::{ConfigError, ConfigPlace, Content, Placed};
use crate::settings::{self, SettingError};

/// A parsed file, with its text for finding line numbers. The default stands for no file.
#[derive(Debug, Default)]
pub struct File {
    path: PathBuf,
    text: String,
    pub(super) content: Content,
}

impl File {
    /// # Errors
    /// [`ConfigError`] if the file cannot be read or its content is invalid.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let bytes = std::fs::read(path).map_err(|error| {
            let detail = match error.kind() {
                io::ErrorKind::NotFound => "does not exist: check the path".to_owned(),
                _ => format!("{error}: check that this is a text file that the gateway's user can read"),
            };
            ConfigError::at(&ConfigPlace::WholeFile(path.to_owned()), detail)
        })?;
        let text = String::from_utf8(bytes).map_err(|error| {
            let line = 1 + newlines(&error.as_bytes()[..error.utf8_error().valid_up_to()]);
            let detail = "this line has bytes that are not UTF-8: write its special characters again, and save the \
                          file as UTF-8";
            ConfigError::at(&ConfigPlace::File { path: path.to_owned(), line }, detail)
        })?;
        Self::parse(path, text)
    }

    /// Parses a file's text.
    ///
    /// # Errors
    /// [`ConfigError`] if the content is invalid.
    pub fn parse(path: &Path, text: String) -> Result<Self, ConfigError> {
        let content = settings::read_file(&text).map_err(|SettingError { detail, offset }| {
            let line = line_of(&text, offset);
            ConfigError::at(&ConfigPlace::File { path: path.to_owned(), line }, detail)
        })?;
        Ok(Self { path: path.to_owned(), text, content })
    }

    /// Resolves a path in the file relative to the file's directory.
    pub(super) fn beside(&self, path: &Path) -> PathBuf {
        self.path.parent().map_or_else(|| path.to_owned(), |directory| directory.join(path))
    }

    /// Place of the byte at `offset`.
    pub(super) fn place(&self, offset: usize) -> ConfigPlace {
        ConfigPlace::File { path: self.path.clone(), line: line_of(&self.text, offset) }
    }

    /// Returns the value of a flag, or else of the file, with its place.
    pub(super) fn pick<T: Clone>(
        &self,
        given: Option<&T>,
        flag: &'static str,
        in_file: Option<&Spanned<T>>,
    ) -> Option<Placed<T>> {
        if let Some(value) = given {
            return Some(Placed { value: value.clone(), place: ConfigPlace::Flag(flag) });
        }
        in_file.map(|value| Placed { value: value.get_ref().clone(), place: self.place(value.span().start) })
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    1 + newlines(&text.as_bytes()[..offset.min(text.len())])
}

fn newlines(bytes: &[u8]) -> usize {
    bytes.split(|byte| *byte == b'\n').count().saturating_sub(1)
}
