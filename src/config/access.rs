//! Credentials in the configuration: the file of tokens, clients by address, and TLS.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;
use toml::Spanned;

use super::journal::bounded;
use super::networks::parse_network;
use super::{ConfigError, ConfigPlace, File, Flags, GripperConfig, Placed};
use crate::access::{ClientMatch, FastStopPolicy, KnownClient, Role, Scope, SessionTimes};
use crate::gripper::model::Name;

/// Name of the file of tokens, beside the configuration file.
const DEFAULT_TOKENS: &str = "tokens.json";

/// Default time after which the session of an idle browser ends: a shift.
const DEFAULT_SESSION_IDLE: Duration = Duration::from_hours(8);

/// Longest configurable idle time of a session, in hours.
const MAX_SESSION_IDLE_H: u64 = 30 * 24;

/// Default time after which the rights of a PIN end: long enough for a task at the panel, short enough after it.
const DEFAULT_PIN_IDLE: Duration = Duration::from_mins(5);

/// Longest configurable idle time of a PIN's rights, in minutes.
const MAX_PIN_IDLE_MIN: u64 = 8 * 60;

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
    pub clients: Vec<KnownClient>,
    pub fast_stop: FastStopPolicy,
    /// Role of Zenoh clients without a token; they can read in any case.
    pub zenoh_role: Option<Role>,
    pub times: SessionTimes,
}

/// Files for TLS, in PEM.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsConfig {
    /// The server's certificate, followed by those that certify it.
    pub certificate: PathBuf,
    /// The certificate's private key.
    pub key: PathBuf,
    /// Certificates of the authorities that sign clients' certificates; clients need none if `None`.
    pub client_ca: Option<PathBuf>,
}

/// Places of the files for TLS in the configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsPlaces {
    pub certificate: ConfigPlace,
    pub key: ConfigPlace,
    /// Place of the certificate if there is none.
    pub client_ca: ConfigPlace,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AccessContent {
    tokens: Option<PathBuf>,
    fast_stop: Option<FastStopPolicy>,
    zenoh_role: Option<Role>,
    session_idle_h: Option<Spanned<u64>>,
    pin_idle_min: Option<Spanned<u64>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ClientContent {
    name: Spanned<String>,
    address: Option<Spanned<String>>,
    certificate: Option<String>,
    role: Role,
    grippers: Option<Vec<Spanned<String>>>,
}

impl ClientContent {
    pub(super) fn has_address(&self) -> bool {
        self.address.is_some()
    }

    fn grippers(&self) -> impl Iterator<Item = &Spanned<String>> {
        self.grippers.iter().flatten()
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TlsContent {
    certificate: Spanned<PathBuf>,
    key: Spanned<PathBuf>,
    client_ca: Option<Spanned<PathBuf>>,
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
        let idle = bounded(
            file,
            "session_idle_h",
            content.and_then(|content| content.session_idle_h.as_ref()),
            1..=MAX_SESSION_IDLE_H,
            "choose how long an unused browser stays signed in",
        )?;
        let pin_idle = bounded(
            file,
            "pin_idle_min",
            content.and_then(|content| content.pin_idle_min.as_ref()),
            1..=MAX_PIN_IDLE_MIN,
            "choose how long the rights of an unused PIN last",
        )?;
        let times = SessionTimes {
            idle: idle.map_or(DEFAULT_SESSION_IDLE, Duration::from_hours),
            pin_idle: pin_idle.map_or(DEFAULT_PIN_IDLE, Duration::from_mins),
        };
        Ok(Self::Guarded(Guarded {
            tokens,
            clients,
            fast_stop: content.and_then(|content| content.fast_stop).unwrap_or(default),
            zenoh_role: content.and_then(|content| content.zenoh_role),
            times,
        }))
    }
}

/// Validates the clients that are known by their addresses or certificates.
fn clients(file: &File) -> Result<Vec<KnownClient>, ConfigError> {
    let parse = |client: &ClientContent| {
        let at = |value: &Spanned<String>| file.place(value.span().start);
        let name =
            |text: &Spanned<String>| text.get_ref().parse::<Name>().map_err(|error| ConfigError::at(&at(text), error));
        let matched_by = match (&client.address, &client.certificate) {
            (Some(address), None) => ClientMatch::Address(
                parse_network(address.get_ref()).map_err(|detail| ConfigError::at(&at(address), detail))?,
            ),
            (None, Some(certificate)) if file.content.tls.as_ref().is_some_and(|tls| tls.client_ca.is_some()) => {
                ClientMatch::Certificate(certificate.clone())
            }
            (None, Some(_)) => {
                let detail =
                    "a client's certificate needs client_ca in [tls]: the certificate of the authority that signed it";
                return Err(ConfigError::at(&at(&client.name), detail));
            }
            _ => {
                let detail = "a client is known by its address or by its certificate: write one of the two";
                return Err(ConfigError::at(&at(&client.name), detail));
            }
        };
        let grippers = client.grippers.as_ref().map(|grippers| grippers.iter().map(name).collect::<Result<_, _>>());
        let scope = grippers.transpose()?.map_or(Scope::All, Scope::Only);
        Ok(KnownClient { name: name(&client.name)?, matched_by, role: client.role, scope })
    };
    file.content.clients.iter().map(parse).collect()
}

pub(super) fn tls(file: Option<&File>) -> Option<TlsConfig> {
    let (file, tls) = file.and_then(|file| Some((file, file.content.tls.as_ref()?)))?;
    let beside = |path: &Spanned<PathBuf>| file.beside(path.get_ref());
    let client_ca = tls.client_ca.as_ref().map(beside);
    Some(TlsConfig { certificate: beside(&tls.certificate), key: beside(&tls.key), client_ca })
}

pub(super) fn tls_places(file: Option<&File>) -> Option<TlsPlaces> {
    let (file, tls) = file.and_then(|file| Some((file, file.content.tls.as_ref()?)))?;
    let place = |path: &Spanned<PathBuf>| file.place(path.span().start);
    let client_ca = place(tls.client_ca.as_ref().unwrap_or(&tls.certificate));
    Some(TlsPlaces { certificate: place(&tls.certificate), key: place(&tls.key), client_ca })
}

/// Returns the names in `[[clients]]` that no gripper has. A client can wait for its gripper, so these are no errors.
pub(super) fn unknown_grippers(file: Option<&File>, grippers: &[GripperConfig]) -> Vec<ConfigError> {
    let Some(file) = file else { return Vec::new() };
    let is_unknown = |name: &&Spanned<String>| !grippers.iter().any(|gripper| gripper.name.as_str() == name.get_ref());
    let names: Vec<_> = grippers.iter().map(|gripper| gripper.name.as_str()).collect();
    let warning = |(client, name): (&ClientContent, &Spanned<String>)| {
        let (client, gripper, names) = (client.name.get_ref(), name.get_ref(), names.join(", "));
        let detail = format!("client {client} names the unknown gripper {gripper}: this gateway has {names}");
        ConfigError::at(&file.place(name.span().start), detail)
    };
    let of_client = |client| ClientContent::grippers(client).filter(is_unknown).map(move |name| (client, name));
    file.content.clients.iter().flat_map(of_client).map(warning).collect()
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
