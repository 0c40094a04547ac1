//! The announcement on the local network: multicast DNS (RFC 6762) with service discovery (RFC 6763).

use std::net::SocketAddr;
use std::time::Duration;

use mdns_sd::{IfKind, ServiceDaemon, ServiceInfo};
use tokio::time::timeout;

use crate::config::Config;

/// Service type of gateways (RFC 6763, 4.1.2).
const SERVICE: &str = "_wsg-gateway._tcp.local.";

/// Host name where the system has none.
const DEFAULT_HOST: &str = "wsg-gateway";

/// Time for the packets that withdraw an announcement.
const WITHDRAWN_WITHIN: Duration = Duration::from_millis(500);

/// An announced gateway. Dropping this does not withdraw the announcement.
pub(super) struct Announcement(ServiceDaemon);

impl Announcement {
    /// Announces the gateway at this address, on the interface that has it, if the configuration says so. A gateway that
    /// cannot be announced is served all the same.
    pub(super) fn of(config: &Config, address: SocketAddr) -> Option<Self> {
        let announced = config.mdns.then(|| Self::announce(config, address));
        announced?.inspect_err(|error| tracing::warn!(%error, "gateway not announced by mDNS")).ok()
    }

    fn announce(config: &Config, address: SocketAddr) -> mdns_sd::Result<Self> {
        let scheme = if config.tls.is_some() { "https" } else { "http" };
        let properties = [("version", env!("CARGO_PKG_VERSION")), ("scheme", scheme), ("path", "/")];
        let (name, host, port) = (config.name.as_str(), host(), address.port());
        let daemon = ServiceDaemon::new()?;
        let service = if address.ip().is_unspecified() {
            ServiceInfo::new(SERVICE, name, &host, (), port, &properties[..])?.enable_addr_auto()
        } else {
            daemon.disable_interface(IfKind::All)?;
            daemon.enable_interface(address.ip())?;
            ServiceInfo::new(SERVICE, name, &host, address.ip(), port, &properties[..])?
        };
        daemon.register(service)?;
        Ok(Self(daemon))
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
    format!("{}.local.", name.filter(|name| !name.is_empty() && *name != "localhost").unwrap_or(DEFAULT_HOST))
}
