//! The configuration, turned into the settings of the parts that a reload can change.

use std::sync::Arc;

use anyhow::anyhow;

use crate::access::{AccessRules, Guard, TokenFile, TokenFileError};
use crate::config::{self, AccessConfig, Config, ConfigError};
use crate::connections::tls::{Tls, TlsError};
use crate::interfaces::dashboard::DashboardPolicy;
use crate::interfaces::http::HttpSettings;

/// Returns the settings of HTTP for a listener on this port. Keeps the certificate in use if its files are the same.
pub(super) fn of_http(config: &Config, port: u16, before: Option<Arc<Tls>>) -> anyhow::Result<HttpSettings> {
    let tls = config.tls.clone().map(|files| match before.filter(|before| *before.files() == files) {
        Some(before) => Ok(before),
        None => Tls::new(files).map(Arc::new).map_err(|error| named(config, &error)),
    });
    Ok(HttpSettings {
        port,
        frame_policy: DashboardPolicy::of(&config.web.frame_ancestors)?,
        web: config.web.clone(),
        tls: tls.transpose()?,
    })
}

/// Adds the setting and its place in the configuration to a TLS error.
fn named(config: &Config, error: &TlsError) -> anyhow::Error {
    let named = config.tls_places.iter().find(|(path, ..)| path == error.path());
    let Some((_, key, place)) = named else { return anyhow!("{error}") };
    ConfigError::at(place, format_args!("{key}: {error}")).into()
}

/// Logs settings that are valid but probably mistaken.
pub(super) fn log_warnings(config: &Config) {
    for setting in &config.warnings {
        tracing::warn!(%setting, "setting without effect: check the gripper's name");
    }
    // Clients that are known by addresses or certificates need no tokens.
    if let AccessConfig::Guarded(guarded) = &config.access
        && guarded.clients.is_empty()
        && !guarded.tokens.exists()
    {
        let file = guarded.tokens.display();
        tracing::warn!(%file, "token file missing, so tokens are refused: create one with wsg-gateway token create");
    }
}

/// Reads the credentials of clients.
pub(super) fn of_access(config: &Config) -> Result<AccessRules, TokenFileError> {
    let AccessConfig::Guarded(guarded) = &config.access else { return Ok(AccessRules::Open) };
    let is_exposed = config.tls.is_none() && !config.listen.ip().is_loopback();
    let config::Guarded { tokens, clients, fast_stop, zenoh_role, times } = guarded.clone();
    let guard = Guard::new(TokenFile::at(tokens), clients, (fast_stop, zenoh_role), times)?;
    Ok(AccessRules::Guarded(Box::new(guard.exposed(is_exposed))))
}
