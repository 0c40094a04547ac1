//! Whether the gateway listens wherever it is to, and is connected. Zenoh tries each endpoint again until it can be had, and
//! tells nobody.

use std::net::{IpAddr, TcpListener};
use std::time::Duration;

use zenoh::config::EndPoint;

use crate::frontend::network::Network;
use crate::frontend::sockets::remedy;

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
pub struct Reach {
    /// Zenoh's own configuration.
    pub config: zenoh::Config,
    /// Where it is to listen.
    pub listen: Vec<String>,
    /// To what it is to connect: to one of them at least.
    pub connect: Vec<String>,
}

impl Reach {
    /// Watches for as long as it is polled; tells where it listens, and says on the network's behalf where it does not, or
    /// is connected to nothing, and why.
    pub async fn watch(&self, session: &zenoh::Session, network: &Network, mut opened: impl FnMut(&[String])) {
        let (mut told, mut looks_after) = (Vec::new(), LOOKS_AFTER);
        loop {
            let mut locators: Vec<_> = session.info().locators().await.iter().map(ToString::to_string).collect();
            let missing = missing(&self.listen, &locators);
            locators.retain(|locator| !told.contains(locator));
            opened(&locators);
            told.extend(locators);
            let unconnected = self.unconnected(session).await;
            if missing.is_empty() && unconnected.is_none() {
                network.set_cause(None);
            } else if looks_after >= TAKES_LONG {
                let mut causes = self.why_not_at(missing.into_iter().map(ToOwned::to_owned).collect()).await;
                causes.extend(unconnected);
                say(network, causes.join("; "));
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

    /// Says that it is connected to nothing, where it is to be. Who connects to it is no router and no peer.
    async fn unconnected(&self, session: &zenoh::Session) -> Option<String> {
        let connect = self.awaited()?;
        let info = session.info();
        let is_connected = info.routers_zid().await.next().is_some() || info.peers_zid().await.next().is_some();
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

/// Says why it is not on the network as it should be, once.
pub fn say(network: &Network, cause: String) {
    if network.cause().borrow().as_ref() != Some(&cause) {
        tracing::warn!(cause, "Zenoh is not as it should be, and is tried again: the grippers are served all the same");
        network.set_cause(Some(cause));
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
