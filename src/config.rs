//! The configuration: a flag beats the environment beats the file. Validated once, here; nothing else reads flags, the
//! environment or the file. A mistake is named with its place and its remedy.

use std::collections::BTreeSet;
use std::fmt;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Deserialize;
use toml::Spanned;

use crate::gripper::model::{CustomIds, LeaseRules, Name, OnLossHolding, OnLossMoving};
use crate::transport::Address;

mod file;
mod journal;
mod wsg_port;
mod zenoh;

pub use file::File;
pub use journal::{Journal, JournalFlags, JournalPlace, OnJournalFailure};
pub use wsg_port::{Acknowledge, WsgAddress, WsgPort};
pub use zenoh::{Zenoh, ZenohFlags, ZenohMode};

/// Where the daemon listens unless it is told otherwise.
const DEFAULT_LISTEN: &str = "127.0.0.1:8080";

/// The gateway's name unless it is told otherwise.
const DEFAULT_NAME: &str = "gateway";

/// How long a running command may take to finish at the orderly end.
const DEFAULT_DRAIN: Duration = Duration::from_secs(2);

/// And at most: whoever ends the gateway waits for it.
const LONGEST_DRAIN: Duration = Duration::from_mins(1);

/// What is served when nothing is configured: two simulated grippers, a part in reach of one.
const DEFAULT_GRIPPERS: [&str; 2] = ["left=sim://wsg50?part_mm=20", "right=sim://wsg50"];

/// What `serve` takes from the command line and the environment.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct Flags {
    /// A gripper and where it is, e.g. left=tcp://192.168.1.20:1000 or right=sim://wsg50 (repeatable)
    #[arg(long = "gripper", value_name = "NAME=URL", env = "WSG_GATEWAY_GRIPPERS", value_delimiter = ',')]
    pub grippers: Vec<String>,
    /// Where to serve HTTP [default: 127.0.0.1:8080]
    #[arg(long, value_name = "ADDR", env = "WSG_GATEWAY_LISTEN")]
    pub listen: Option<String>,
    /// The gateway's name [default: gateway]
    #[arg(long, value_name = "NAME", env = "WSG_GATEWAY_NAME")]
    pub name: Option<String>,
    /// Where to keep the journal: a file, or :memory: [default: NAME.db in $STATE_DIRECTORY or
    /// ~/.local/state/wsg-gateway]; of a file the newest 4096 MB are kept, or journal_max_size_mb of the --config file
    #[arg(long, value_name = "PATH", env = "WSG_GATEWAY_JOURNAL")]
    pub journal: Option<String>,
    /// Serve a gripper by the WSG protocol itself, e.g. left=127.0.0.1:1000 or left=udp://127.0.0.1:1500 (repeatable)
    #[arg(long = "wsg-port", value_name = "NAME=ADDR", env = "WSG_GATEWAY_WSG_PORTS", value_delimiter = ',')]
    pub wsg_ports: Vec<String>,
    /// Zenoh.
    #[command(flatten)]
    pub zenoh: ZenohFlags,
    /// A TOML file, for these and all other settings
    #[arg(long, value_name = "FILE", env = "WSG_GATEWAY_CONFIG")]
    pub config: Option<PathBuf>,
    /// Listen on other addresses than loopback although there are no credentials yet: whoever reaches them can move the
    /// grippers
    #[arg(long, env = "WSG_GATEWAY_INSECURE")]
    pub insecure: bool,
}

/// A valid configuration.
#[derive(Debug, Clone, PartialEq)]
pub struct Config {
    /// The gateway's name.
    pub name: Name,
    /// Where HTTP is served.
    pub listen: SocketAddr,
    /// What `Host` may be, besides addresses and `localhost`.
    pub hosts: Vec<String>,
    /// The grippers.
    pub grippers: Vec<Gripper>,
    /// How long a running command may take to finish at the orderly end.
    pub drain: Duration,
    /// The journal.
    pub journal: Journal,
    /// Zenoh, unless it is off.
    pub zenoh: Option<Zenoh>,
}

/// One gripper.
#[derive(Debug, Clone, PartialEq)]
pub struct Gripper {
    /// Its name.
    pub name: Name,
    /// Where it is.
    pub device: Device,
    /// What the ids of its scripts mean.
    pub custom_ids: CustomIds,
    /// What may be asked for of its lease.
    pub lease: LeaseRules,
    /// Its WSG port.
    pub wsg_port: WsgPort,
    /// Where that is said.
    pub place: Place,
}

/// Where a gripper is.
#[derive(Debug, Clone, PartialEq)]
pub enum Device {
    /// At an address.
    At(Address),
    /// In this process: `sim://…`, which the daemon reads.
    Simulated(url::Url),
}

impl fmt::Display for Device {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::At(address) => address.fmt(f),
            Self::Simulated(url) => url.fmt(f),
        }
    }
}

/// Where something is configured.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// By a flag or its environment variable.
    Flag(&'static str),
    /// In a file.
    File {
        /// Its path.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
    },
    /// Nowhere: the default.
    Default,
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Flag(flag) => f.write_str(flag),
            Self::File { path, line } => write!(f, "{}:{line}", path.display()),
            Self::Default => f.write_str("default"),
        }
    }
}

/// A mistake in a configuration: where, what, and what to do about it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{place}: {detail}")]
pub struct ConfigError {
    /// Where it is.
    pub place: Place,
    /// What it is, with its remedy.
    pub detail: String,
}

impl ConfigError {
    /// At a place.
    pub fn at(place: &Place, detail: impl fmt::Display) -> Self {
        Self { place: place.clone(), detail: detail.to_string() }
    }
}

/// A value and where it was said.
struct Placed<T> {
    value: T,
    place: Place,
}

impl Config {
    /// From the flags (which clap has merged with the environment) and the file that they name.
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
            (Some(value), ..) => Placed { value: value.clone(), place: Place::Flag(name) },
            (None, Some(file), Some(value)) => {
                Placed { value: value.get_ref().clone(), place: file.place(value.span().start) }
            }
            _ => Placed { value: default.to_owned(), place: Place::Default },
        };
        let name = pick(&flags.name, "--name", content.and_then(|content| content.name.as_ref()), DEFAULT_NAME);
        let name: Name = name.value.parse().map_err(|error| ConfigError::at(&name.place, error))?;
        let listen =
            pick(&flags.listen, "--listen", content.and_then(|content| content.listen.as_ref()), DEFAULT_LISTEN);
        let insecure = flags.insecure || content.is_some_and(|content| content.insecure);
        let config = Self {
            journal: Journal::merge(flags, file, &name)?,
            name,
            listen: parse_listen(&listen, insecure)?,
            hosts: content.map(|content| content.hosts.clone()).unwrap_or_default(),
            grippers: grippers(flags, file, insecure)?,
            drain: drain(file)?,
            zenoh: Zenoh::merge(flags, file, insecure)?,
        };
        Ok(config)
    }
}

fn parse_listen(listen: &Placed<String>, insecure: bool) -> Result<SocketAddr, ConfigError> {
    let address: SocketAddr = listen.value.parse().map_err(|_| {
        let detail = format!("{:?} is no address to listen on: write it as 127.0.0.1:8080 or [::1]:8080", listen.value);
        ConfigError::at(&listen.place, detail)
    })?;
    if !address.ip().is_loopback() && !insecure {
        let detail = format!(
            "{address} is not a loopback address, and there are no credentials yet: whoever reaches it can move the \
             grippers. Listen on 127.0.0.1, or say --insecure if the network is yours alone"
        );
        return Err(ConfigError::at(&listen.place, detail));
    }
    Ok(address)
}

fn drain(file: Option<&File>) -> Result<Duration, ConfigError> {
    let Some((file, drain_ms)) = file.and_then(|file| Some((file, file.content.drain_ms.as_ref()?))) else {
        return Ok(DEFAULT_DRAIN);
    };
    let drain = Duration::from_millis(*drain_ms.get_ref());
    if drain > LONGEST_DRAIN {
        let detail = format!("drain_ms is {}, and may be {} at most", drain.as_millis(), LONGEST_DRAIN.as_millis());
        return Err(ConfigError::at(&file.place(drain_ms.span().start), detail));
    }
    Ok(drain)
}

fn grippers(flags: &Flags, file: Option<&File>, insecure: bool) -> Result<Vec<Gripper>, ConfigError> {
    let by_text = |texts: &[String], place: Place| -> Result<Vec<Gripper>, ConfigError> {
        texts.iter().map(|text| parse_gripper(text, &place)).collect()
    };
    let mut configured = match file {
        _ if !flags.grippers.is_empty() => by_text(&flags.grippers, Place::Flag("--gripper"))?,
        Some(file) if !file.content.grippers.is_empty() => file.grippers()?,
        _ => by_text(&DEFAULT_GRIPPERS.map(str::to_owned), Place::Default)?,
    };
    wsg_port::take_flags(&mut configured, &flags.wsg_ports)?;
    for gripper in &configured {
        gripper.wsg_port.check(insecure)?;
    }
    for (index, gripper) in configured.iter().enumerate() {
        if let Some(detail) = configured[..index].iter().find_map(|other| conflict(other, gripper)) {
            return Err(ConfigError::at(&gripper.place, detail));
        }
    }
    Ok(configured)
}

/// Why two grippers can't both be served.
fn conflict(one: &Gripper, other: &Gripper) -> Option<String> {
    if one.name == other.name {
        return Some(format!("the name {:?} is given to two grippers: each needs its own", one.name.as_str()));
    }
    let (Device::At(address), Device::At(other_address)) = (&one.device, &other.device) else { return None };
    let why = address.conflict_with(other_address)?;
    Some(format!("{} and {} exclude each other: {why}", one.name, other.name))
}

fn parse_gripper(text: &str, place: &Place) -> Result<Gripper, ConfigError> {
    let (name, url) = text.split_once('=').ok_or_else(|| {
        ConfigError::at(place, format!("{text:?} is no gripper: write it as left=tcp://192.168.1.20:1000"))
    })?;
    Ok(Gripper {
        name: name.parse().map_err(|error| ConfigError::at(place, error))?,
        device: parse_device(url, place)?,
        custom_ids: CustomIds::default(),
        lease: LeaseRules::default(),
        wsg_port: WsgPort::default(),
        place: place.clone(),
    })
}

fn parse_device(url: &str, place: &Place) -> Result<Device, ConfigError> {
    if url.starts_with("sim:") {
        return url
            .parse()
            .map(Device::Simulated)
            .map_err(|error| ConfigError::at(place, format!("{url:?} is no URL ({error}): write it as sim://wsg50")));
    }
    url.parse().map(Device::At).map_err(|error| ConfigError::at(place, error))
}

/// The path of a file, as mistakes name it.
fn owned(path: &Path) -> PathBuf {
    path.to_owned()
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Content {
    name: Option<Spanned<String>>,
    listen: Option<Spanned<String>>,
    insecure: bool,
    hosts: Vec<String>,
    journal: Option<Spanned<String>>,
    on_journal_failure: OnJournalFailure,
    journal_max_age_days: Option<Spanned<u64>>,
    journal_max_size_mb: Option<Spanned<u64>>,
    drain_ms: Option<Spanned<u64>>,
    zenoh: zenoh::Content,
    grippers: std::collections::BTreeMap<Spanned<String>, GripperContent>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct GripperContent {
    url: Spanned<String>,
    read_ids: Option<Spanned<BTreeSet<u8>>>,
    stream_ids: Option<Spanned<BTreeSet<u8>>>,
    on_loss_moving: Option<Spanned<Vec<OnLossMoving>>>,
    on_loss_holding: Option<Spanned<Vec<OnLossHolding>>>,
    lease_max_ttl_ms: Option<Spanned<u64>>,
    wsg_port: Option<Spanned<wsg_port::OneOrMore>>,
    wsg_port_allow: Option<Spanned<Vec<String>>>,
    #[serde(default)]
    wsg_port_acknowledge: Acknowledge,
    wsg_port_checksum_evaluation: Option<bool>,
}

#[cfg(test)]
mod tests;
