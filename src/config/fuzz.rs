//! Fuzz target of the configuration file.

use std::path::Path;

use super::{Config, File, Flags};

/// Checks that a configuration file is valid, or yields an error that names the file.
pub(crate) fn file(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let parsed = File::parse(Path::new("gateway.toml"), text.to_owned());
    if let Err(error) = parsed.and_then(|file| Config::merge(&Flags::default(), Some(&file))) {
        assert!(error.to_string().contains("gateway.toml"), "{error}");
    }
}
