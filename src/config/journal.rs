//! Settings of the journal: place, retention, and the treatment of motions while it cannot be written.

use std::ffi::OsString;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Duration;

use etcetera::BaseStrategy;
use toml::Spanned;

use super::{ConfigError, ConfigPlace, DEFAULT_NAME, File, Flags};
use crate::gripper::model::{Name, OnJournalFailure};

/// Highest configurable age of records, in days: a century.
const MAX_AGE_DAYS: u64 = 36_525;

/// Highest configurable file size, in MB: what SQLite can address with pages of 4 KiB.
const MAX_SIZE_MB: u64 = 16_000_000;

/// Default limit of the file size, in MB. It holds millions of records, and keeps a client that floods the gateway
/// from filling the disk.
const DEFAULT_SIZE_MB: u64 = 4096;

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JournalConfig {
    pub place: JournalPlace,
    /// Treatment of motions while the journal cannot be written.
    pub on_failure: OnJournalFailure,
    /// Age at which records are removed; `None` keeps them for ever.
    pub max_age: Option<Duration>,
    /// Size limit of the file in bytes; `None` means unlimited.
    pub max_bytes: Option<u64>,
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum JournalPlace {
    File(PathBuf),
    /// Memory, until the gateway ends.
    Memory,
}

/// Flags that select the journal that a subcommand reads.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct JournalFlags {
    /// Journal file [default: the file of the gateway named by --name]
    #[arg(long, value_name = "PATH", env = "WSG_GATEWAY_JOURNAL", global = true)]
    pub journal: Option<String>,
    /// Name of the gateway [default: gateway]
    #[arg(long, value_name = "NAME", env = "WSG_GATEWAY_NAME", global = true)]
    pub name: Option<String>,
}

impl JournalFlags {
    /// Returns the journal's file.
    ///
    /// # Errors
    /// [`ConfigError`] if the journal has no file.
    pub fn path(&self) -> Result<PathBuf, ConfigError> {
        let name = self.name.as_deref().unwrap_or(DEFAULT_NAME);
        let name = name.parse().map_err(|error| ConfigError::at(&ConfigPlace::Flag("--name"), error))?;
        match place(self.journal.as_deref(), &ConfigPlace::Flag("--journal"), &name)? {
            JournalPlace::File(path) => Ok(path),
            JournalPlace::Memory => {
                let detail = "a journal in memory can be read over HTTP only: name a file";
                Err(ConfigError::at(&ConfigPlace::Flag("--journal"), detail))
            }
        }
    }
}

impl JournalConfig {
    pub(super) fn merge(flags: &Flags, file: Option<&File>, name: &Name) -> Result<Self, ConfigError> {
        let in_file = file.and_then(|file| Some((file, file.content.journal.as_ref()?)));
        let place = match (&flags.journal, in_file) {
            (Some(path), _) => place(Some(path), &ConfigPlace::Flag("--journal"), name)?,
            (None, Some((file, path))) => place(Some(path.get_ref()), &file.place(path.span().start), name)?,
            (None, None) => place(None, &ConfigPlace::Default, name)?,
        };
        let content = file.map(|file| &file.content);
        let max_age_days = content.and_then(|content| content.journal_max_age_days.as_ref());
        let max_size_mb = content.and_then(|content| content.journal_max_size_mb.as_ref());
        let max_age_days =
            bounded(file, "journal_max_age_days", max_age_days, 1..=MAX_AGE_DAYS, "leave it out to keep everything")?;
        let remedy = "0 means unlimited";
        let max_size_mb = bounded(file, "journal_max_size_mb", max_size_mb, 0..=MAX_SIZE_MB, remedy)?;
        // A journal in memory has a limit of its own.
        let default = matches!(place, JournalPlace::File(_)).then_some(DEFAULT_SIZE_MB);
        let max_size_mb = max_size_mb.or(default).filter(|megabytes| *megabytes > 0);
        Ok(Self {
            place,
            on_failure: content.map(|content| content.on_journal_failure).unwrap_or_default(),
            max_age: max_age_days.map(|days| Duration::from_hours(days * 24)),
            max_bytes: max_size_mb.map(|megabytes| megabytes * 1_000_000),
        })
    }
}

/// Returns a number from the file, or an error if it is out of range.
pub(super) fn bounded(
    file: Option<&File>,
    key: &str,
    value: Option<&Spanned<u64>>,
    allowed: RangeInclusive<u64>,
    remedy: &str,
) -> Result<Option<u64>, ConfigError> {
    let Some((file, value)) = file.zip(value) else { return Ok(None) };
    if allowed.contains(value.get_ref()) {
        return Ok(Some(*value.get_ref()));
    }
    let (least, most) = allowed.into_inner();
    let detail = format!("{key} is {}; it must be from {least} to {most}: {remedy}", value.get_ref());
    Err(ConfigError::at(&file.place(value.span().start), detail))
}

fn place(journal: Option<&str>, said: &ConfigPlace, name: &Name) -> Result<JournalPlace, ConfigError> {
    match journal {
        Some(":memory:") => Ok(JournalPlace::Memory),
        Some("") => Err(ConfigError::at(said, "the journal's path is empty: write a path, or :memory:")),
        Some(path) => Ok(JournalPlace::File(path.into())),
        None => {
            let home = etcetera::base_strategy::Xdg::new().ok().and_then(|directories| directories.state_dir());
            let path = default_path(std::env::var_os("STATE_DIRECTORY"), home.as_deref(), name);
            let none = "HOME is not set, so the journal has no directory: pass --journal PATH or --journal :memory:";
            path.map(JournalPlace::File).ok_or_else(|| ConfigError::at(said, none))
        }
    }
}

/// Returns the path in the service's directory from systemd (the first of several), or else in the user's directory.
fn default_path(service: Option<OsString>, user: Option<&Path>, name: &Name) -> Option<PathBuf> {
    let service = service
        .filter(|directories| !directories.is_empty())
        .and_then(|directories| std::env::split_paths(&directories).next());
    let directory = service.or_else(|| Some(user?.join("wsg-gateway")))?;
    Some(directory.join(format!("{name}.db")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_is_in_service_or_user_directory() {
        let name: Name = "cell-7".parse().unwrap();
        let path = |service: Option<&str>, user: Option<&str>| {
            default_path(service.map(OsString::from), user.map(Path::new), &name)
        };
        assert_eq!(
            path(Some("/var/lib/a:/var/lib/b"), Some("/home/u/.local/state")),
            Some("/var/lib/a/cell-7.db".into())
        );
        let of_user = Some("/home/u/.local/state/wsg-gateway/cell-7.db".into());
        assert_eq!(path(None, Some("/home/u/.local/state")), of_user);
        assert_eq!(path(Some(""), Some("/home/u/.local/state")), of_user);
        assert_eq!(path(None, None), None);
    }

    #[test]
    fn subcommand_reads_only_a_file() {
        let flags = |journal: &str| JournalFlags { journal: Some(journal.to_owned()), name: None };
        assert_eq!(flags("j.db").path(), Ok("j.db".into()));
        assert!(flags(":memory:").path().unwrap_err().to_string().contains("name a file"));
        let named = JournalFlags { journal: None, name: Some("Cell 7".to_owned()) };
        assert!(named.path().unwrap_err().to_string().starts_with("--name: \"Cell 7\" is not a valid name"));
    }
}
