//! Whether the gateway of a configuration is running.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::time::Duration;

use serde::Deserialize;
use serde::de::DeserializeOwned;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::{Diagnosis, Installation};
use crate::config::{AccessConfig, Config, JournalLocation};
use crate::journal;
use crate::model::Name;

/// Time limit of a request to the gateway.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);

/// Maximum size of a response in bytes.
const MAX_BYTES: u64 = 4 << 20;

/// State of the gateway of a configuration.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum GatewayState {
    No,
    /// The journal is in use, but the gateway does not report its readiness to this program.
    Silent,
    /// A program that may be this gateway uses the address, and the journal tells nothing.
    Uncertain,
    Answers {
        grippers: Vec<ServedGripper>,
    },
    /// Another gateway answers at the address.
    Other {
        name: String,
    },
}

/// A gripper of the running gateway.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub(super) struct ServedGripper {
    pub(super) gripper: Name,
    pub(super) url: String,
    pub(super) link: String,
    pub(super) link_cause: Option<String>,
}

#[derive(Deserialize)]
struct Readiness {
    gateway: String,
}

#[derive(Deserialize)]
struct ServedGrippers {
    grippers: Vec<ServedGripper>,
}

impl GatewayState {
    pub(super) async fn find(config: &Config) -> Self {
        let name = get::<Readiness>(config.listen, "/readyz").await.map(|readiness| readiness.gateway);
        if name.as_deref() == Some(config.name.as_str()) {
            let served = get::<ServedGrippers>(config.listen, "/api/v1/grippers").await;
            return served.map_or(Self::Silent, |served| Self::Answers { grippers: served.grippers });
        }
        let holds_journal = match &config.journal.place {
            JournalLocation::File(path) => journal::is_in_use(path),
            JournalLocation::Memory => None,
        };
        match (name, holds_journal) {
            (_, Some(true)) => Self::Silent,
            (Some(name), _) => Self::Other { name },
            // A gateway that runs as another user has its journal elsewhere.
            (None, None) if is_guarded(config) && is_served(config.listen).await => Self::Uncertain,
            (None, _) => Self::No,
        }
    }
}

pub(super) fn check(installation: &Installation) -> Vec<Diagnosis> {
    let Config { name, listen, .. } = &installation.config;
    let finding = match &installation.running {
        GatewayState::No => Diagnosis::good("gateway", format_args!("{name} is not running")),
        GatewayState::Silent if is_guarded(&installation.config) => Diagnosis::good(
            "gateway",
            format_args!("{name} is running; its readiness needs a credential, so the grippers are not checked"),
        ),
        GatewayState::Silent => Diagnosis::warning(
            "gateway",
            format_args!(
                "a gateway uses the journal, but does not answer at {listen}: if it runs with other settings, pass \
                 them to doctor too; otherwise read its log"
            ),
        ),
        GatewayState::Uncertain => Diagnosis::warning(
            "gateway",
            format_args!(
                "a program answers at {listen}: if it is {name}, run doctor as its user and with its STATE_DIRECTORY; \
                 otherwise stop it"
            ),
        ),
        GatewayState::Answers { .. } => Diagnosis::good("gateway", format_args!("{name} is running at {listen}")),
        GatewayState::Other { name: other } => Diagnosis::problem(
            "gateway",
            format_args!(
                "another gateway, {other}, answers at {listen}: stop it, or give this one its own --name, --listen \
                 and --journal"
            ),
        ),
    };
    vec![finding]
}

/// Whether the gateway reports its readiness only over TLS or to clients with a credential.
fn is_guarded(config: &Config) -> bool {
    config.access != AccessConfig::Open || config.tls.is_some()
}

/// Whether a program accepts connections at this address.
async fn is_served(address: SocketAddr) -> bool {
    timeout(ANSWERS_WITHIN, TcpStream::connect(reachable(address))).await.is_ok_and(|connected| connected.is_ok())
}

/// Returns the address at which this machine reaches a server that listens on `address`.
fn reachable(mut address: SocketAddr) -> SocketAddr {
    if address.ip().is_unspecified() {
        address.set_ip(if address.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() });
    }
    address
}

/// Returns the JSON body of a successful response of the gateway.
async fn get<T: DeserializeOwned>(address: SocketAddr, path: &str) -> Option<T> {
    serde_json::from_str(&get_text(address, path).await?).ok()
}

/// Returns the body of a successful response of the gateway.
pub(super) async fn get_text(address: SocketAddr, path: &str) -> Option<String> {
    let address = reachable(address);
    let request = format!("GET {path} HTTP/1.0\r\nHost: {address}\r\n\r\n");
    let exchange = async {
        let mut stream = TcpStream::connect(address).await?;
        stream.write_all(request.as_bytes()).await?;
        let mut response = Vec::new();
        stream.take(MAX_BYTES).read_to_end(&mut response).await?;
        Ok::<_, std::io::Error>(response)
    };
    let response = timeout(ANSWERS_WITHIN, exchange).await.ok()?.ok()?;
    let response = String::from_utf8(response).ok()?;
    // 503 is the status of a gateway that is not ready.
    let (head, body) = response.split_once("\r\n\r\n")?;
    let status = head.split(' ').nth(1)?;
    ["200", "503"].contains(&status).then(|| body.to_owned())
}
