//! Settings of Zenoh. They override Zenoh's own configuration file, if one is given. By default the gateway stays on
//! loopback and scouts for nothing.

use std::path::PathBuf;

use serde::Deserialize;
use serde_json::{Value, json};
use toml::Spanned;
use zenoh::config::{EndPoint, WhatAmI};

use super::{ConfigError, ConfigPlace, File, Flags};
use crate::transport::host::check_host;

/// Default endpoint to listen on.
const DEFAULT_LISTEN: &str = "tcp/127.0.0.1:7447";

/// Default limit of published states and telemetry, per second and gripper.
const DEFAULT_HZ: u64 = 50;

/// Highest configurable limit: the rate of the devices' updates.
const MAX_HZ: u64 = 100;

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

/// The `[zenoh]` section of a file.
#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct ZenohContent {
    mode: Option<ZenohMode>,
    listen: Option<Spanned<Vec<String>>>,
    connect: Option<Spanned<Vec<String>>>,
    config: Option<Spanned<PathBuf>>,
    max_hz: Option<Spanned<u64>>,
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
        let all = |zenoh: &Self| (zenoh.settings.to_string(), zenoh.max_hz);
        all(self) == all(other)
    }
}

impl Zenoh {
    /// Returns `None` if Zenoh is off.
    pub(super) fn merge(flags: &Flags, file: Option<&File>, insecure: bool) -> Result<Option<Self>, ConfigError> {
        let content = file.map(|file| (file, &file.content.zenoh));
        let flags = &flags.zenoh;
        let base = Base::read(content)?;
        let of_file = |pick: fn(&ZenohContent) -> &Option<Spanned<Vec<String>>>| {
            let (file, content) = content?;
            let endpoints = pick(content).as_ref()?;
            Some((endpoints.get_ref().clone(), file.place(endpoints.span().start)))
        };
        let given = |flag: &'static str, given: &[String], in_file| match given {
            [] => in_file,
            given => Some((given.to_vec(), ConfigPlace::Flag(flag))),
        };
        let listen = given("--zenoh-listen", &flags.zenoh_listen, of_file(|content| &content.listen));
        let connect = given("--zenoh-connect", &flags.zenoh_connect, of_file(|content| &content.connect));
        // Peers forward nothing between each other, so a gateway that connects to others is a router by default.
        let default = if connect.is_some() { WhatAmI::Router } else { WhatAmI::Peer };
        let mode = match flags.zenoh_mode.or_else(|| content.and_then(|(_, content)| content.mode)) {
            Some(mode) => mode.role(),
            None => Some(base.mode().unwrap_or(default)),
        };
        let Some(mode) = mode else { return Ok(None) };
        let mut settings = base.settings.clone();
        let mut set = |key: &str, value: Value, place: &ConfigPlace| {
            settings
                .insert_json5(key, &value.to_string())
                .map_err(|error| ConfigError::at(place, format!("{key}: {error}")))
        };
        set("mode", json!(mode.to_str()), &base.place)?;
        let default_listen = if mode == WhatAmI::Client { vec![] } else { vec![DEFAULT_LISTEN.to_owned()] };
        let listen = endpoints(listen, &base, "listen/endpoints", mode, default_listen)?;
        let connect = endpoints(connect, &base, "connect/endpoints", mode, Vec::new())?;
        if mode == WhatAmI::Client && connect.0.is_empty() {
            let detail =
                "a Zenoh client needs a router or a peer: name it with --zenoh-connect, e.g. tcp/127.0.0.1:7447";
            return Err(ConfigError::at(&base.place, detail));
        }
        set("listen/endpoints", json!(listen.0), &listen.1)?;
        set("connect/endpoints", json!(connect.0), &connect.1)?;
        for (key, value) in defaults() {
            if base.leaves_out(key) {
                set(key, value, &base.place)?;
            }
        }
        let zenoh = Self { max_hz: max_hz(content)?, settings, listen: listen.0.clone(), connect: connect.0.clone() };
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
        let (multicast, gossip) = ("scouting/multicast/enabled", "scouting/gossip/autoconnect");
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

/// Zenoh's own configuration file, or Zenoh's defaults.
struct Base {
    settings: zenoh::Config,
    place: ConfigPlace,
}

impl Base {
    fn read(content: Option<(&File, &ZenohContent)>) -> Result<Self, ConfigError> {
        let given = content.and_then(|(file, content)| Some((file, content.config.as_ref()?)));
        let Some((file, path)) = given else {
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

fn setting(settings: &zenoh::Config, key: &str) -> Value {
    settings.get_json(key).ok().and_then(|json| serde_json::from_str(&json).ok()).unwrap_or_default()
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
        // Paths in its parameters can have spaces.
        let has_spaces = |parsed: EndPoint| parsed.address().as_str().contains(char::is_whitespace);
        if !has_protocol(endpoint, PROTOCOLS) || endpoint.parse().is_ok_and(has_spaces) {
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
    let own = |endpoint: EndPoint| endpoint.config().get("enable_mtls").is_none_or(|value| value == "true");
    has_protocol(endpoint, &["quic", "tls"]) && endpoint.parse().is_ok_and(own)
}

fn is_loopback(endpoint: &str) -> bool {
    let Ok(endpoint) = endpoint.parse::<EndPoint>() else { return false };
    let address = endpoint.address();
    match address.as_str().parse::<std::net::SocketAddr>() {
        Ok(address) => address.ip().is_loopback(),
        Err(_) => address.as_str().rsplit_once(':').is_some_and(|(host, _)| host == "localhost"),
    }
}

fn max_hz(content: Option<(&File, &ZenohContent)>) -> Result<u32, ConfigError> {
    let given = content.and_then(|(file, content)| Some((file, content.max_hz.as_ref()?)));
    let Some((file, max_hz)) = given else { return Ok(DEFAULT_HZ as u32) };
    if (1..=MAX_HZ).contains(max_hz.get_ref()) {
        return Ok(*max_hz.get_ref() as u32);
    }
    let detail = format!("max_hz is {}; it must be from 1 to {MAX_HZ}", max_hz.get_ref());
    Err(ConfigError::at(&file.place(max_hz.span().start), detail))
}

#[cfg(test)]
#[path = "zenoh_tests.rs"]
mod tests;
