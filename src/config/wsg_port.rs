//! Settings of a WSG port, which serves a gripper over the WSG protocol itself.

use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::time::Duration;

use serde::Deserialize;
use toml::Spanned;
use url::Url;

use super::{Config, ConfigError, ConfigPlace, DeviceSource, GripperConfig, Zenoh};
use crate::interfaces::wsg_port::{Datagrams, LOST_AFTER, ListenAddress, Rules};
use crate::model::Name;
use crate::settings::{optional, settings};
use crate::transport::{Address, Options};

/// TCP port that devices listen on (field practice).
const DEFAULT_TCP_PORT: u16 = 1000;
/// UDP port that devices listen on (field practice).
const DEFAULT_UDP_PORT: u16 = 1500;

/// UDP port that devices send their replies to (field practice), whatever port a request came from.
const DEFAULT_REPLY_PORT: u16 = 1501;
/// Value of `reply_port` for replies to the port that a request came from.
const REPLY_TO_SENDER: &str = "sender";

/// UDP port of mDNS (RFC 6762).
const MDNS_PORT: u16 = 5353;

/// Configurable silence after which a UDP client is lost, in ms: the range of a lease's time to live.
const LOST_AFTER_MS: RangeInclusive<u32> = 100..=60_000;

settings! {
    pub(super) struct WsgPortContent {
        /// Addresses of the [WSG port](drivers.md#addresses), for existing drivers: `192.168.1.5:1000`, or
        /// `udp://192.168.1.5:1500`.
        addresses: Option<Spanned<OneOrMore>> = "wsg_port", optional("one address, or a list", "[\"127.0.0.1:11000\"]"), Reload;
        group rules: Rules;
    }
}

/// The WSG port of one gripper.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WsgPort {
    /// Addresses that the port is served on, with their places in the configuration.
    pub addresses: Vec<(ListenAddress, ConfigPlace)>,
    pub rules: Rules,
}

/// Checks that each address serves one gripper. Otherwise a reload could leave a client with the wrong one.
pub(super) fn check_addresses(grippers: &[GripperConfig]) -> Result<(), ConfigError> {
    let mut served: Vec<(ListenAddress, &Name)> = Vec::new();
    for gripper in grippers {
        for (address, place) in &gripper.wsg_port.addresses {
            if let Some((_, other)) =
                served.iter().find(|(other, _)| !address.is_any_port() && other.is_same_socket(address))
            {
                let detail = format!(
                    "{} is already the address of a WSG port of {other}: give each WSG port its own address",
                    address.socket()
                );
                return Err(ConfigError::at(place, detail));
            }
            served.push((*address, &gripper.name));
        }
    }
    Ok(())
}

/// Checks that no port sends its replies to a UDP port of the gateway itself. With a client on this machine, the gateway
/// would take its own reply to that client for the gripper's, and end the holder's motion.
pub(super) fn check_reply_ports(config: &Config) -> Result<(), ConfigError> {
    let own = udp_ports(config);
    for gripper in &config.grippers {
        for (address, place) in &gripper.wsg_port.addresses {
            let ListenAddress::Udp(_, Datagrams { reply_port: Some(reply_port), .. }) = address else { continue };
            if let Some((_, owner)) = own.iter().find(|(port, _)| port == reply_port) {
                let detail = format!(
                    "the WSG port of {} sends its replies to UDP port {reply_port}, which is {owner}: the gateway would \
                     receive them itself. Set another reply_port here and in the driver, or reply_port={REPLY_TO_SENDER}, \
                     or use another port there",
                    gripper.name
                );
                return Err(ConfigError::at(place, detail));
            }
        }
    }
    Ok(())
}

/// UDP ports of the gateway, with their purposes.
fn udp_ports(config: &Config) -> Vec<(u16, String)> {
    let mut ports = Vec::new();
    for gripper in &config.grippers {
        let name = &gripper.name;
        if let DeviceSource::At(Address::Udp(address)) = &gripper.device {
            ports.push((address.local_port, format!("the local_port of {name}")));
        }
        for (address, _) in &gripper.wsg_port.addresses {
            if let ListenAddress::Udp(address, _) = address {
                ports.push((address.port(), format!("the UDP WSG port of {name}")));
            }
        }
    }
    let zenoh = config.zenoh.iter().flat_map(Zenoh::udp_ports);
    ports.extend(zenoh.map(|port| (port, "a Zenoh endpoint of the gateway".to_owned())));
    if config.web.mdns {
        ports.push((MDNS_PORT, "the port of mDNS".to_owned()));
    }
    ports
}

/// One text, or several.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(untagged)]
pub(super) enum OneOrMore {
    One(String),
    More(Vec<String>),
}

impl WsgPort {
    /// Parses the keys in a file.
    pub(super) fn of_content(
        content: &WsgPortContent,
        place_of: impl FnOnce(usize) -> ConfigPlace,
    ) -> Result<Self, ConfigError> {
        let WsgPortContent { addresses, rules } = content;
        let mut port = Self { addresses: Vec::new(), rules: rules.clone() };
        if let Some(addresses) = addresses {
            let place = place_of(addresses.span().start);
            let texts = match addresses.get_ref() {
                OneOrMore::One(text) => std::slice::from_ref(text),
                OneOrMore::More(texts) => texts,
            };
            for text in texts {
                port.addresses.push((parse(text, &place)?, place.clone()));
            }
        }
        Ok(port)
    }

    /// Whether both are the same, wherever they stand in the file.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        let addresses = self.addresses.iter().map(|(address, _)| address);
        addresses.eq(other.addresses.iter().map(|(address, _)| address)) && self.rules == other.rules
    }

    /// Checks that an address other than loopback comes with a list of allowed networks, with clients that are known by
    /// their addresses, or with `--insecure`.
    pub(super) fn check(&self, may_be_exposed: bool) -> Result<(), ConfigError> {
        for (address, place) in &self.addresses {
            let address = address.socket();
            if !address.ip().is_loopback() && self.rules.allow.is_empty() && !may_be_exposed {
                let detail = format!(
                    "{address} is not a loopback address, and the WSG protocol has no credentials: any client that \
                     reaches it can move the gripper. List the allowed networks in wsg_port_allow, name the clients in \
                     [[clients]] sections, or pass --insecure if the network is yours alone"
                );
                return Err(ConfigError::at(place, detail));
            }
        }
        Ok(())
    }
}

/// Overrides the file's ports with those of `--wsg-port`, gripper by gripper.
pub(super) fn take_flags(grippers: &mut [GripperConfig], texts: &[String]) -> Result<(), ConfigError> {
    let place = ConfigPlace::Flag("--wsg-port");
    let mut given: Vec<(&str, ListenAddress)> = Vec::new();
    for text in texts {
        let (name, address) = text
            .split_once('=')
            .ok_or_else(|| ConfigError::at(&place, format!("{text:?} is not a WSG port: write left=127.0.0.1:1000")))?;
        given.push((name, parse(address, &place)?));
        if !grippers.iter().any(|gripper| gripper.name.as_str() == name) {
            let names: Vec<_> = grippers.iter().map(|gripper| gripper.name.as_str()).collect();
            let detail = format!("no gripper is named {name:?}; the grippers are: {}", names.join(", "));
            return Err(ConfigError::at(&place, detail));
        }
    }
    for gripper in grippers {
        let own = given.iter().filter(|(name, _)| *name == gripper.name.as_str());
        let addresses: Vec<_> = own.map(|(_, address)| (*address, place.clone())).collect();
        if !addresses.is_empty() {
            gripper.wsg_port.addresses = addresses;
        }
    }
    Ok(())
}

fn parse(text: &str, place: &ConfigPlace) -> Result<ListenAddress, ConfigError> {
    parse_address(text).map_err(|detail| ConfigError::at(place, detail))
}

fn parse_address(text: &str) -> Result<ListenAddress, String> {
    if let Ok(address) = text.parse() {
        return Ok(ListenAddress::Tcp(address));
    }
    let url: Url = text.parse().map_err(|_| not_an_address(text))?;
    match url.scheme() {
        "tcp" => {
            Options::of(&url, &[])?;
            let address = socket_address(&url, DEFAULT_TCP_PORT).ok_or_else(|| not_an_address(text))?;
            Ok(ListenAddress::Tcp(address))
        }
        "udp" => {
            let options = Options::of(&url, &["reply_port", "lost_after_ms"])?;
            let reply_port = match options.text("reply_port") {
                Some(REPLY_TO_SENDER) => None,
                _ => Some(options.port("reply_port")?.unwrap_or(DEFAULT_REPLY_PORT)),
            };
            let lost_after = options.number("lost_after_ms", LOST_AFTER_MS)?;
            let lost_after = lost_after.map_or(LOST_AFTER, |ms| Duration::from_millis(ms.into()));
            let address = socket_address(&url, DEFAULT_UDP_PORT).ok_or_else(|| not_an_address(text))?;
            Ok(ListenAddress::Udp(address, Datagrams { reply_port, lost_after }))
        }
        _ => Err(not_an_address(text)),
    }
}

/// Returns the address in a URL, if its host is an IP address.
fn socket_address(url: &Url, default_port: u16) -> Option<SocketAddr> {
    let ip = url.host_str()?.trim_start_matches('[').trim_end_matches(']').parse().ok()?;
    Some(SocketAddr::new(ip, url.port().unwrap_or(default_port)))
}

fn not_an_address(text: &str) -> String {
    format!(
        "{text:?} is not an address of a WSG port: write 127.0.0.1:1000, or for UDP \
         udp://127.0.0.1:1500?reply_port=1501"
    )
}
