//! File descriptors: the limit of the process and its shares, so that no client can take the descriptors that a
//! device, the journal or a FAST STOP needs.

use rustix::process::{Resource, getrlimit, setrlimit};

use crate::config::{Config, DeviceSource};
use crate::connections::Bounds;
use crate::interfaces::wsg_port::ListenAddress;

/// The gateway itself: five runtimes with sockets (20), the listener, standard input and output, the journal with its
/// readers (8), and some to spare.
const OWN: usize = 34;

/// A webhook: its connection, and that of a test.
const OF_A_WEBHOOK: usize = 2;

/// The connections of MQTT, each with the one that replaces it.
const OF_MQTT: usize = 6;

/// A gripper's link, and the link that replaces it. A simulated gripper has none.
const OF_A_LINK: usize = 2;

/// Zenoh's runtimes and its listener.
const OF_ZENOH: usize = 13;

/// The runtime of Modbus.
const OF_MODBUS: usize = 4;

/// The announcement by mDNS: a socket each for IPv4 and IPv6, and the descriptors of its thread.
const OF_MDNS: usize = 8;

/// Highest soft limit that is requested: more would be useless, and some systems have no hard limit.
const MOST: u64 = 65_536;

/// Shares of the descriptors for clients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Shares {
    /// The limit of the process.
    pub(super) limit: usize,
    /// Descriptors of all HTTP connections.
    pub(super) http: usize,
    /// Descriptors of each WSG port's TCP connections, and of Modbus.
    pub(super) wsg_port: usize,
}

/// The descriptor limit is below what the configuration needs.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "too few file descriptors: the limit is {limit}, but this configuration needs {needed}: raise the limit with \
     `ulimit -n` or LimitNOFILE= in the systemd unit"
)]
pub(super) struct TooFew {
    limit: usize,
    needed: usize,
}

/// Raises the soft limit of the process as far as possible, and shares out the descriptors.
pub(super) fn share_out(config: &Config) -> Result<Shares, TooFew> {
    Shares::of(config, raise_limit())
}

/// Tries to raise the limit, and returns the resulting one.
fn raise_limit() -> usize {
    let before = getrlimit(Resource::Nofile);
    let wanted = before.maximum.unwrap_or(MOST).min(MOST);
    let soft = before.current.unwrap_or(MOST);
    let mut raised = before;
    raised.current = Some(wanted.max(soft));
    let limit = match setrlimit(Resource::Nofile, raised) {
        Ok(()) => wanted.max(soft),
        Err(error) => {
            tracing::warn!(%error, soft, wanted, "file descriptor limit could not be raised");
            soft
        }
    };
    usize::try_from(limit).unwrap_or(usize::MAX)
}

impl Shares {
    /// Returns the share of each WSG port with another configuration. HTTP and the ports in use keep their shares.
    pub(super) fn of_ports(&self, config: &Config) -> Result<usize, TooFew> {
        let (own, ports) = needs(config);
        let in_use = self.wsg_port.max(Bounds::MIN_ALIKE);
        let needed = own + self.http + ports * in_use;
        let free = self.limit.saturating_sub(own + self.http);
        match free.checked_div(ports) {
            Some(share) if share < in_use => Err(TooFew { limit: self.limit, needed }),
            _ if needed > self.limit => Err(TooFew { limit: self.limit, needed }),
            share => Ok(share.unwrap_or_default().min(Bounds::MAX_ALIKE)),
        }
    }

    fn of(config: &Config, limit: usize) -> Result<Self, TooFew> {
        let (own, ports) = needs(config);
        let needed = own + Bounds::MIN_DESCRIPTORS + ports * Bounds::MIN_ALIKE;
        let spare = limit.checked_sub(needed).ok_or(TooFew { limit, needed })?;
        // The WSG ports have few clients, so they get a quarter of the spare descriptors.
        let of_ports = (spare / 4).checked_div(ports).unwrap_or(0);
        let wsg_port = (Bounds::MIN_ALIKE + of_ports).min(Bounds::MAX_ALIKE);
        let http = limit - own - ports * wsg_port;
        Ok(Self { limit, http: http.min(Bounds::MAX_DESCRIPTORS), wsg_port })
    }
}

/// Returns the descriptors that the gateway itself needs, and the number of WSG ports with TCP clients. Modbus is one more.
fn needs(config: &Config) -> (usize, usize) {
    let addresses = config.grippers.iter().flat_map(|gripper| &gripper.wsg_port.addresses);
    let tcp_ports = addresses.filter(|(address, _)| matches!(address, ListenAddress::Tcp(_))).count();
    let ports = tcp_ports + usize::from(config.modbus.is_some());
    let zenoh = if config.zenoh.is_some() { OF_ZENOH } else { 0 };
    let links = config.grippers.iter().filter(|gripper| matches!(gripper.device, DeviceSource::At(_))).count();
    let mdns = if config.web.mdns { OF_MDNS } else { 0 };
    let modbus = if config.modbus.is_some() { OF_MODBUS } else { 0 };
    let mqtt = if config.mqtt.is_some() { OF_MQTT } else { 0 };
    (OWN + OF_A_LINK * links + OF_A_WEBHOOK * config.webhooks.len() + zenoh + mdns + modbus + mqtt, ports)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Flags;

    fn config(grippers: &[&str], wsg_ports: &[&str]) -> Config {
        let owned = |texts: &[&str]| texts.iter().map(ToString::to_string).collect();
        let flags = Flags { grippers: owned(grippers), wsg_ports: owned(wsg_ports), ..Flags::default() };
        Config::load(&flags).unwrap()
    }

    #[test]
    fn low_limit_leaves_every_interface_a_share() {
        let defaults = config(&[], &[]);
        let low = Shares::of(&defaults, 64).unwrap();
        assert!(low.http >= Bounds::MIN_DESCRIPTORS, "{low:?}");
        let high = Shares::of(&defaults, 20_000).unwrap();
        assert_eq!(high.http, Bounds::MAX_DESCRIPTORS);
    }

    #[test]
    fn further_ports_get_a_share_while_the_others_keep_theirs() {
        let shares = Shares::of(&config(&[], &[]), 20_000).unwrap();
        let more = config(&["g=tcp://127.0.0.1:1000"], &["g=127.0.0.1:0"]);
        assert_eq!(shares.of_ports(&more), Ok(Bounds::MAX_ALIKE));
        let full = Shares::of(&config(&[], &[]), 128).unwrap();
        assert!(full.of_ports(&more).unwrap_err().to_string().contains("ulimit -n"));
        assert_eq!(full.of_ports(&config(&[], &[])), Ok(0));
    }

    #[test]
    fn too_low_limit_names_its_remedy() {
        let error = Shares::of(&config(&[], &[]), 32).unwrap_err().to_string();
        assert!(error.contains("the limit is 32") && error.contains("ulimit -n"), "{error}");
    }

    #[test]
    fn shares_stay_within_the_limit() {
        let config = config(&["g=tcp://127.0.0.1:1000"], &["g=127.0.0.1:0"]);
        for limit in [64, 128, 600, 1024, 20_000] {
            let shares = Shares::of(&config, limit).unwrap();
            assert!(OWN + OF_A_LINK + OF_ZENOH + shares.http + shares.wsg_port <= limit, "{shares:?}");
            assert!(shares.wsg_port >= Bounds::MIN_ALIKE && shares.http >= Bounds::MIN_DESCRIPTORS);
        }
    }
}
