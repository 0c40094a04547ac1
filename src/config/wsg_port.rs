//! Settings of a WSG port, which serves a gripper over the WSG protocol itself.

use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::time::Duration;

use ipnet::IpNet;
use serde::Deserialize;
use url::Url;

use super::networks::parse_networks;
use super::{Config, ConfigError, ConfigPlace, DeviceSource, File, GripperConfig, GripperContent, Zenoh};
use crate::gripper::model::Name;
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

/// The WSG port of one gripper.
#[derive(Debug, Clone, PartialEq)]
pub struct WsgPort {
    /// Addresses that the port is served on, with their places in the configuration.
    pub addresses: Vec<(WsgAddress, ConfigPlace)>,
    /// Networks that may connect. If empty: known clients and loopback, or every client if the gateway needs no
    /// credentials (see `KnownPeers::allows`).
    pub allow: Vec<IpNet>,
    /// FAST STOPs that a client may acknowledge.
    pub acknowledge: AcknowledgePolicy,
    /// Whether the checksums of requests are checked.
    pub checksum_evaluation: bool,
    /// Settings that clients may change.
    pub limits: LimitsPolicy,
}

impl Default for WsgPort {
    fn default() -> Self {
        Self {
            addresses: Vec::new(),
            allow: Vec::new(),
            acknowledge: AcknowledgePolicy::default(),
            checksum_evaluation: true,
            limits: LimitsPolicy::default(),
        }
    }
}

/// Checks that each address serves one gripper. Otherwise a reload could leave a client with the wrong one.
pub(super) fn check_addresses(grippers: &[GripperConfig]) -> Result<(), ConfigError> {
    let mut served: Vec<(WsgAddress, &Name)> = Vec::new();
    for gripper in grippers {
        for (address, place) in &gripper.wsg_port.addresses {
            if let Some((_, other)) = served.iter().find(|(other, _)| other.is_same_socket(address)) {
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
            let WsgAddress::Udp { reply_port: Some(reply_port), .. } = address else { continue };
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
            if let WsgAddress::Udp { address, .. } = address {
                ports.push((address.port(), format!("the UDP WSG port of {name}")));
            }
        }
    }
    let zenoh = config.zenoh.iter().flat_map(Zenoh::udp_ports);
    ports.extend(zenoh.map(|port| (port, "a Zenoh endpoint of the gateway".to_owned())));
    if config.mdns {
        ports.push((MDNS_PORT, "the port of mDNS".to_owned()));
    }
    ports
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WsgAddress {
    Tcp(SocketAddr),
    Udp {
        /// Address that receives requests.
        address: SocketAddr,
        /// Port that replies go to; the sender's if `None`.
        reply_port: Option<u16>,
        /// Silence after which a client is lost, if configured.
        lost_after: Option<Duration>,
    },
}

impl WsgAddress {
    fn socket(&self) -> SocketAddr {
        let (Self::Tcp(address) | Self::Udp { address, .. }) = self;
        *address
    }

    /// Whether both need the same socket. With port 0, the system chooses a free one for each.
    fn is_same_socket(&self, other: &Self) -> bool {
        let are_of_one_kind = matches!(self, Self::Tcp(_)) == matches!(other, Self::Tcp(_));
        are_of_one_kind && self.socket() == other.socket() && self.socket().port() != 0
    }
}

/// FAST STOPs that a client may acknowledge with 24h.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AcknowledgePolicy {
    /// A FAST STOP that the client has seen, and that the client or the device caused.
    #[default]
    Own,
    /// Any FAST STOP.
    Any,
}

/// Limits of the gripper that clients may change. Existing drivers set the force limit at each start, so by default they
/// may change all of them, like on the gripper itself.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum LimitsPolicy {
    /// All of them.
    #[default]
    Open,
    /// No soft limits, no Overdrive Mode, and no force limit above the given one. Without one, no force limit.
    Fixed { max_force_n: Option<f32> },
}

/// Value of `wsg_port_limits`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum LimitsWord {
    #[default]
    Open,
    Fixed,
}

/// Returns the limits that clients may change, by the keys of a gripper.
fn limits(file: &File, gripper: &GripperContent) -> Result<LimitsPolicy, ConfigError> {
    let Some(max_force_n) = &gripper.wsg_port_max_force_n else {
        return Ok(match gripper.wsg_port_limits {
            LimitsWord::Open => LimitsPolicy::Open,
            LimitsWord::Fixed => LimitsPolicy::Fixed { max_force_n: None },
        });
    };
    // Like the forces on the line.
    let force_n = *max_force_n.get_ref() as f32;
    let detail = if !force_n.is_finite() || force_n <= 0.0 {
        format!("wsg_port_max_force_n is {force_n}; it must be a force in N above 0")
    } else if gripper.wsg_port_limits == LimitsWord::Open {
        "wsg_port_max_force_n has no effect while clients may change all limits: add wsg_port_limits = \"fixed\""
            .to_owned()
    } else {
        return Ok(LimitsPolicy::Fixed { max_force_n: Some(force_n) });
    };
    Err(ConfigError::at(&file.place(max_force_n.span().start), detail))
}

/// One text, or several.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
pub(super) enum OneOrMore {
    One(String),
    More(Vec<String>),
}

impl WsgPort {
    /// Parses the settings of a gripper in a file.
    pub(super) fn of_file(file: &File, gripper: &GripperContent) -> Result<Self, ConfigError> {
        let texts = match gripper.wsg_port.as_ref().map(|texts| (texts.span(), texts.get_ref())) {
            None => Vec::new(),
            Some((span, OneOrMore::One(text))) => vec![(text, file.place(span.start))],
            Some((span, OneOrMore::More(texts))) => texts.iter().map(|text| (text, file.place(span.start))).collect(),
        };
        let addresses = texts.into_iter().map(|(text, place)| Ok((parse(text, &place)?, place)));
        let allow = match &gripper.wsg_port_allow {
            Some(texts) => parse_networks("wsg_port_allow", texts.get_ref(), &file.place(texts.span().start))?,
            None => Vec::new(),
        };
        Ok(Self {
            addresses: addresses.collect::<Result<_, ConfigError>>()?,
            allow,
            acknowledge: gripper.wsg_port_acknowledge,
            checksum_evaluation: gripper.wsg_port_checksum_evaluation.unwrap_or(true),
            limits: limits(file, gripper)?,
        })
    }

    /// Whether both are the same, wherever they stand in the file.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        let addresses = |port: &Self| port.addresses.iter().map(|(address, _)| *address).collect::<Vec<_>>();
        let addresses = addresses(self) == addresses(other);
        addresses && Self { addresses: other.addresses.clone(), ..self.clone() } == *other
    }

    /// Checks that an address other than loopback comes with a list of allowed networks, with clients that are known by
    /// their addresses, or with `--insecure`.
    pub(super) fn check(&self, may_be_exposed: bool) -> Result<(), ConfigError> {
        for (address, place) in &self.addresses {
            let address = address.socket();
            if !address.ip().is_loopback() && self.allow.is_empty() && !may_be_exposed {
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
    let mut given: Vec<(&str, WsgAddress)> = Vec::new();
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

fn parse(text: &str, place: &ConfigPlace) -> Result<WsgAddress, ConfigError> {
    parse_address(text).map_err(|detail| ConfigError::at(place, detail))
}

fn parse_address(text: &str) -> Result<WsgAddress, String> {
    if let Ok(address) = text.parse() {
        return Ok(WsgAddress::Tcp(address));
    }
    let wrong = || {
        format!(
            "{text:?} is not an address of a WSG port: write 127.0.0.1:1000, or for UDP \
             udp://127.0.0.1:1500?reply_port=1501"
        )
    };
    let url: Url = text.parse().map_err(|_| wrong())?;
    let host = url.host_str().unwrap_or_default().trim_start_matches('[').trim_end_matches(']');
    let address = |default| {
        let ip = host.parse().map_err(|_| wrong())?;
        Ok::<_, String>(SocketAddr::new(ip, url.port().unwrap_or(default)))
    };
    match url.scheme() {
        "tcp" => {
            Options::of(&url, &[])?;
            Ok(WsgAddress::Tcp(address(DEFAULT_TCP_PORT)?))
        }
        "udp" => {
            let options = Options::of(&url, &["reply_port", "lost_after_ms"])?;
            let reply_port = match options.text("reply_port") {
                Some(REPLY_TO_SENDER) => None,
                _ => Some(options.port("reply_port")?.unwrap_or(DEFAULT_REPLY_PORT)),
            };
            let lost_after = options.number("lost_after_ms", LOST_AFTER_MS)?;
            let lost_after = lost_after.map(|ms| Duration::from_millis(ms.into()));
            Ok(WsgAddress::Udp { address: address(DEFAULT_UDP_PORT)?, reply_port, lost_after })
        }
        _ => Err(wrong()),
    }
}
