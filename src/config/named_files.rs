//! The files that a configuration names, as a backup needs them.

use std::path::{Path, PathBuf};

use toml::Spanned;

use super::{ConfigError, File, access, zenoh};

/// Returns the configuration file, and the files that it names, whether they exist or not. Paths in Zenoh's own
/// configuration file are relative to the directory in which the gateway runs.
///
/// # Errors
/// [`ConfigError`] if the configuration cannot be read.
pub fn named_files(config: &Path) -> Result<Vec<PathBuf>, ConfigError> {
    let file = File::read(config)?;
    let content = &file.content;
    let mut named: Vec<&Path> = Vec::new();
    named.extend(access::tokens(content));
    if let Some(tls) = &content.tls {
        named.extend([&tls.certificate, &tls.key].map(path));
        named.extend(tls.client_ca.as_ref().map(path));
    }
    for webhook in &content.webhooks {
        named.extend(webhook.secret_file.iter().chain(&webhook.ca_file).map(path));
    }
    if let Some(mqtt) = &content.mqtt {
        let own = [&mqtt.password_file, &mqtt.ca_file, &mqtt.certificate_file, &mqtt.key_file];
        named.extend(own.into_iter().flatten().map(path));
    }
    let mut files = vec![config.to_owned()];
    files.extend(named.into_iter().map(|named| file.beside(named)));
    files.extend(zenoh::named_files(&file)?);
    Ok(files)
}

fn path(named: &Spanned<PathBuf>) -> &Path {
    named.get_ref()
}
