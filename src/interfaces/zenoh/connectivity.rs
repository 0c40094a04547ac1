//! Monitor of Zenoh's endpoints: whether the gateway listens and is connected as configured. Zenoh itself retries each
//! endpoint without reporting failures.

use std::io;
use std::net::{IpAddr, TcpListener, UdpSocket};
use std::time::Duration;

use zenoh::config::EndPoint;

use crate::connections::sockets::remedy;
use crate::fleet::Peers;

/// First and longest interval of the checks.
const LOOKS_AFTER: Duration = Duration::from_millis(10);
const LOOKS_EVERY: Duration = Duration::from_secs(1);

/// Interval from which on a missing endpoint is reported; opening normally takes less time.
const TAKES_LONG: Duration = Duration::from_millis(300);

/// Configuration keys of the files that a QUIC or TLS endpoint needs.
const FILES: [&str; 5] =
    ["root_ca_certificate", "listen_certificate", "listen_private_key", "connect_certificate", "connect_private_key"];

/// Endpoints and configuration of the gateway's Zenoh session.
#[derive(Debug, Clone)]
pub struct Connectivity {
    pub config: zenoh::Config,
    pub listen: Vec<String>,
    /// Endpoints to connect to; one connection is enough.
    pub connect: Vec<String>,
}

impl Connectivity {
    /// Returns the configuration with which a session opens only if it can listen on all endpoints. Returns `None`
    /// without endpoints, if one has an `exit_on_failure` of its own, or if a name service that is down could delay one.
    #[must_use]
    pub fn without_retries(&self) -> Option<zenoh::Config> {
        if self.listen.is_empty() || !self.listen.iter().all(|endpoint| opens_at_once(endpoint)) {
            return None;
        }
        let mut config = self.config.clone();
        config.insert_json5("listen/timeout_ms", "0").ok()?;
        config.insert_json5("listen/exit_on_failure", "true").ok()?;
        Some(config)
    }

    /// Watches the endpoints while it is polled. Calls `opened` with new locators, and reports connections and, unless
    /// the session `listens_everywhere`, listeners that are missing, with their causes.
    pub async fn watch(
        &self,
        session: &zenoh::Session,
        listens_everywhere: bool,
        network: &Peers,
        mut opened: impl FnMut(&[String]),
    ) {
        let mut known = Vec::new();
        let mut looks_after = LOOKS_AFTER;
        let mut was_connected = false;
        loop {
            let mut locators: Vec<_> = session.info().locators().await.iter().map(ToString::to_string).collect();
            // The list can lack an open listener: for 0.0.0.0, it has only addresses beyond loopback of interfaces that
            // were up when Zenoh first looked.
            let missing = if listens_everywhere { Vec::new() } else { missing(&self.listen, &locators) };
            locators.retain(|locator| !known.contains(locator));
            opened(&locators);
            known.extend(locators);
            let unconnected = self.unconnected(session).await;
            // A connection that is re-established at once is not reported.
            let is_just_lost = std::mem::replace(&mut was_connected, unconnected.is_none()) && unconnected.is_some();
            if missing.is_empty() && unconnected.is_none() {
                report_connection(network, None);
            } else if looks_after >= TAKES_LONG && !is_just_lost {
                let mut causes = self.why_not_at(missing.into_iter().map(ToOwned::to_owned).collect()).await;
                causes.extend(unconnected);
                report_connection(network, Some(causes.join("; ")));
            }
            tokio::time::sleep(looks_after).await;
            looks_after = (looks_after * 2).min(LOOKS_EVERY);
        }
    }

    /// Returns why nothing listens at these endpoints. Runs on a blocking thread, since name resolution can block.
    async fn why_not_at(&self, endpoints: Vec<String>) -> Vec<String> {
        let config = self.config.clone();
        let causes = tokio::task::spawn_blocking(move || {
            endpoints.iter().map(|endpoint| why_not(&config, endpoint)).collect::<Vec<_>>()
        });
        causes.await.unwrap_or_default()
    }

    /// Returns the cause if none of the configured endpoints is connected.
    async fn unconnected(&self, session: &zenoh::Session) -> Option<String> {
        let connect = self.awaited()?;
        let info = session.info();
        let others: Vec<_> = info.routers_zid().await.chain(info.peers_zid().await).collect();
        let links = info.links().await.filter(|link| others.contains(link.zid()));
        let ends: Vec<_> = links.filter_map(|link| Place::of(&link.dst().to_string())).collect();
        let mut wanted = self.connect.iter().filter_map(|endpoint| Place::of(endpoint));
        let is_connected = wanted.any(|wanted| ends.iter().any(|end| wanted.is_reached_by(end)));
        (!is_connected).then_some(connect)
    }

    /// Returns the message for a missing connection; `None` if no endpoint is configured.
    #[must_use]
    pub fn awaited(&self) -> Option<String> {
        let awaited = self.connect.join(" and ");
        (!self.connect.is_empty()).then(|| {
            format!(
                "Zenoh is not connected to {awaited}; retrying: start the router or gateway there, or check \
                 --zenoh-connect"
            )
        })
    }
}

/// Logs and publishes a change of Zenoh's connection state; `None` means connected.
pub fn report_connection(network: &Peers, cause: Option<String>) {
    if *network.cause().borrow() != cause {
        if let Some(cause) = &cause {
            tracing::warn!(cause, "Zenoh connection degraded; retrying");
        } else {
            tracing::info!("Zenoh connected");
        }
        network.set_cause(cause);
    }
}

/// Returns the endpoints that nothing listens on.
fn missing<'a>(listen: &'a [String], locators: &[String]) -> Vec<&'a str> {
    let mut open: Vec<_> = locators.iter().filter_map(|locator| Place::of(locator)).collect();
    let mut wanted: Vec<_> =
        listen.iter().filter_map(|endpoint| Some((endpoint.as_str(), Place::of(endpoint)?))).collect();
    // Match endpoints with any port last, so that they don't take the locators of others.
    wanted.sort_by_key(|(_, place)| place.port == 0);
    wanted.retain(|(_, wanted)| {
        let found = open.iter().position(|open| wanted.is_at(open));
        found.map(|found| open.swap_remove(found)).is_none()
    });
    wanted.into_iter().map(|(endpoint, _)| endpoint).collect()
}

#[derive(Debug)]
struct Place {
    protocol: String,
    host: Option<IpAddr>,
    port: u16,
}

impl Place {
    fn of(endpoint: &str) -> Option<Self> {
        let endpoint: EndPoint = endpoint.parse().ok()?;
        let protocol = endpoint.protocol().as_str().to_owned();
        let address = endpoint.address().as_str().to_owned();
        let (host, port) = address.rsplit_once(':')?;
        let host = host.trim_matches(['[', ']']).parse().ok().filter(|host: &IpAddr| !host.is_unspecified());
        Some(Self { protocol, host, port: port.parse().ok()? })
    }

    /// Whether a link with this remote end can lead to this place. If two gateways connect to each other, one of them
    /// only has the link that the other made, whose remote end is an ephemeral port.
    fn is_reached_by(&self, end: &Self) -> bool {
        let is_host = self.host.is_none_or(|host| !host.is_loopback() && end.host == Some(host));
        self.is_at(end) || (self.protocol == end.protocol && is_host)
    }

    /// Whether this place matches an open one. A place with a host name or all addresses matches any host.
    fn is_at(&self, open: &Self) -> bool {
        self.protocol == open.protocol
            && (self.port == 0 || self.port == open.port)
            && self.host.zip(open.host).is_none_or(|(host, open)| host == open)
    }
}

/// Returns why nothing listens at an endpoint, and the remedy.
fn why_not(config: &zenoh::Config, endpoint: &str) -> String {
    let why = match endpoint.parse::<EndPoint>() {
        Ok(parsed) => match (bind(&parsed), parsed.protocol().as_str()) {
            (Err(error), _) => format!("{} (--zenoh-listen): {error}", remedy(error.kind())),
            (Ok(()), "quic" | "tls") => unreadable(config).unwrap_or_else(|| {
                "check its certificates and keys in the Zenoh configuration, below transport/link/tls".to_owned()
            }),
            (Ok(()), _) => "the address is free now; retrying".to_owned(),
        },
        Err(error) => error.to_string(),
    };
    format!("Zenoh cannot listen on {endpoint}: {why}")
}

/// Whether an endpoint leaves `exit_on_failure` to the session, and needs no name service.
fn opens_at_once(endpoint: &str) -> bool {
    let Ok(endpoint) = endpoint.parse::<EndPoint>() else { return false };
    endpoint.config().get("exit_on_failure").is_none() && is_known_host(endpoint.address().as_str())
}

/// Whether the host is an IP address, or a name that the machine knows itself.
fn is_known_host(address: &str) -> bool {
    let host = address.rsplit_once(':').map_or("", |(host, _)| host);
    host == "localhost" || host.trim_matches(['[', ']']).parse::<IpAddr>().is_ok()
}

/// Binds the endpoint's address for a moment.
fn bind(endpoint: &EndPoint) -> io::Result<()> {
    let address = endpoint.address();
    match endpoint.protocol().as_str() {
        "quic" => UdpSocket::bind(address.as_str()).map(drop),
        _ => TcpListener::bind(address.as_str()).map(drop),
    }
}

/// Returns the cause of the first TLS file that can't be read.
fn unreadable(config: &zenoh::Config) -> Option<String> {
    FILES.into_iter().find_map(|key| {
        let path = config.get_json(&format!("transport/link/tls/{key}")).ok()?;
        let path: String = serde_json::from_str::<Option<String>>(&path).ok()??;
        let error = std::fs::read(&path).err()?;
        Some(format!("{path} cannot be read ({key} in the Zenoh configuration): {error}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn missing_endpoints_match_by_protocol_address_and_port() {
        let missing = |listen: &[&str], locators: &[&str]| {
            let owned = |texts: &[&str]| texts.iter().map(|&text| text.to_owned()).collect::<Vec<_>>();
            missing(&owned(listen), &owned(locators)).join(" ")
        };
        assert_eq!(missing(&["tcp/127.0.0.1:0#so_sndbuf=4096"], &["tcp/127.0.0.1:34567"]), "");
        assert_eq!(missing(&["tcp/127.0.0.1:7447", "tcp/10.0.0.7:7447"], &["tcp/10.0.0.7:7447"]), "tcp/127.0.0.1:7447");
        let everywhere = ["tcp/10.0.0.7:7447", "tcp/127.0.0.1:7447", "tcp/[::1]:7447"];
        assert_eq!(missing(&["tcp/0.0.0.0:7447", "tls/0.0.0.0:7448"], &everywhere), "tls/0.0.0.0:7448");
        assert_eq!(missing(&["tcp/127.0.0.1:0", "tcp/127.0.0.1:7447"], &["tcp/127.0.0.1:7447"]), "tcp/127.0.0.1:0");
        assert_eq!(missing(&["tls/localhost:7447"], &["tls/127.0.0.1:7447"]), "");
        assert_eq!(missing(&["tcp/[::1]:7447"], &[]), "tcp/[::1]:7447");
    }

    #[test]
    fn only_hosts_that_need_no_name_service_are_opened_at_once() {
        let opens_at_once = |listen: &[&str]| {
            let listen = listen.iter().map(|&endpoint| endpoint.to_owned()).collect();
            Connectivity { config: zenoh::Config::default(), listen, connect: Vec::new() }.without_retries().is_some()
        };
        assert!(opens_at_once(&["tcp/127.0.0.1:0", "tcp/[::1]:7447", "quic/localhost:0", "tcp/0.0.0.0:7447#iface=lo"]));
        assert!(!opens_at_once(&[]));
        assert!(!opens_at_once(&["tcp/127.0.0.1:7447", "tcp/gateway.example:7447"]));
        assert!(!opens_at_once(&["tcp/127.0.0.1:7447#exit_on_failure=false"]));
    }

    #[test]
    fn outgoing_links_differ_from_incoming_ones() {
        let is_reached =
            |endpoint: &str, end: &str| Place::of(endpoint).unwrap().is_reached_by(&Place::of(end).unwrap());
        assert!(is_reached("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7447"));
        assert!(!is_reached("tcp/127.0.0.1:7447", "tcp/127.0.0.1:40312"), "another client on this machine");
        assert!(is_reached("tcp/10.0.0.7:7447", "tcp/10.0.0.7:40312"), "the other side connected to us");
        assert!(!is_reached("tcp/10.0.0.7:7447", "tcp/10.0.0.8:40312"));
        assert!(is_reached("tcp/router:7447", "tcp/10.0.0.8:40312"), "a host name matches any address");
        assert!(!is_reached("tls/router:7447", "tcp/10.0.0.8:7447"));
    }

    #[test]
    fn cause_names_the_remedy() {
        let mut config = zenoh::Config::default();
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = taken.local_addr().unwrap();
        let why = why_not(&config, &format!("tcp/{address}"));
        assert!(
            why.contains(&format!("tcp/{address}: choose another address")) && why.contains("--zenoh-listen"),
            "{why}"
        );
        let free = why_not(&config, &format!("quic/{address}"));
        assert!(free.contains("transport/link/tls"), "a TCP listener does not occupy the UDP port: {free}");
        let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
        let why = why_not(&config, &format!("quic/{}", taken.local_addr().unwrap()));
        assert!(why.contains("choose another address"), "{why}");
        config.insert_json5("transport/link/tls/listen_certificate", r#""/nowhere/gateway.pem""#).unwrap();
        for endpoint in ["quic/127.0.0.1:0", "tls/127.0.0.1:0"] {
            let why = why_not(&config, endpoint);
            assert!(why.contains("/nowhere/gateway.pem") && why.contains("listen_certificate in"), "{why}");
            assert!(!why.contains("--zenoh-listen"), "{why}");
        }
    }
}
