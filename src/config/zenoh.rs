//! Settings of Zenoh. They override Zenoh's own configuration file, if one is given. By default the gateway stays on
//! loopback and scouts for nothing.

use std::path::PathBuf;

use serde::Deserialize;
use serde_json::{Value, json};
use toml::Spanned;
use zenoh::config::{EndPoint, WhatAmI};

use super::{ConfigError, ConfigPlace, File, Flags};
use crate::settings::{between, optional, settings, whole};
use crate::transport::host::check_host;

/// Default endpoint to listen on.
const DEFAULT_LISTEN: &str = "tcp/127.0.0.1:7447";

/// Largest message that Zenoh accepts, in bytes: 2 MiB as over HTTP, and the rest of the message around them. Requests
/// have 64 KiB at most, and a larger one within this limit is refused with a problem. Zenoh drops a still larger one
/// silently.
const MAX_MESSAGE_BYTES: u64 = (2048 + 64) * 1024;

/// Silence after which others count this gateway as gone, in ms: a fleet shows the loss within 2 s.
const LEASE_MS: u64 = 1500;

/// Time that a droppable message waits for a place in the queue, in µs: none, since newer messages follow.
const DROPPED_AFTER_US: u64 = 0;

/// Time that any other message waits for a place before its receiver counts as gone, in µs.
const CLOSED_AFTER_US: u64 = 1_000_000;

/// Size of a connection's socket buffer in each direction, in bytes. Its content leaves before a FAST STOP, whatever
/// the priority.
const SOCKET_BYTES: u64 = 64 * 1024;

/// Maximum number of connected clients and routers.
const MAX_SESSIONS: u64 = 256;

/// Protocols that this build supports.
const PROTOCOLS: &[&str] = &["quic", "tcp", "tls"];

/// Role of the gateway on a Zenoh network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum ZenohMode {
    /// No Zenoh
    Off,
    /// Clients connect to the gateway
    Peer,
    /// The gateway connects to a router, and accepts no connections
    Client,
    /// Clients and routers connect to the gateway, and the gateway connects to routers; all can reach each other
    Router,
}

impl ZenohMode {
    fn role(self) -> Option<WhatAmI> {
        match self {
            Self::Off => None,
            Self::Peer => Some(WhatAmI::Peer),
            Self::Client => Some(WhatAmI::Client),
            Self::Router => Some(WhatAmI::Router),
        }
    }
}

/// Flags and environment variables for Zenoh.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct ZenohFlags {
    /// Role on the Zenoh network [default: peer, or router if the gateway connects to others]
    #[arg(long, value_name = "MODE", env = "WSG_GATEWAY_ZENOH_MODE", value_enum)]
    pub zenoh_mode: Option<ZenohMode>,
    /// Zenoh endpoint to listen on (repeatable) [default: tcp/127.0.0.1:7447]
    #[arg(long, value_name = "ENDPOINT", env = "WSG_GATEWAY_ZENOH_LISTEN", value_delimiter = ',')]
    pub zenoh_listen: Vec<String>,
    /// Zenoh endpoint to connect to, e.g. tcp/127.0.0.1:7448 (repeatable)
    #[arg(long, value_name = "ENDPOINT", env = "WSG_GATEWAY_ZENOH_CONNECT", value_delimiter = ',')]
    pub zenoh_connect: Vec<String>,
}

settings! {
    pub(super) struct ZenohContent {
        /// Role on the Zenoh network: `off`, `peer`, `client` or `router`.
        mode: Option<ZenohMode> = "mode", optional("`\"off\"`, `\"peer\"`, `\"client\"`, `\"router\"`", "")
            .shown("`\"peer\"`, or `\"router\"` if `connect` is set", "\"peer\""), Restart;
        /// Endpoints to listen on; the same as `--zenoh-listen`. A `client` does not listen by default.
        listen: Option<Spanned<Vec<String>>> = "listen", optional("`tcp/…` or `quic/…` endpoints", "")
            .shown("`[\"tcp/127.0.0.1:7447\"]`", "[\"tcp/127.0.0.1:7447\"]"), Restart;
        /// Endpoints to connect to; the same as `--zenoh-connect`. A `client` needs at least one.
        connect: Option<Spanned<Vec<String>>> = "connect",
            optional("`tcp/…` or `quic/…` endpoints", "").shown("`[]`", "[]"), Restart;
        /// Zenoh's own configuration file, for encryption and access control.
        config: Option<Spanned<PathBuf>> = "config", optional("a path", "\"zenoh.json5\""), Restart;
        /// Highest rate, per second, at which the state and the telemetry of a gripper are published.
        // Not above the rate of the devices' updates.
        max_hz: u32 = "max_hz", whole(50, between(1..=100, ""), |hz| hz as u32), Restart;
    }
}

#[derive(Debug, Clone)]
pub struct Zenoh {
    /// Zenoh's own configuration.
    pub settings: zenoh::Config,
    pub listen: Vec<String>,
    pub connect: Vec<String>,
    /// Limit of published states and telemetry, per second and gripper.
    pub max_hz: u32,
}

impl PartialEq for Zenoh {
    fn eq(&self, other: &Self) -> bool {
        // The endpoints are a part of the settings.
        let Self { settings, listen: _, connect: _, max_hz } = self;
        *max_hz == other.max_hz && settings.to_string() == other.settings.to_string()
    }
}

impl Zenoh {
    /// Returns `None` if Zenoh is off.
    pub(super) fn merge(flags: &Flags, file: &File, insecure: bool) -> Result<Option<Self>, ConfigError> {
        let content = file.content.zenoh.clone().unwrap_or_default();
        let flags = &flags.zenoh;
        let base = Base::read(file)?;
        let listen = pick(file, "--zenoh-listen", &flags.zenoh_listen, content.listen.as_ref());
        let connect = pick(file, "--zenoh-connect", &flags.zenoh_connect, content.connect.as_ref());
        // Peers forward nothing between each other, so a gateway that connects to others is a router by default.
        let default = if connect.is_some() { WhatAmI::Router } else { WhatAmI::Peer };
        let mode = match flags.zenoh_mode.or(content.mode) {
            Some(mode) => mode.role(),
            None => Some(base.mode().unwrap_or(default)),
        };
        let Some(mode) = mode else { return Ok(None) };
        let mut settings = base.settings.clone();
        set(&mut settings, "mode", &json!(mode.to_str()), &base.place)?;
        let default_listen = if mode == WhatAmI::Client { vec![] } else { vec![DEFAULT_LISTEN.to_owned()] };
        let listen = endpoints(listen, &base, "listen/endpoints", mode, default_listen)?;
        let connect = endpoints(connect, &base, "connect/endpoints", mode, Vec::new())?;
        if mode == WhatAmI::Client && connect.0.is_empty() {
            let detail =
                "a Zenoh client needs a router or a peer: name it with --zenoh-connect, e.g. tcp/127.0.0.1:7447";
            return Err(ConfigError::at(&base.place, detail));
        }
        set(&mut settings, "listen/endpoints", &json!(listen.0), &listen.1)?;
        set(&mut settings, "connect/endpoints", &json!(connect.0), &connect.1)?;
        for (key, value) in defaults() {
            if base.leaves_out(key) {
                set(&mut settings, key, &value, &base.place)?;
            }
        }
        let zenoh = Self { max_hz: content.max_hz, settings, listen: listen.0.clone(), connect: connect.0.clone() };
        if !insecure && !zenoh.asks_for_credentials() {
            zenoh.check_loopback([&listen, &connect], &base.place)?;
        }
        Ok(Some(zenoh))
    }

    fn setting(&self, key: &str) -> Value {
        setting(&self.settings, key)
    }

    /// Whether access control denies by default, or mutual TLS protects all exposed endpoints.
    fn asks_for_credentials(&self) -> bool {
        let mut exposed = self.listen.iter().chain(&self.connect).filter(|endpoint| !is_loopback(endpoint));
        let mutual_tls = self.setting("transport/link/tls/enable_mtls") == true;
        let denies = self.setting("access_control/default_permission") == "deny";
        (self.setting("access_control/enabled") == true && denies)
            || (mutual_tls && exposed.all(|endpoint| keeps_mutual_tls(endpoint)) && self.looks_for().is_none())
    }

    /// Returns the endpoints whose links Zenoh 1.10 can break: it reads and writes one TLS connection in two threads
    /// without a shared lock (eclipse-zenoh/zenoh issue 2557). QUIC is not affected.
    pub fn tls_endpoints(&self) -> Vec<&str> {
        let all = self.listen.iter().chain(&self.connect).map(String::as_str);
        all.filter(|endpoint| has_protocol(endpoint, &["tls"])).collect()
    }

    /// Returns the UDP ports that the gateway listens on for Zenoh.
    #[must_use]
    pub fn udp_ports(&self) -> Vec<u16> {
        let quic = self.listen.iter().filter(|endpoint| has_protocol(endpoint, &["quic"]));
        let addresses = quic.filter_map(|endpoint| endpoint.parse::<EndPoint>().ok());
        addresses.filter_map(|parsed| parsed.address().as_str().rsplit_once(':')?.1.parse().ok()).collect()
    }

    /// Returns the setting by which Zenoh finds others whose addresses are not configured, if one is on.
    fn looks_for(&self) -> Option<&'static str> {
        let multicast = "scouting/multicast/enabled";
        let gossip = "scouting/gossip/autoconnect";
        if self.setting(multicast) == true {
            return Some(multicast);
        }
        (!texts(&self.setting(gossip)).concat().is_empty()).then_some(gossip)
    }

    fn check_loopback(
        &self,
        endpoints: [&(Vec<String>, ConfigPlace); 2],
        place: &ConfigPlace,
    ) -> Result<(), ConfigError> {
        let exposed = endpoints.into_iter().flat_map(|(endpoints, place)| endpoints.iter().map(move |e| (e, place)));
        let exposed =
            exposed.map(|(endpoint, place)| (endpoint.as_str(), place)).find(|(endpoint, _)| !is_loopback(endpoint));
        let Some((what, place)) = exposed.or_else(|| Some((self.looks_for()?, place))) else { return Ok(()) };
        let detail = format!(
            "{what} reaches beyond loopback, and clients need no credentials: any client on that Zenoh network can \
             move the grippers. Set [zenoh] config to a Zenoh configuration with mutual TLS, or with access_control that \
             denies by default, or pass --insecure if the network is yours alone"
        );
        Err(ConfigError::at(place, detail))
    }
}

/// Returns Zenoh's own configuration file, and the certificates, keys and passwords that it names.
pub(super) fn named_files(file: &File) -> Result<Vec<PathBuf>, ConfigError> {
    let Some(config) = file.content.zenoh.as_ref().and_then(|zenoh| zenoh.config.as_ref()) else {
        return Ok(Vec::new());
    };
    let base = Base::read(file)?;
    let keys = [
        "link/tls/root_ca_certificate",
        "link/tls/listen_certificate",
        "link/tls/listen_private_key",
        "link/tls/connect_certificate",
        "link/tls/connect_private_key",
        "auth/usrpwd/dictionary_file",
        "auth/pubkey/public_key_file",
        "auth/pubkey/private_key_file",
        "auth/pubkey/known_keys_file",
    ];
    let named = keys.map(|key| setting(&base.settings, &format!("transport/{key}")));
    let named = named.iter().filter_map(Value::as_str).map(PathBuf::from);
    Ok(std::iter::once(file.beside(config.get_ref())).chain(named).collect())
}

/// Zenoh's own configuration file, or Zenoh's defaults.
struct Base {
    settings: zenoh::Config,
    place: ConfigPlace,
}

impl Base {
    fn read(file: &File) -> Result<Self, ConfigError> {
        let Some(path) = file.content.zenoh.as_ref().and_then(|zenoh| zenoh.config.as_ref()) else {
            return Ok(Self { settings: zenoh::Config::default(), place: ConfigPlace::Flag("--zenoh-mode") });
        };
        let place = file.place(path.span().start);
        let path = file.beside(path.get_ref());
        let settings = zenoh::Config::from_file(&path).map_err(|error| {
            ConfigError::at(&place, format!("{} is not a valid Zenoh configuration: {error}", path.display()))
        })?;
        Ok(Self { settings, place })
    }

    fn mode(&self) -> Option<WhatAmI> {
        setting(&self.settings, "mode").as_str()?.parse().ok()
    }

    /// Whether the file leaves the key out, or sets it to Zenoh's default.
    fn leaves_out(&self, key: &str) -> bool {
        let here = setting(&self.settings, key);
        here.is_null() || here == setting(&zenoh::Config::default(), key)
    }
}

/// The gateway's own defaults. With Zenoh's, it would scout for others, accept messages of 1 GiB, fail to start if a
/// port is taken, and notice only after 10 s that a gateway is gone.
fn defaults() -> [(&'static str, Value); 16] {
    [
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/autoconnect", json!({"router": [], "peer": [], "client": []})),
        ("listen/exit_on_failure", json!(false)),
        ("listen/timeout_ms", json!(-1)),
        ("listen/retry", json!({"period_init_ms": 250, "period_max_ms": 2000, "period_increase_factor": 2})),
        ("connect/exit_on_failure", json!(false)),
        ("connect/timeout_ms", json!(-1)),
        ("connect/retry", json!({"period_init_ms": 250, "period_max_ms": 2000, "period_increase_factor": 2})),
        ("transport/link/tcp/so_rcvbuf", json!(SOCKET_BYTES)),
        ("transport/link/tcp/so_sndbuf", json!(SOCKET_BYTES)),
        ("transport/link/rx/max_message_size", json!(MAX_MESSAGE_BYTES)),
        ("qos/network", json!([fast_stops_first()])),
        ("transport/unicast/max_sessions", json!(MAX_SESSIONS)),
        ("transport/link/tx/lease", json!(LEASE_MS)),
        ("transport/link/tx/queue/congestion_control/drop/wait_before_drop", json!(DROPPED_AFTER_US)),
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", json!(CLOSED_AFTER_US)),
    ]
}

/// Rule that puts any FAST STOP, for this gateway or another, before all else, whatever priority its sender chose.
fn fast_stops_first() -> Value {
    json!({
        "messages": ["put", "query"],
        "key_exprs": [
            "wsg/v1/fast-stop",
            "wsg/v1/*/fast-stop",
            "wsg/v1/*/*/command/fast-stop",
            "wsg/v1/*/command/fast-stop",
            "wsg/v1/*/command/fleet.fast-stop",
        ],
        "overwrite": {"priority": "real_time", "congestion_control": "block", "express": true},
        "flows": ["ingress", "egress"],
    })
}

fn set(settings: &mut zenoh::Config, key: &str, value: &Value, place: &ConfigPlace) -> Result<(), ConfigError> {
    let result = settings.insert_json5(key, &value.to_string());
    result.map_err(|error| ConfigError::at(place, format!("{key}: {error}")))
}

fn setting(settings: &zenoh::Config, key: &str) -> Value {
    settings.get_json(key).ok().and_then(|json| serde_json::from_str(&json).ok()).unwrap_or_default()
}

/// Returns the endpoints of a flag, or else of the file, with their place.
fn pick(
    file: &File,
    flag: &'static str,
    given: &[String],
    in_file: Option<&Spanned<Vec<String>>>,
) -> Option<(Vec<String>, ConfigPlace)> {
    let given = (!given.is_empty()).then(|| given.to_vec());
    let picked = file.pick(given.as_ref(), flag, in_file)?;
    Some((picked.value, picked.place))
}

/// Returns the given endpoints, or those of Zenoh's own file, or else the default ones; and their place.
fn endpoints(
    given: Option<(Vec<String>, ConfigPlace)>,
    base: &Base,
    key: &str,
    mode: WhatAmI,
    default: Vec<String>,
) -> Result<(Vec<String>, ConfigPlace), ConfigError> {
    let (endpoints, place) = match given {
        Some(given) => given,
        None if base.leaves_out(key) => (default, base.place.clone()),
        None => {
            let all = setting(&base.settings, key);
            let of_mode = all.get(mode.to_str()).unwrap_or(&all);
            // A group of endpoints also contains the name of a strategy.
            (texts(of_mode).into_iter().filter(|text| text.contains('/')).collect(), base.place.clone())
        }
    };
    for endpoint in &endpoints {
        if !has_protocol(endpoint, PROTOCOLS) || has_spaces(endpoint) {
            let detail =
                format!("{endpoint:?} is not a Zenoh endpoint: write {DEFAULT_LISTEN} or quic/cell-7.example:7447");
            return Err(ConfigError::at(&place, detail));
        }
        if let Some(error) = host_of(endpoint).and_then(|host| check_host(&host).err()) {
            return Err(ConfigError::at(&place, format!("the Zenoh endpoint {endpoint:?} has the host {error}")));
        }
    }
    Ok((endpoints, place))
}

/// Whether an endpoint's address has spaces. Paths in its parameters can have some.
fn has_spaces(endpoint: &str) -> bool {
    endpoint.parse::<EndPoint>().is_ok_and(|parsed| parsed.address().as_str().contains(char::is_whitespace))
}

/// All strings in a value, at any depth.
fn texts(value: &Value) -> Vec<String> {
    match value {
        Value::String(text) => vec![text.clone()],
        Value::Array(items) => items.iter().flat_map(texts).collect(),
        Value::Object(members) => members.values().flat_map(texts).collect(),
        _ => Vec::new(),
    }
}

/// Host name or IPv4 address of an endpoint.
fn host_of(endpoint: &str) -> Option<String> {
    let endpoint: EndPoint = endpoint.parse().ok()?;
    let (host, _port) = endpoint.address().as_str().rsplit_once(':')?;
    (!host.starts_with('[')).then(|| host.to_owned())
}

fn has_protocol(endpoint: &str, protocols: &[&str]) -> bool {
    endpoint.parse::<EndPoint>().is_ok_and(|parsed| protocols.contains(&parsed.protocol().as_str()))
}

/// Whether links of this endpoint use `transport/link/tls`, and its own parameters do not switch mutual TLS off.
fn keeps_mutual_tls(endpoint: &str) -> bool {
    let Ok(parsed) = endpoint.parse::<EndPoint>() else { return false };
    let keeps_on = parsed.config().get("enable_mtls").is_none_or(|value| value == "true");
    keeps_on && has_protocol(endpoint, &["quic", "tls"])
}

fn is_loopback(endpoint: &str) -> bool {
    let Ok(endpoint) = endpoint.parse::<EndPoint>() else { return false };
    let address = endpoint.address();
    match address.as_str().parse::<std::net::SocketAddr>() {
        Ok(address) => address.ip().is_loopback(),
        Err(_) => address.as_str().rsplit_once(':').is_some_and(|(host, _)| host == "localhost"),
    }
}

#[cfg(test)]
#[path = "zenoh_tests.rs"]
mod tests;
