//! The configuration. A flag overrides the environment, which overrides the file.
//!
//! Everything is validated once, here; nothing else reads flags, the environment or the file. An error names its place
//! and its remedy.

use std::collections::BTreeSet;
use std::fmt;
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;
use toml::Spanned;
use url::Url;

use crate::gripper::model::{
    CustomIds, LeaseRules, Name, OnJournalFailure, OnLossHolding, OnLossMoving, UpdateMode, UpdateRules,
};
use crate::transport::Address;
use crate::wear::DriftLimits;
use crate::webhooks::WebhookSettings;

mod access;
mod drift;
mod error;
mod file;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;
mod hosts;
mod journal;
mod modbus;
mod networks;
mod public_url;
mod webhooks;
mod wsg_port;
mod zenoh;

pub use access::{AccessConfig, Guarded, TlsConfig, TlsPlaces};
pub use error::{ConfigError, ConfigPlace};
pub use file::File;
pub use journal::{JournalConfig, JournalFlags, JournalPlace};
pub use modbus::Modbus;
pub use wsg_port::{AcknowledgePolicy, LimitsPolicy, WsgAddress, WsgPort};
pub use zenoh::{Zenoh, ZenohFlags, ZenohMode};

/// Default address of HTTP.
const DEFAULT_LISTEN: &str = "127.0.0.1:8080";

const DEFAULT_NAME: &str = "gateway";

/// Default time for a running command to finish at shutdown.
const DEFAULT_DRAIN: Duration = Duration::from_secs(2);

/// Longest configurable drain, since the shutdown waits for it.
const LONGEST_DRAIN: Duration = Duration::from_mins(1);

/// Default pause between motions. Users report errors of some grippers at shorter pauses.
const DEFAULT_MOTION_PAUSE: Duration = Duration::from_millis(50);

/// Longest configurable pause between motions, since a waiting motion blocks the next one.
const LONGEST_MOTION_PAUSE: Duration = Duration::from_secs(1);

/// Default time after which an idle HTTP connection is closed.
const DEFAULT_IDLE_TIMEOUT: Duration = Duration::from_secs(10);

/// Idle times that can be configured, in seconds. A slow request header can occupy its connection for this time.
const IDLE_TIMEOUTS_S: RangeInclusive<u64> = 1..=3600;

/// Default grippers: two simulated ones with a force finger each, one with a part in reach.
const DEFAULT_GRIPPERS: [&str; 2] = ["left=sim://wsg50?part_mm=20&finger1=fmf", "right=sim://wsg50?finger1=fmf"];

/// Flags and environment variables of `serve`.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Flags {
    /// Name and address of a gripper, e.g. left=tcp://192.168.1.20:1000 or right=sim://wsg50 (repeatable)
    #[arg(long = "gripper", value_name = "NAME=URL", env = "WSG_GATEWAY_GRIPPERS", value_delimiter = ',')]
    pub grippers: Vec<String>,
    /// Address to serve HTTP on [default: 127.0.0.1:8080]
    #[arg(long, value_name = "ADDR", env = "WSG_GATEWAY_LISTEN")]
    pub listen: Option<String>,
    /// Name of the gateway [default: gateway]
    #[arg(long, value_name = "NAME", env = "WSG_GATEWAY_NAME")]
    pub name: Option<String>,
    /// Journal file, or :memory: [default: NAME.db in $STATE_DIRECTORY or ~/.local/state/wsg-gateway]. A file keeps
    /// the newest 4096 MB, or journal_max_size_mb of the --config file
    #[arg(long, value_name = "PATH", env = "WSG_GATEWAY_JOURNAL")]
    pub journal: Option<String>,
    /// Serve a gripper over the WSG protocol, e.g. left=127.0.0.1:1000 or left=udp://127.0.0.1:1500 (repeatable)
    #[arg(long = "wsg-port", value_name = "NAME=ADDR", env = "WSG_GATEWAY_WSG_PORTS", value_delimiter = ',')]
    pub wsg_ports: Vec<String>,
    /// Serve all grippers over Modbus TCP, e.g. at 127.0.0.1:5020
    #[arg(long, value_name = "ADDR", env = "WSG_GATEWAY_MODBUS")]
    pub modbus: Option<String>,
    #[command(flatten)]
    pub zenoh: ZenohFlags,
    /// TOML file with these and all other settings
    #[arg(long, value_name = "FILE", env = "WSG_GATEWAY_CONFIG")]
    pub config: Option<PathBuf>,
    /// File of tokens; with it, clients need a token [default: tokens.json beside the --config file, if that has an
    /// `[access]` or `[[clients]]` section]
    #[arg(long, value_name = "FILE", env = "WSG_GATEWAY_TOKENS")]
    pub tokens: Option<PathBuf>,
    /// Allow addresses other than loopback without credentials and TLS: any client that reaches them can move the
    /// grippers
    #[arg(long, env = "WSG_GATEWAY_INSECURE")]
    pub insecure: bool,
}

/// A validated configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    pub name: Name,
    /// Address that HTTP is served on.
    pub listen: SocketAddr,
    /// Allowed values of `Host`, besides addresses and `localhost`.
    pub hosts: Vec<String>,
    /// Origins of foreign pages that can use the API (CORS).
    pub cors_origins: Vec<String>,
    /// Origins of pages that can show the dashboard in a frame.
    pub frame_ancestors: Vec<String>,
    /// Whether clients need credentials.
    pub access: AccessConfig,
    /// `None` if connections are not encrypted.
    pub tls: Option<TlsConfig>,
    /// Places of these files in the configuration.
    pub tls_places: Option<TlsPlaces>,
    /// Time after which an idle HTTP connection is closed.
    pub idle_timeout: Duration,
    /// URL at which users of other gateways reach this dashboard.
    pub public_url: Option<Url>,
    /// Whether the gateway announces itself on the local network (mDNS).
    pub mdns: bool,
    pub grippers: Vec<GripperConfig>,
    /// Time for a running command to finish at shutdown.
    pub drain: Duration,
    /// Drift limits of contact widths; `None` if drift is not watched.
    pub drift: Option<DriftLimits>,
    pub journal: JournalConfig,
    /// `None` if Modbus is off.
    pub modbus: Option<Modbus>,
    /// `None` if Zenoh is off.
    pub zenoh: Option<Zenoh>,
    pub webhooks: Vec<WebhookSettings>,
    /// Settings that are valid but probably mistaken.
    pub warnings: Vec<ConfigError>,
}

/// One gripper.
#[derive(Debug, Clone, PartialEq)]
pub struct GripperConfig {
    pub name: Name,
    pub device: DeviceSource,
    /// Whether the device's setting "FAST STOP on TCP disconnect" is on (`fw4-en 1.4.2`).
    pub fast_stop_on_disconnect: bool,
    /// Meaning of the ids of the gripper's scripts.
    pub custom_ids: CustomIds,
    pub updates: UpdateRules,
    /// Pause between the end of a motion and the next one.
    pub motion_pause: Duration,
    /// Lease terms that clients can choose.
    pub lease: LeaseRules,
    pub wsg_port: WsgPort,
    /// Unit identifier on Modbus; `None` for any.
    pub modbus_unit: Option<u8>,
    /// Place of the gripper's configuration.
    pub place: ConfigPlace,
}

/// The device of a gripper.
#[derive(Debug, Clone, PartialEq)]
pub enum DeviceSource {
    /// A device at an address.
    At(Address),
    /// A device simulated in this process: `sim://…`, which the daemon parses.
    Simulated(url::Url),
}

impl fmt::Display for DeviceSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::At(address) => address.fmt(f),
            Self::Simulated(url) => url.fmt(f),
        }
    }
}

/// A value with its place.
struct Placed<T> {
    value: T,
    place: ConfigPlace,
}

impl Config {
    /// Scheme of the URLs that HTTP is served at.
    #[must_use]
    pub fn scheme(&self) -> &'static str {
        if self.tls.is_some() { "https" } else { "http" }
    }

    /// Name, number of grippers and address, for people.
    #[must_use]
    pub fn summary(&self) -> String {
        let Self { name, grippers, listen, .. } = self;
        let count = grippers.len();
        let grippers = if count == 1 { "gripper" } else { "grippers" };
        format!("{name} serves {count} {grippers} at {listen}")
    }

    /// Merges the flags, which include the environment, with the file that they name.
    ///
    /// # Errors
    /// The first [`ConfigError`].
    pub fn load(flags: &Flags) -> Result<Self, ConfigError> {
        let file = match &flags.config {
            Some(path) => Some(File::read(path)?),
            None => None,
        };
        Self::merge(flags, file.as_ref())
    }

    fn merge(flags: &Flags, file: Option<&File>) -> Result<Self, ConfigError> {
        let content = file.map(|file| &file.content);
        let pick = |flag: &Option<String>, name: &'static str, in_file: Option<&Spanned<String>>, default: &str| match (
            flag, file, in_file,
        ) {
            (Some(value), ..) => Placed { value: value.clone(), place: ConfigPlace::Flag(name) },
            (None, Some(file), Some(value)) => {
                Placed { value: value.get_ref().clone(), place: file.place(value.span().start) }
            }
            _ => Placed { value: default.to_owned(), place: ConfigPlace::Default },
        };
        let name = pick(&flags.name, "--name", content.and_then(|content| content.name.as_ref()), DEFAULT_NAME);
        let name: Name = name.value.parse().map_err(|error| ConfigError::at(&name.place, error))?;
        let listen =
            pick(&flags.listen, "--listen", content.and_then(|content| content.listen.as_ref()), DEFAULT_LISTEN);
        let insecure = flags.insecure || content.is_some_and(|content| content.insecure);
        let listen = parse_listen(&listen)?;
        let (access, tls) = (AccessConfig::merge(flags, file, listen.value)?, access::tls(file));
        if !insecure {
            let insecure_http = content.is_some_and(|content| content.insecure_http);
            access::check_exposure(&listen, &access, tls.is_some(), insecure_http)?;
        }
        let grippers = grippers(flags, file, insecure)?;
        let config = Self {
            warnings: access::unknown_grippers(file, &grippers),
            journal: JournalConfig::merge(flags, file, &name)?,
            name,
            listen: listen.value,
            access,
            tls,
            tls_places: access::tls_places(file),
            hosts: hosts::hosts(file)?,
            cors_origins: origins(file, "cors_origins", |content| &content.cors_origins)?,
            frame_ancestors: origins(file, "frame_ancestors", |content| &content.frame_ancestors)?,
            idle_timeout: idle_timeout(file)?,
            public_url: public_url::public_url(file)?,
            mdns: content.is_some_and(|content| content.mdns),
            grippers,
            drain: drain(file)?,
            drift: drift::limits(file)?,
            modbus: Modbus::merge(flags, file, insecure || has_known_addresses(file))?,
            zenoh: Zenoh::merge(flags, file, insecure)?,
            webhooks: file.map(webhooks::settings).transpose()?.unwrap_or_default(),
        };
        wsg_port::check_reply_ports(&config)?;
        Ok(config)
    }
}

/// Returns a list of origins.
fn origins(
    file: Option<&File>,
    key: &str,
    list: impl Fn(&Content) -> &Vec<Spanned<String>>,
) -> Result<Vec<String>, ConfigError> {
    let Some(file) = file else { return Ok(Vec::new()) };
    let origin = |text: &Spanned<String>| {
        let origin = text.get_ref().parse::<url::Url>().ok().map(|url| url.origin().ascii_serialization());
        let is_web = |origin: &String| origin.starts_with("http") && origin == text.get_ref();
        origin.filter(is_web).ok_or_else(|| {
            let detail = format!("{key} has {:?}: write an origin such as https://hmi.example", text.get_ref());
            ConfigError::at(&file.place(text.span().start), detail)
        })
    };
    list(&file.content).iter().map(origin).collect()
}

fn parse_listen(listen: &Placed<String>) -> Result<Placed<SocketAddr>, ConfigError> {
    let value = parse_address(&listen.value, "127.0.0.1:8080 or [::1]:8080", &listen.place)?;
    Ok(Placed { value, place: listen.place.clone() })
}

/// Parses an address to listen on.
fn parse_address(text: &str, example: &str, place: &ConfigPlace) -> Result<SocketAddr, ConfigError> {
    text.parse()
        .map_err(|_| ConfigError::at(place, format!("{text:?} is not an address to listen on: write {example}")))
}

fn drain(file: Option<&File>) -> Result<Duration, ConfigError> {
    let Some((file, drain_ms)) = file.and_then(|file| Some((file, file.content.drain_ms.as_ref()?))) else {
        return Ok(DEFAULT_DRAIN);
    };
    let drain = Duration::from_millis(*drain_ms.get_ref());
    if drain > LONGEST_DRAIN {
        let detail = format!("drain_ms is {}; at most {} is allowed", drain.as_millis(), LONGEST_DRAIN.as_millis());
        return Err(ConfigError::at(&file.place(drain_ms.span().start), detail));
    }
    Ok(drain)
}

fn idle_timeout(file: Option<&File>) -> Result<Duration, ConfigError> {
    let given = file.and_then(|file| file.content.idle_timeout_s.as_ref());
    let remedy = "choose how long an unused connection stays open";
    let seconds = journal::bounded(file, "idle_timeout_s", given, IDLE_TIMEOUTS_S, remedy)?;
    Ok(seconds.map_or(DEFAULT_IDLE_TIMEOUT, Duration::from_secs))
}

fn grippers(flags: &Flags, file: Option<&File>, insecure: bool) -> Result<Vec<GripperConfig>, ConfigError> {
    let by_text = |texts: &[String], place: ConfigPlace| -> Result<Vec<GripperConfig>, ConfigError> {
        texts.iter().map(|text| parse_gripper(text, &place)).collect()
    };
    let mut configured = match file {
        _ if !flags.grippers.is_empty() => by_text(&flags.grippers, ConfigPlace::Flag("--gripper"))?,
        Some(file) if !file.content.grippers.is_empty() => file.grippers()?,
        _ => by_text(&DEFAULT_GRIPPERS.map(str::to_owned), ConfigPlace::Default)?,
    };
    wsg_port::take_flags(&mut configured, &flags.wsg_ports)?;
    // Without a list of networks, a port accepts only the clients that are known by their addresses.
    for gripper in &configured {
        gripper.wsg_port.check(insecure || has_known_addresses(file))?;
    }
    for (index, gripper) in configured.iter().enumerate() {
        if let Some(detail) = configured[..index].iter().find_map(|other| conflict(other, gripper)) {
            return Err(ConfigError::at(&gripper.place, detail));
        }
    }
    wsg_port::check_addresses(&configured)?;
    share_lines(&mut configured);
    Ok(configured)
}

/// Whether the file names clients by their addresses.
fn has_known_addresses(file: Option<&File>) -> bool {
    file.is_some_and(|file| file.content.clients.iter().any(access::ClientContent::has_address))
}

/// Counts the grippers on each CAN bus, which share its capacity.
fn share_lines(grippers: &mut [GripperConfig]) {
    let devices: Vec<_> = grippers.iter().map(|gripper| gripper.device.clone()).collect();
    for gripper in grippers {
        let DeviceSource::At(address) = &gripper.device else { continue };
        let shares = |device: &&DeviceSource| matches!(device, DeviceSource::At(one) if address.shares_line_with(one));
        gripper.updates.devices_on_line = devices.iter().filter(shares).count().max(1) as u32;
    }
}

/// Returns why two grippers cannot both be served, if so.
fn conflict(one: &GripperConfig, other: &GripperConfig) -> Option<String> {
    if one.name == other.name {
        return Some(format!("two grippers are named {:?}: give each its own name", one.name.as_str()));
    }
    if let Some(detail) = modbus::conflict(one, other) {
        return Some(detail);
    }
    let (DeviceSource::At(address), DeviceSource::At(other_address)) = (&one.device, &other.device) else {
        return None;
    };
    let why = address.conflict_with(other_address)?;
    Some(format!("{} and {} cannot both be served: {why}", one.name, other.name))
}

fn parse_gripper(text: &str, place: &ConfigPlace) -> Result<GripperConfig, ConfigError> {
    let (name, url) = text.split_once('=').ok_or_else(|| {
        ConfigError::at(place, format!("{text:?} is not a gripper: write left=tcp://192.168.1.20:1000"))
    })?;
    Ok(GripperConfig {
        name: name.parse().map_err(|error| ConfigError::at(place, error))?,
        device: parse_device(url, place)?,
        fast_stop_on_disconnect: true,
        custom_ids: CustomIds::default(),
        updates: UpdateRules::default(),
        motion_pause: DEFAULT_MOTION_PAUSE,
        lease: LeaseRules::default(),
        wsg_port: WsgPort::default(),
        modbus_unit: None,
        place: place.clone(),
    })
}

fn parse_device(url: &str, place: &ConfigPlace) -> Result<DeviceSource, ConfigError> {
    if url.starts_with("sim:") {
        return url
            .parse()
            .map(DeviceSource::Simulated)
            .map_err(|error| ConfigError::at(place, format!("{url:?} is not a URL ({error}): write sim://wsg50")));
    }
    url.parse().map(DeviceSource::At).map_err(|error| ConfigError::at(place, error))
}

fn owned(path: &Path) -> PathBuf {
    path.to_owned()
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Content {
    name: Option<Spanned<String>>,
    listen: Option<Spanned<String>>,
    insecure: bool,
    insecure_http: bool,
    hosts: Vec<Spanned<String>>,
    cors_origins: Vec<Spanned<String>>,
    frame_ancestors: Vec<Spanned<String>>,
    access: Option<access::AccessContent>,
    clients: Vec<access::ClientContent>,
    tls: Option<access::TlsContent>,
    journal: Option<Spanned<String>>,
    on_journal_failure: OnJournalFailure,
    journal_max_age_days: Option<Spanned<u64>>,
    journal_max_size_mb: Option<Spanned<u64>>,
    drain_ms: Option<Spanned<u64>>,
    drift: Option<drift::DriftContent>,
    idle_timeout_s: Option<Spanned<u64>>,
    public_url: Option<Spanned<String>>,
    mdns: bool,
    modbus: Option<Spanned<String>>,
    modbus_allow: Option<Spanned<Vec<String>>>,
    modbus_heartbeat_ms: Option<Spanned<u64>>,
    zenoh: zenoh::ZenohContent,
    webhooks: Vec<webhooks::WebhookContent>,
    grippers: std::collections::BTreeMap<Spanned<String>, GripperContent>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GripperContent {
    url: Spanned<String>,
    fast_stop_on_disconnect: Option<bool>,
    update_period_ms: Option<Spanned<u64>>,
    #[serde(default)]
    updates: UpdateMode,
    read_ids: Option<Spanned<BTreeSet<u8>>>,
    stream_ids: Option<Spanned<BTreeSet<u8>>>,
    motion_pause_ms: Option<Spanned<u64>>,
    on_loss_moving: Option<Spanned<Vec<OnLossMoving>>>,
    on_loss_holding: Option<Spanned<Vec<OnLossHolding>>>,
    lease_max_ttl_ms: Option<Spanned<u64>>,
    wsg_port: Option<Spanned<wsg_port::OneOrMore>>,
    wsg_port_allow: Option<Spanned<Vec<String>>>,
    #[serde(default)]
    wsg_port_acknowledge: AcknowledgePolicy,
    wsg_port_checksum_evaluation: Option<bool>,
    #[serde(default)]
    wsg_port_limits: wsg_port::LimitsWord,
    wsg_port_max_force_n: Option<Spanned<f64>>,
    modbus_unit: Option<Spanned<u64>>,
}

#[cfg(test)]
mod tests;
