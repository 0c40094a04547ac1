//! The configuration, turned into the settings of the parts that a reload can change.

use std::sync::Arc;

use crate::access::{AccessRules, Guard, TokenFile, TokenFileError};
use crate::config::{self, AccessConfig, Config, TlsConfig};
use crate::interfaces::dashboard::DashboardPolicy;
use crate::interfaces::http::HttpSettings;
use crate::interfaces::tls::{Tls, TlsFiles};

/// Returns the settings of HTTP. Keeps the certificate in use if its files are the same.
pub(super) fn of_http(config: &Config, before: Option<Arc<Tls>>) -> anyhow::Result<HttpSettings> {
    let tls = config.tls.clone().map(|TlsConfig { certificate, key, client_ca }| {
        let files = TlsFiles { certificate, key, client_ca };
        match before.filter(|before| *before.files() == files) {
            Some(before) => Ok(before),
            None => Tls::new(files).map(Arc::new),
        }
    });
    Ok(HttpSettings {
        allowed_hosts: config.hosts.clone(),
        cors_origins: config.cors_origins.clone(),
        frame_policy: DashboardPolicy::of(&config.frame_ancestors)?,
        tls: tls.transpose()?,
        idle_time: config.idle_timeout,
    })
}

/// Reads the credentials of clients.
pub(super) fn of_access(config: &Config) -> Result<AccessRules, TokenFileError> {
    let AccessConfig::Guarded(guarded) = &config.access else { return Ok(AccessRules::Open) };
    let is_exposed = config.tls.is_none() && !config.listen.ip().is_loopback();
    let config::Guarded { tokens, clients, fast_stop, zenoh_role, times } = guarded.clone();
    let guard = Guard::new(TokenFile::at(tokens), clients, (fast_stop, zenoh_role), times)?;
    Ok(AccessRules::Guarded(Box::new(guard.exposed(is_exposed))))
}
