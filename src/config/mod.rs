//! The configuration. A flag overrides the environment, which overrides the file.
//!
//! Everything is validated once, here; nothing else reads flags, the environment or the file. An error names its place
//! and its remedy.

use std::fmt;
use std::net::SocketAddr;
use std::path::PathBuf;

use toml::Spanned;

use crate::connections::tls::TlsFiles;
use crate::interfaces::http::WebSettings;
use crate::interfaces::mqtt::MqttSettings;
use crate::model::{GripperRules, Name, SharedRules};
use crate::settings::{flag, named_sections, optional, required, section, sections, settings};
use crate::transport::Address;
use crate::wear::DriftLimits;
use crate::webhooks::WebhookSettings;

mod access;
mod error;
mod file;
#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;
mod journal;
mod modbus;
mod mqtt;
mod named_files;
mod webhooks;
mod wsg_port;
mod zenoh;

pub use access::{AccessConfig, Guarded};
pub use error::{ConfigError, ConfigPlace};
pub use file::File;
pub use journal::{JournalConfig, JournalFlags, JournalLocation};
pub use modbus::{Modbus, ModbusRules};
pub use named_files::named_files;
pub use wsg_port::WsgPort;
pub use zenoh::{Zenoh, ZenohFlags, ZenohMode};

/// Default address of HTTP.
const DEFAULT_LISTEN: &str = "127.0.0.1:8080";

/// Default name of the gateway.
pub const DEFAULT_NAME: &str = "gateway";

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
    pub web: WebSettings,
    /// Whether clients need credentials.
    pub access: AccessConfig,
    /// `None` if connections are not encrypted.
    pub tls: Option<TlsFiles>,
    /// The files for TLS, with their keys and places in the configuration.
    pub tls_places: Vec<(PathBuf, &'static str, ConfigPlace)>,
    pub grippers: Vec<GripperConfig>,
    /// Drift limits of contact widths; `None` if drift is not watched.
    pub drift: Option<DriftLimits>,
    pub journal: JournalConfig,
    /// `None` if Modbus is off.
    pub modbus: Option<Modbus>,
    /// `None` if Zenoh is off.
    pub zenoh: Option<Zenoh>,
    pub webhooks: Vec<WebhookSettings>,
    /// `None` if MQTT is off.
    pub mqtt: Option<MqttSettings>,
    /// Settings that are valid but probably mistaken.
    pub warnings: Vec<ConfigError>,
}

/// One gripper.
#[derive(Debug, Clone, PartialEq)]
pub struct GripperConfig {
    pub name: Name,
    pub device: DeviceSource,
    pub rules: GripperRules,
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
        let no_file = File::default();
        let file = file.unwrap_or(&no_file);
        let content = &file.content;
        let name = file.pick(flags.name.as_ref(), "--name", content.name.as_ref());
        let name = name.unwrap_or_else(|| default_text(DEFAULT_NAME));
        let name: Name = name.value.parse().map_err(|error| ConfigError::at(&name.place, error))?;
        let listen = file.pick(flags.listen.as_ref(), "--listen", content.listen.as_ref());
        let Placed { value, place } = listen.unwrap_or_else(|| default_text(DEFAULT_LISTEN));
        let listen = Placed { value: parse_address(&value, "127.0.0.1:8080 or [::1]:8080", &place)?, place };
        let insecure = flags.insecure || content.insecure;
        let access = AccessConfig::merge(flags, file, listen.value)?;
        let tls = access::tls(file);
        if !insecure {
            access::check_exposure(&listen, &access, tls.is_some(), content.insecure_http)?;
        }
        let grippers = grippers(flags, file, insecure)?;
        let drift = content.drift.clone().unwrap_or_default();
        let mqtt = mqtt::settings(file, &name, &grippers)?;
        let mut warnings = access::unknown_grippers(file, &grippers);
        warnings.extend(mqtt::exposure(file, mqtt.as_ref()));
        let config = Self {
            warnings,
            journal: JournalConfig::merge(flags, file, &name)?,
            name,
            listen: listen.value,
            access,
            tls,
            tls_places: access::tls_places(file),
            web: content.web.clone(),
            grippers,
            drift: drift.warnings.then_some(drift.limits),
            modbus: Modbus::merge(flags, file, insecure || has_known_addresses(file))?,
            zenoh: Zenoh::merge(flags, file, insecure)?,
            webhooks: webhooks::settings(file)?,
            mqtt,
        };
        wsg_port::check_reply_ports(&config)?;
        Ok(config)
    }
}

fn default_text(text: &str) -> Placed<String> {
    Placed { value: text.to_owned(), place: ConfigPlace::Default }
}

/// Parses an address to listen on.
fn parse_address(text: &str, example: &str, place: &ConfigPlace) -> Result<SocketAddr, ConfigError> {
    text.parse()
        .map_err(|_| ConfigError::at(place, format!("{text:?} is not an address to listen on: write {example}")))
}

fn grippers(flags: &Flags, file: &File, insecure: bool) -> Result<Vec<GripperConfig>, ConfigError> {
    let mut configured = if !flags.grippers.is_empty() {
        parse_grippers(&flags.grippers, &ConfigPlace::Flag("--gripper"))?
    } else if !file.content.grippers.is_empty() {
        grippers_of(file)?
    } else {
        parse_grippers(&DEFAULT_GRIPPERS.map(str::to_owned), &ConfigPlace::Default)?
    };
    for gripper in &mut configured {
        gripper.rules.shared = file.content.shared.clone();
    }
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
fn has_known_addresses(file: &File) -> bool {
    file.content.clients.iter().any(|client| client.address.is_some())
}

/// Counts the grippers on each CAN bus, which share its capacity.
fn share_lines(grippers: &mut [GripperConfig]) {
    let devices: Vec<_> = grippers.iter().map(|gripper| gripper.device.clone()).collect();
    for gripper in grippers {
        let DeviceSource::At(address) = &gripper.device else { continue };
        let on_line = devices.iter().filter(|device| match device {
            DeviceSource::At(other) => address.shares_line_with(other),
            DeviceSource::Simulated(_) => false,
        });
        gripper.rules.updates.devices_on_line = on_line.count().max(1) as u32;
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

fn parse_grippers(texts: &[String], place: &ConfigPlace) -> Result<Vec<GripperConfig>, ConfigError> {
    texts.iter().map(|text| parse_gripper(text, place)).collect()
}

fn parse_gripper(text: &str, place: &ConfigPlace) -> Result<GripperConfig, ConfigError> {
    let (name, url) = text.split_once('=').ok_or_else(|| {
        ConfigError::at(place, format!("{text:?} is not a gripper: write left=tcp://192.168.1.20:1000"))
    })?;
    Ok(GripperConfig {
        name: name.parse().map_err(|error| ConfigError::at(place, error))?,
        device: parse_device(url, place)?,
        rules: GripperRules::default(),
        wsg_port: WsgPort::default(),
        modbus_unit: None,
        place: place.clone(),
    })
}

/// Returns the grippers of a file.
fn grippers_of(file: &File) -> Result<Vec<GripperConfig>, ConfigError> {
    let mut grippers = Vec::new();
    for (name, GripperContent { url, modbus_unit, wsg_port, rules }) in &file.content.grippers {
        let place = file.place(url.span().start);
        grippers.push(GripperConfig {
            name: name.get_ref().parse().map_err(|error| ConfigError::at(&file.place(name.span().start), error))?,
            device: parse_device(url.get_ref(), &place)?,
            rules: rules.clone(),
            wsg_port: WsgPort::of_content(wsg_port, |offset| file.place(offset))?,
            modbus_unit: *modbus_unit,
            place,
        });
    }
    Ok(grippers)
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

/// Stands for a text that a section must have.
fn blank<T: From<&'static str>>() -> Spanned<T> {
    Spanned::new(0..0, T::from(""))
}

settings! {
    /// A configuration file.
    struct Content {
        /// Name of the gateway, in the journal and on Zenoh; the same as `--name`.
        name: Option<Spanned<String>> = "name", optional("a name", "").shown("`\"gateway\"`", "\"gateway\""), Restart;
        /// Address of HTTP, WebSocket and the dashboard; the same as `--listen`. An address other than loopback needs
        /// `[access]` and `[tls]`.
        listen: Option<Spanned<String>> = "listen",
            optional("IP address and port", "").shown("`\"127.0.0.1:8080\"`", "\"127.0.0.1:8080\""), Reload;
        /// Allows addresses other than loopback without `[access]` and `[tls]`; the same as `--insecure`. Every client that
        /// reaches them can move the grippers.
        insecure: bool = "insecure", flag(false), Reload;
        /// Allows `[access]` without `[tls]` on addresses other than loopback: see [TLS](access.md#tls). Everyone on the
        /// network can read the tokens.
        insecure_http: bool = "insecure_http", flag(false), Reload;
        /// [Credentials](access.md) of clients. With this section, clients need one.
        access: Option<access::AccessContent> = "access", section(), Reload;
        /// A section for each client that cannot send a token, and is known by its address or its certificate.
        clients: Vec<access::ClientContent> = "clients", sections(), Reload;
        /// Encryption of HTTP, with a certificate and its key.
        tls: Option<access::TlsContent> = "tls", section(), Reload;
        /// Warnings about a drift of contact widths.
        drift: Option<DriftContent> = "drift", section(), Reload;
        /// A section for each gripper. The service's user can open serial ports of the group `dialout`.
        grippers: Vec<(Spanned<String>, GripperContent)> = "grippers", named_sections(), Reload;
        /// Zenoh, which connects gateways and robots.
        zenoh: Option<zenoh::ZenohContent> = "zenoh", section(), Restart;
        /// A section for each receiver of events.
        webhooks: Vec<webhooks::WebhookContent> = "webhooks", sections(), Reload;
        /// MQTT, which publishes states and records to a broker.
        mqtt: Option<mqtt::MqttContent> = "mqtt", section(), Reload;
        group web: WebSettings;
        group modbus: modbus::ModbusContent;
        group journal: journal::JournalContent;
        group shared: SharedRules;
    }
}

settings! {
    struct DriftContent {
        /// Whether drift of contact widths raises the alarm `drift_warning`.
        warnings: bool = "warnings", flag(true), Reload;
        group limits: DriftLimits;
    }
}

settings! {
    struct GripperContent {
        /// Address of the gripper: `tcp://`, `udp://`, `serial://` or `can://`, or `sim://` for a simulated gripper.
        url: Spanned<String> = "url",
            required(blank(), "see [Gripper addresses](#gripper-addresses)", "\"tcp://192.168.1.20:1000\""), Reload;
        /// Unit identifier of the gripper on [Modbus](modbus.md#setup).
        modbus_unit: Option<u8> = "modbus_unit", modbus::unit(), Reload;
        group rules: GripperRules;
        group wsg_port: wsg_port::WsgPortContent;
    }
}

#[cfg(test)]
mod documents_tests;
#[cfg(test)]
mod tests;
