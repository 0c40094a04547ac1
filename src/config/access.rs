//! Credentials in the configuration: the file of tokens, clients by address, and TLS.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use toml::Spanned;

use super::{ConfigError, ConfigPlace, Content, File, Flags, GripperConfig, Placed, blank};
use crate::access::{ClientMatch, FastStopPolicy, KnownClient, Role, Scope, SessionTimes};
use crate::connections::networks::parse_network;
use crate::connections::tls::TlsFiles;
use crate::model::Name;
use crate::settings::{flag, optional, required, settings};

/// Name of the file of tokens, beside the configuration file.
const DEFAULT_TOKENS: &str = "tokens.json";

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

settings! {
    pub(super) struct AccessContent {
        /// File of tokens, relative to the directory of the configuration file. Create it as the service's user:
        /// `sudo -u wsg-gateway wsg-gateway token create …`
        tokens: Option<PathBuf> = "tokens", optional("a path", "\"/var/lib/wsg-gateway/tokens.json\"")
            .shown("`\"tokens.json\"`", "\"/var/lib/wsg-gateway/tokens.json\""), Reload;
        /// Clients that may trigger a [FAST STOP](access.md#fast-stop): `anyone`, or those with a `credential`.
        fast_stop: Option<FastStopPolicy> = "fast_stop", optional("`\"anyone\"`, `\"credential\"`", "\"credential\"")
            .shown("`\"anyone\"` on loopback, else `\"credential\"`", "\"credential\""), Reload;
        /// Role of Zenoh clients without a token.
        zenoh_role: Option<Role> = "zenoh_role", optional("a [role](access.md#roles)", "\"observer\"")
            .shown("`\"observer\"`", "\"observer\""), Reload;
        group times: SessionTimes;
    }
}

settings! {
    pub(super) struct ClientContent {
        /// Name of the client.
        name: Spanned<String> = "name", required(blank(), "a name", "\"plc7\""), Reload;
        /// Address of the client. If several sections contain it, the first one counts.
        pub(super) address: Option<Spanned<String>> = "address",
            optional("an IP address or a network such as `192.168.1.0/24`", "\"192.168.1.10\""), Reload;
        /// Common name of the client's certificate. Needs `client_ca`.
        certificate: Option<String> = "certificate", optional("a common name", ""), Reload;
        /// Role of the client.
        role: Role = "role", required(Role::Observer, "a [role](access.md#roles)", "\"operator\""), Reload;
        /// Grippers that the client may stop, move or change.
        grippers: Option<Vec<Spanned<String>>> = "grippers",
            optional("names of grippers", "[\"left\"]").shown("all", "[\"left\"]"), Reload;
    }
}

settings! {
    pub(super) struct TlsContent {
        /// Certificate in PEM form, followed by those that certify it.
        pub(super) certificate: Spanned<PathBuf> = "certificate",
            required(blank(), "a path", "\"/etc/wsg-gateway/certificate.pem\""), Reload;
        /// Private key of the certificate, in PEM form. The file must not be readable by everyone.
        pub(super) key: Spanned<PathBuf> = "key", required(blank(), "a path", "\"/etc/wsg-gateway/key.pem\""), Reload;
        /// Certificates of the authorities that sign clients' certificates, in PEM form.
        pub(super) client_ca: Option<Spanned<PathBuf>> = "client_ca",
            optional("a path", "\"/etc/wsg-gateway/clients-ca.pem\""), Reload;
        /// Whether clients trust exactly this certificate.
        pinned: bool = "pinned", flag(false), Reload;
    }
}

/// File of tokens in a configuration file, relative to its directory; `None` if clients need no credentials.
pub(super) fn tokens(content: &Content) -> Option<&Path> {
    let access = content.access.as_ref();
    let asks = access.is_some() || !content.clients.is_empty();
    let named = access.and_then(|access| access.tokens.as_deref());
    asks.then(|| named.unwrap_or_else(|| Path::new(DEFAULT_TOKENS)))
}

impl AccessConfig {
    /// Merges the flags with the file. Clients need credentials if either mentions them.
    pub(super) fn merge(flags: &Flags, file: &File, listen: SocketAddr) -> Result<Self, ConfigError> {
        let clients = clients(file)?;
        let in_file = tokens(&file.content).map(|tokens| file.beside(tokens));
        let Some(tokens) = flags.tokens.clone().or(in_file) else { return Ok(Self::Open) };
        let default = if listen.ip().is_loopback() { FastStopPolicy::Anyone } else { FastStopPolicy::Credential };
        let AccessContent { fast_stop, zenoh_role, times, .. } = file.content.access.clone().unwrap_or_default();
        Ok(Self::Guarded(Guarded { tokens, clients, fast_stop: fast_stop.unwrap_or(default), zenoh_role, times }))
    }
}

/// Validates the clients that are known by their addresses or certificates.
fn clients(file: &File) -> Result<Vec<KnownClient>, ConfigError> {
    file.content.clients.iter().map(|client| known_client(file, client)).collect()
}

fn known_client(file: &File, client: &ClientContent) -> Result<KnownClient, ConfigError> {
    let matched_by = match (&client.address, &client.certificate) {
        (Some(address), None) => {
            let network = parse_network(address.get_ref());
            ClientMatch::Address(network.map_err(|detail| ConfigError::at(&place_of(file, address), detail))?)
        }
        (None, Some(certificate)) if file.content.tls.as_ref().is_some_and(|tls| tls.client_ca.is_some()) => {
            ClientMatch::Certificate(certificate.clone())
        }
        (None, Some(_)) => {
            let detail =
                "a client's certificate needs client_ca in [tls]: the certificate of the authority that signed it";
            return Err(ConfigError::at(&place_of(file, &client.name), detail));
        }
        _ => {
            let detail = "a client is known by its address or by its certificate: write one of the two";
            return Err(ConfigError::at(&place_of(file, &client.name), detail));
        }
    };
    let scope = match &client.grippers {
        Some(grippers) => Scope::Only(grippers.iter().map(|name| parse_name(file, name)).collect::<Result<_, _>>()?),
        None => Scope::All,
    };
    Ok(KnownClient { name: parse_name(file, &client.name)?, matched_by, role: client.role, scope })
}

fn parse_name(file: &File, text: &Spanned<String>) -> Result<Name, ConfigError> {
    text.get_ref().parse::<Name>().map_err(|error| ConfigError::at(&place_of(file, text), error))
}

fn place_of(file: &File, value: &Spanned<String>) -> ConfigPlace {
    file.place(value.span().start)
}

pub(super) fn tls(file: &File) -> Option<TlsFiles> {
    let tls = file.content.tls.as_ref()?;
    Some(TlsFiles {
        certificate: file.beside(tls.certificate.get_ref()),
        key: file.beside(tls.key.get_ref()),
        client_ca: tls.client_ca.as_ref().map(|path| file.beside(path.get_ref())),
        pinned: tls.pinned,
    })
}

pub(super) fn tls_places(file: &File) -> Vec<(PathBuf, &'static str, ConfigPlace)> {
    let Some(tls) = &file.content.tls else { return Vec::new() };
    let keys =
        [("certificate", Some(&tls.certificate)), ("key", Some(&tls.key)), ("client_ca", tls.client_ca.as_ref())];
    let mut places = Vec::new();
    for (key, path) in keys {
        if let Some(path) = path {
            places.push((file.beside(path.get_ref()), key, file.place(path.span().start)));
        }
    }
    places
}

/// Returns the names in `[[clients]]` that no gripper has. A client can wait for its gripper, so these are not errors.
pub(super) fn unknown_grippers(file: &File, grippers: &[GripperConfig]) -> Vec<ConfigError> {
    let names: Vec<_> = grippers.iter().map(|gripper| gripper.name.as_str()).collect();
    let mut warnings = Vec::new();
    for client in &file.content.clients {
        for name in client.grippers.iter().flatten().filter(|name| !names.contains(&name.get_ref().as_str())) {
            let client = client.name.get_ref();
            let gripper = name.get_ref();
            let names = names.join(", ");
            let detail = format!("client {client} names the unknown gripper {gripper}: this gateway has {names}");
            warnings.push(ConfigError::at(&file.place(name.span().start), detail));
        }
    }
    warnings
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
