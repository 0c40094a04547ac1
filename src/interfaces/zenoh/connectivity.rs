//! Whether the gateway listens wherever it is to, and is connected. Zenoh tries each endpoint again until it can be had, and
//! tells nobody.

use std::net::{IpAddr, TcpListener};
use std::time::Duration;

use zenoh::config::EndPoint;

use crate::fleet::Peers;
use crate::interfaces::sockets::remedy;

/// How often it is looked at: at first, and where it takes longer.
const LOOKS_AFTER: Duration = Duration::from_millis(10);
const LOOKS_EVERY: Duration = Duration::from_secs(1);

/// From when on it takes longer than it does by itself.
const TAKES_LONG: Duration = Duration::from_millis(300);

/// The files that an endpoint with TLS needs.
const FILES: [&str; 5] =
    ["root_ca_certificate", "listen_certificate", "listen_private_key", "connect_certificate", "connect_private_key"];

/// Where the gateway is to be reached, and how.
#[derive(Debug, Clone)]
pub struct Connectivity {
    /// Zenoh's own configuration.
    pub config: zenoh::Config,
    /// Where it is to listen.
    pub listen: Vec<String>,
    /// To what it is to connect: to one of them at least.
    pub connect: Vec<String>,
}

impl Connectivity {
    /// Watches for as long as it is polled; tells where it listens, and says on the network's behalf where it does not, or
    /// is connected to nothing, and why.
    pub async fn watch(&self, session: &zenoh::Session, network: &Peers, mut opened: impl FnMut(&[String])) {
        let (mut told, mut looks_after, mut was_connected) = (Vec::new(), LOOKS_AFTER, false);
        loop {
            let mut locators: Vec<_> = session.info().locators().await.iter().map(ToString::to_string).collect();
            let missing = missing(&self.listen, &locators);
            locators.retain(|locator| !told.contains(locator));
            opened(&locators);
            told.extend(locators);
            let unconnected = self.unconnected(session).await;
            // A connection that is made again at once is not told of.
            let is_just_lost = std::mem::replace(&mut was_connected, unconnected.is_none()) && unconnected.is_some();
            if missing.is_empty() && unconnected.is_none() {
                say(network, None);
            } else if looks_after >= TAKES_LONG && !is_just_lost {
                let mut causes = self.why_not_at(missing.into_iter().map(ToOwned::to_owned).collect()).await;
                causes.extend(unconnected);
                say(network, Some(causes.join("; ")));
            }
            tokio::time::sleep(looks_after).await;
            looks_after = (looks_after * 2).min(LOOKS_EVERY);
        }
    }

    /// Why nothing listens at these endpoints. Who looks may have to wait for a name.
    async fn why_not_at(&self, endpoints: Vec<String>) -> Vec<String> {
        let config = self.config.clone();
        let look = move || endpoints.iter().map(|endpoint| why_not(&config, endpoint)).collect();
        tokio::task::spawn_blocking(look).await.unwrap_or_default()
    }

    /// Says that it is connected to nothing of what it is to be connected to.
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

    /// What is said while it is connected to nothing; none where it is to connect to nothing.
    #[must_use]
    pub fn awaited(&self) -> Option<String> {
        let awaited = self.connect.join(" and ");
        (!self.connect.is_empty()).then(|| {
            format!("Zenoh is not connected to {awaited}, and tries again: start what is to be there, or see --zenoh-connect")
        })
    }
}

/// Says why it is not on the network as it should be, or that it is: once.
pub fn say(network: &Peers, cause: Option<String>) {
    if *network.cause().borrow() != cause {
        if let Some(cause) = &cause {
            tracing::warn!(cause, "Zenoh is not as it should be, and is tried again: the grippers are served");
        } else {
            tracing::info!("Zenoh is as it should be");
        }
        network.set_cause(cause);
    }
}

/// Those of these endpoints where nothing listens.
fn missing<'a>(listen: &'a [String], locators: &[String]) -> Vec<&'a str> {
    let mut open: Vec<_> = locators.iter().filter_map(|locator| Place::of(locator)).collect();
    let mut wanted: Vec<_> =
        listen.iter().filter_map(|endpoint| Some((endpoint.as_str(), Place::of(endpoint)?))).collect();
    // Who takes any port leaves the others theirs.
    wanted.sort_by_key(|(_, place)| place.port == 0);
    wanted.retain(|(_, wanted)| {
        let found = open.iter().position(|open| wanted.is_at(open));
        found.map(|found| open.swap_remove(found)).is_none()
    });
    wanted.into_iter().map(|(endpoint, _)| endpoint).collect()
}

/// Where an endpoint is.
#[derive(Debug)]
struct Place {
    protocol: String,
    host: Option<IpAddr>,
    port: u16,
}

impl Place {
    fn of(endpoint: &str) -> Option<Self> {
        let endpoint: EndPoint = endpoint.parse().ok()?;
        let (protocol, address) = (endpoint.protocol().as_str().to_owned(), endpoint.address().as_str().to_owned());
        let (host, port) = address.rsplit_once(':')?;
        let host = host.trim_matches(['[', ']']).parse().ok().filter(|host: &IpAddr| !host.is_unspecified());
        Some(Self { protocol, host, port: port.parse().ok()? })
    }

    /// Whether a link to this end may lead there: where two connect to each other, one of them has only a link that the
    /// other has made, which ends at a port of its own.
    fn is_reached_by(&self, end: &Self) -> bool {
        let is_host = self.host.is_none_or(|host| !host.is_loopback() && end.host == Some(host));
        self.is_at(end) || (self.protocol == end.protocol && is_host)
    }

    /// One by a name, or at all addresses, may be anywhere.
    fn is_at(&self, open: &Self) -> bool {
        self.protocol == open.protocol
            && (self.port == 0 || self.port == open.port)
            && self.host.zip(open.host).is_none_or(|(host, open)| host == open)
    }
}

/// Why nothing listens at an endpoint, and what helps.
fn why_not(config: &zenoh::Config, endpoint: &str) -> String {
    let why = match endpoint.parse::<EndPoint>() {
        Ok(parsed) => match TcpListener::bind(parsed.address().as_str()) {
            Err(error) => format!("{}, with --zenoh-listen: {error}", remedy(error.kind())),
            Ok(_) if parsed.protocol().as_str() == "tls" => unreadable(config).unwrap_or_else(|| {
                "look at its certificates and keys in Zenoh's own configuration, below transport/link/tls".to_owned()
            }),
            Ok(_) => "it is free by now".to_owned(),
        },
        Err(error) => error.to_string(),
    };
    format!("Zenoh does not listen at {endpoint}: {why}")
}

/// The first file for TLS that can't be read.
fn unreadable(config: &zenoh::Config) -> Option<String> {
    FILES.into_iter().find_map(|key| {
        let path = config.get_json(&format!("transport/link/tls/{key}")).ok()?;
        let path: String = serde_json::from_str::<Option<String>>(&path).ok()??;
        let error = std::fs::read(&path).err()?;
        Some(format!("{path} can't be read, which is its {key} in Zenoh's own configuration: {error}"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_told_apart_by_protocol_address_and_port() {
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
    fn what_is_reached_is_told_apart_from_who_has_come() {
        let is_reached =
            |endpoint: &str, end: &str| Place::of(endpoint).unwrap().is_reached_by(&Place::of(end).unwrap());
        assert!(is_reached("tcp/127.0.0.1:7447", "tcp/127.0.0.1:7447"));
        assert!(!is_reached("tcp/127.0.0.1:7447", "tcp/127.0.0.1:40312"), "another one of this machine");
        assert!(is_reached("tcp/10.0.0.7:7447", "tcp/10.0.0.7:40312"), "it has connected to us");
        assert!(!is_reached("tcp/10.0.0.7:7447", "tcp/10.0.0.8:40312"));
        assert!(is_reached("tcp/router:7447", "tcp/10.0.0.8:40312"), "a name may be anywhere");
        assert!(!is_reached("tls/router:7447", "tcp/10.0.0.8:7447"));
    }

    #[test]
    fn why_not_names_what_helps() {
        let mut config = zenoh::Config::default();
        let taken = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = taken.local_addr().unwrap();
        let why = why_not(&config, &format!("tcp/{address}"));
        assert!(
            why.contains(&format!("tcp/{address}: choose another address")) && why.contains("--zenoh-listen"),
            "{why}"
        );
        config.insert_json5("transport/link/tls/listen_certificate", r#""/nowhere/gateway.pem""#).unwrap();
        let why = why_not(&config, "tls/127.0.0.1:0");
        assert!(why.contains("/nowhere/gateway.pem") && why.contains("its listen_certificate"), "{why}");
        assert!(!why.contains("--zenoh-listen"), "{why}");
    }
}
