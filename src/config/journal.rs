//! Settings of the journal: place and retention.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use etcetera::BaseStrategy;
use toml::Spanned;

use super::{Config, ConfigError, ConfigPlace, DEFAULT_NAME, File, Flags};
pub use crate::journal::JournalLocation;
use crate::model::Name;
use crate::settings::{between, optional, optional_whole, settings};

/// Default limit of the file size, in MB. It holds millions of records, and keeps a client that floods the gateway
/// from filling the disk.
const DEFAULT_SIZE_MB: u64 = 4096;

settings! {
    pub(super) struct JournalContent {
        /// Journal file, or `":memory:"`; the same as `--journal`. A relative path is relative to the working directory.
        path: Option<Spanned<String>> = "journal", optional("a path, or `\":memory:\"`", "\"/var/lib/wsg-gateway/gateway.db\"")
            .shown("see below", "\"/var/lib/wsg-gateway/gateway.db\""), Restart;
        /// Age in days after which records are removed. By default, no record is removed because of its age.
        max_age: Option<Duration> = "journal_max_age_days",
            optional_whole(365, between(1..=36_525, "leave it out to keep everything"), |days| Duration::from_hours(24 * days)), Restart;
        /// Size of the journal in MB beyond which the oldest records are removed. 0 means no limit.
        // Up to what SQLite can address with pages of 4 KiB.
        max_size_mb: Option<u64> = "journal_max_size_mb",
            optional_whole(DEFAULT_SIZE_MB, between(0..=16_000_000, "0 means unlimited"), |mb| mb)
            .shown("`4096`", "4096"), Restart;
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JournalConfig {
    pub place: JournalLocation,
    /// Age at which records are removed; `None` keeps them for ever.
    pub max_age: Option<Duration>,
    /// Size limit of the file in bytes; `None` means unlimited.
    pub max_bytes: Option<u64>,
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
    /// Configuration file of the gateway, which names its journal
    #[arg(long, value_name = "FILE", env = "WSG_GATEWAY_CONFIG", global = true)]
    pub config: Option<PathBuf>,
}

impl JournalFlags {
    /// Returns the journal's file.
    ///
    /// # Errors
    /// [`ConfigError`] if the journal has no file.
    pub fn path(&self) -> Result<PathBuf, ConfigError> {
        match self.place()? {
            JournalLocation::File(path) => Ok(path),
            JournalLocation::Memory => {
                let detail = "a journal in memory can be read over HTTP only: name a file";
                Err(ConfigError::at(&ConfigPlace::Flag("--journal"), detail))
            }
        }
    }

    fn place(&self) -> Result<JournalLocation, ConfigError> {
        if let Some(config) = self.config.clone().filter(|_| self.journal.is_none()) {
            let flags = Flags { config: Some(config), name: self.name.clone(), ..Flags::default() };
            return Ok(Config::load(&flags)?.journal.place);
        }
        let name = self.name.as_deref().unwrap_or(DEFAULT_NAME);
        let name = name.parse().map_err(|error| ConfigError::at(&ConfigPlace::Flag("--name"), error))?;
        place(self.journal.as_deref(), &ConfigPlace::Flag("--journal"), &name)
    }

    /// Whether no flag says which gateway's journal it is.
    #[must_use]
    pub fn is_default(&self) -> bool {
        self.journal.is_none() && self.name.is_none() && self.config.is_none()
    }
}

impl JournalConfig {
    pub(super) fn merge(flags: &Flags, file: &File, name: &Name) -> Result<Self, ConfigError> {
        let JournalContent { path, max_age, max_size_mb } = &file.content.journal;
        let place = match file.pick(flags.journal.as_ref(), "--journal", path.as_ref()) {
            Some(path) => place(Some(&path.value), &path.place, name)?,
            None => place(None, &ConfigPlace::Default, name)?,
        };
        // A journal in memory has a limit of its own.
        let default = matches!(place, JournalLocation::File(_)).then_some(DEFAULT_SIZE_MB);
        let max_size_mb = max_size_mb.or(default).filter(|megabytes| *megabytes > 0);
        Ok(Self { place, max_age: *max_age, max_bytes: max_size_mb.map(|megabytes| megabytes * 1_000_000) })
    }
}

fn place(journal: Option<&str>, said: &ConfigPlace, name: &Name) -> Result<JournalLocation, ConfigError> {
    match journal {
        Some(":memory:") => Ok(JournalLocation::Memory),
        Some("") => Err(ConfigError::at(said, "the journal's path is empty: write a path, or :memory:")),
        Some(path) => Ok(JournalLocation::File(path.into())),
        None => {
            let home = etcetera::base_strategy::Xdg::new().ok().and_then(|directories| directories.state_dir());
            let path = default_path(std::env::var_os("STATE_DIRECTORY"), home.as_deref(), name);
            let none = "HOME is not set, so the journal has no directory: pass --journal PATH or --journal :memory:";
            path.map(JournalLocation::File).ok_or_else(|| ConfigError::at(said, none))
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
        let file = JournalFlags { journal: Some("j.db".to_owned()), ..JournalFlags::default() };
        assert_eq!(file.path(), Ok("j.db".into()));
        let memory = JournalFlags { journal: Some(":memory:".to_owned()), ..JournalFlags::default() };
        assert!(memory.path().unwrap_err().to_string().contains("name a file"));
        let directory = std::env::temp_dir().join(format!("wsg-journal-flags-{}", std::process::id()));
        std::fs::create_dir_all(&directory).unwrap();
        let config = directory.join("gateway.toml");
        std::fs::write(&config, "journal = \"cell.db\"\n").unwrap();
        let configured = JournalFlags { config: Some(config), ..JournalFlags::default() };
        assert_eq!(configured.path(), Ok("cell.db".into()));
        std::fs::remove_dir_all(directory).unwrap();
        let named = JournalFlags { name: Some("Cell 7".to_owned()), ..JournalFlags::default() };
        assert!(named.path().unwrap_err().to_string().starts_with("--name: \"Cell 7\" is not a valid name"));
    }
}
