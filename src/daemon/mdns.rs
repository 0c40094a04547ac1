//! The announcement on the local network: multicast DNS (RFC 6762) with service discovery (RFC 6763).

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use mdns_sd::{IfKind, ServiceDaemon, ServiceInfo};
use tokio::time::timeout;

use crate::config::Config;

/// Service type of gateways (RFC 6763, 4.1.2).
const SERVICE: &str = "_wsg-gateway._tcp.local.";

/// Host name where the system has none.
const DEFAULT_HOST: &str = "wsg-gateway";

/// Longest label of a host name (RFC 1035, 2.3.4).
const MAX_LABEL_BYTES: usize = 63;

/// Time limit for sending the packets that withdraw an announcement.
const WITHDRAWN_WITHIN: Duration = Duration::from_millis(500);

/// An announced gateway, until it is withdrawn.
pub(super) struct Announcement(ServiceDaemon);

impl Announcement {
    /// Announces the gateway at this address if the configuration says so. If the announcement fails, the gateway runs
    /// without it.
    pub(super) fn of(config: &Config, address: SocketAddr) -> Option<Self> {
        let announced = config.web.mdns.then(|| Self::announce(config, address));
        announced?.inspect_err(|error| tracing::warn!(%error, "gateway not announced by mDNS")).ok()
    }

    fn announce(config: &Config, address: SocketAddr) -> mdns_sd::Result<Self> {
        let properties = [("version", env!("CARGO_PKG_VERSION")), ("scheme", config.scheme()), ("path", "/")];
        let name = config.name.as_str();
        // The addresses are those of the interfaces that are up, now or later.
        let service = ServiceInfo::new(SERVICE, name, &host(), (), address.port(), &properties[..])?.enable_addr_auto();
        let announcement = Self(ServiceDaemon::new()?);
        announcement.restrict(address.ip()).and_then(|()| announcement.0.register(service)).inspect_err(|_| {
            // Otherwise its thread continues.
            let _ = announcement.0.shutdown();
        })?;
        Ok(announcement)
    }

    /// Leaves out interfaces that HTTP is not served on.
    fn restrict(&self, address: IpAddr) -> mdns_sd::Result<()> {
        match address {
            IpAddr::V4(address) if address.is_unspecified() => self.0.disable_interface(IfKind::IPv6),
            IpAddr::V6(address) if address.is_unspecified() => Ok(()),
            address => {
                self.0.disable_interface(IfKind::All)?;
                self.0.enable_interface(address)
            }
        }
    }

    /// Withdraws the announcement, so that others forget the gateway at once.
    pub(super) async fn withdraw(self) {
        if let Ok(ended) = self.0.shutdown() {
            // The time to live of the announcement covers lost packets, too.
            let _ = timeout(WITHDRAWN_WITHIN, ended.recv_async()).await;
        }
    }
}

/// Returns this machine's name on the local network. Only the first label of a domain name counts.
fn host() -> String {
    let system = rustix::system::uname();
    let name = system.nodename().to_str().ok().and_then(|name| name.split('.').next());
    let usable = name.filter(|name| (1..=MAX_LABEL_BYTES).contains(&name.len()) && *name != "localhost");
    format!("{}.local.", usable.unwrap_or(DEFAULT_HOST))
}
