//! Credentials in the configuration: the file of tokens, clients by address, and TLS.

use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;

use ipnet::IpNet;
use serde::Deserialize;
use toml::Spanned;

use super::{ConfigError, File, Flags, Placed};
use crate::access::{AddressClient, FastStopPolicy, Role, Scope};
use crate::gripper::model::Name;

/// Name of the file of tokens, beside the configuration file.
const DEFAULT_TOKENS: &str = "tokens.json";

/// Default time after which the session of an idle browser ends: a shift.
const DEFAULT_SESSION_IDLE: Duration = Duration::from_hours(8);

/// Longest configurable idle time of a session, in hours.
const MAX_SESSION_IDLE_H: u64 = 30 * 24;

/// Whether clients need credentials.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum AccessConfig {
    Open,
    Guarded(Guarded),
}

/// Credentials that clients need.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Guarded {
    /// File of tokens.
    pub tokens: PathBuf,
    pub clients: Vec<AddressClient>,
    pub fast_stop: FastStopPolicy,
    /// Role of Zenoh clients without a token; they can read in any case.
    pub zenoh_role: Option<Role>,
    pub session_idle: Duration,
}

/// Files for TLS, in PEM.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsConfig {
    /// The server's certificate, followed by those that certify it.
    pub certificate: PathBuf,
    /// The certificate's private key.
    pub key: PathBuf,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AccessContent {
    tokens: Option<PathBuf>,
    fast_stop: Option<FastStopPolicy>,
    zenoh_role: Option<Role>,
    session_idle_h: Option<Spanned<u64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ClientContent {
    name: Spanned<String>,
    address: Spanned<String>,
    role: Role,
    grippers: Option<Vec<Spanned<String>>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TlsContent {
    certificate: PathBuf,
    key: PathBuf,
}

impl AccessConfig {
    /// Merges the flags with the file. Clients need credentials if either mentions them.
    pub(super) fn merge(flags: &Flags, file: Option<&File>, listen: SocketAddr) -> Result<Self, ConfigError> {
        let content = file.and_then(|file| file.content.access.as_ref());
        let clients = file.map(clients).transpose()?.unwrap_or_default();
        let in_file = file.filter(|_| content.is_some() || !clients.is_empty()).map(|file| {
            let tokens = content.and_then(|content| content.tokens.clone());
            file.beside(&tokens.unwrap_or_else(|| DEFAULT_TOKENS.into()))
        });
        let Some(tokens) = flags.tokens.clone().or(in_file) else { return Ok(Self::Open) };
        let default = if listen.ip().is_loopback() { FastStopPolicy::Anyone } else { FastStopPolicy::Credential };
        let session_idle_h = file.zip(content.and_then(|content| content.session_idle_h.as_ref()));
        let session_idle = match session_idle_h {
            None => DEFAULT_SESSION_IDLE,
            Some((_, hours)) if (1..=MAX_SESSION_IDLE_H).contains(hours.get_ref()) => {
                Duration::from_hours(*hours.get_ref())
            }
            Some((file, hours)) => {
                let detail =
                    format!("session_idle_h is {}; it must be from 1 to {MAX_SESSION_IDLE_H}", hours.get_ref());
                return Err(ConfigError::at(&file.place(hours.span().start), detail));
            }
        };
        Ok(Self::Guarded(Guarded {
            tokens,
            clients,
            fast_stop: content.and_then(|content| content.fast_stop).unwrap_or(default),
            zenoh_role: content.and_then(|content| content.zenoh_role),
            session_idle,
        }))
    }
}

/// Validates the clients that are known by their addresses.
fn clients(file: &File) -> Result<Vec<AddressClient>, ConfigError> {
    let parse = |client: &ClientContent| {
        let at = |value: &Spanned<String>| file.place(value.span().start);
        let name =
            |text: &Spanned<String>| text.get_ref().parse::<Name>().map_err(|error| ConfigError::at(&at(text), error));
        let address = client.address.get_ref();
        let network =
            address.parse::<IpNet>().or_else(|_| address.parse::<IpAddr>().map(IpNet::from)).map_err(|_| {
                let detail =
                    format!("{address:?} is not an address or a network: write 192.168.1.10 or 192.168.1.0/24");
                ConfigError::at(&at(&client.address), detail)
            })?;
        let grippers = client.grippers.as_ref().map(|grippers| grippers.iter().map(name).collect::<Result<_, _>>());
        let scope = grippers.transpose()?.map_or(Scope::All, Scope::Only);
        Ok(AddressClient { name: name(&client.name)?, network, role: client.role, scope })
    };
    file.content.clients.iter().map(parse).collect()
}

pub(super) fn tls(file: Option<&File>) -> Option<TlsConfig> {
    let (file, tls) = file.and_then(|file| Some((file, file.content.tls.as_ref()?)))?;
    Some(TlsConfig { certificate: file.beside(&tls.certificate), key: file.beside(&tls.key) })
}

/// Checks that clients on an address other than loopback need credentials, which are not sent in the clear.
pub(super) fn check_exposure(
    listen: &Placed<SocketAddr>,
    access: &AccessConfig,
    has_tls: bool,
    insecure_http: bool,
) -> Result<(), ConfigError> {
    let Placed { value: address, place } = listen;
    let detail = match access {
        _ if address.ip().is_loopback() => return Ok(()),
        AccessConfig::Open => format!(
            "{address} is not a loopback address, and clients need no credentials: any client that reaches it can move \
             the grippers. \"wsg-gateway init --listen {address} DIR\" writes a configuration with TLS and tokens. If the \
             network is yours alone, pass --insecure instead"
        ),
        AccessConfig::Guarded(_) if !has_tls && !insecure_http => format!(
            "{address} is not a loopback address, and without TLS anyone on the network can read the tokens: add \
             [tls], or set insecure_http = true if the network is yours alone"
        ),
        AccessConfig::Guarded(_) => return Ok(()),
    };
    Err(ConfigError::at(place, detail))
}

#[cfg(test)]
#[path = "access_tests.rs"]
mod tests;
