//! Whether the gateway of a configuration is running.

use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr};
use std::time::Duration;

use serde::Deserialize;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::timeout;

use super::{Diagnosis, Installation};
use crate::config::{AccessConfig, Config, JournalPlace};
use crate::journal;

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
    Ready {
        /// Grippers that are not connected, with the causes.
        not_ready: Vec<String>,
    },
    /// Another gateway answers at the address.
    Other {
        name: String,
    },
}

#[derive(Deserialize)]
struct Readiness {
    gateway: String,
    not_ready: Vec<String>,
}

impl GatewayState {
    pub(super) async fn find(config: &Config) -> Self {
        let readiness = get(config.listen, "/readyz").await;
        let readiness = readiness.and_then(|body| serde_json::from_str::<Readiness>(&body).ok());
        let holds_journal = match &config.journal.place {
            JournalPlace::File(path) => journal::is_in_use(path),
            JournalPlace::Memory => false,
        };
        match readiness {
            Some(Readiness { gateway, not_ready }) if gateway == config.name.as_str() => Self::Ready { not_ready },
            _ if holds_journal => Self::Silent,
            Some(Readiness { gateway: name, .. }) => Self::Other { name },
            None => Self::No,
        }
    }

    /// Whether the gateway of this configuration runs.
    pub(super) fn is_ours(&self) -> bool {
        matches!(self, Self::Silent | Self::Ready { .. })
    }
}

pub(super) fn check(installation: &Installation) -> Vec<Diagnosis> {
    let Config { name, listen, access, tls, .. } = &installation.config;
    let finding = match &installation.running {
        GatewayState::No => Diagnosis::good("gateway", format_args!("{name} is not running")),
        GatewayState::Silent if *access != AccessConfig::Open || tls.is_some() => Diagnosis::good(
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
        GatewayState::Ready { .. } => Diagnosis::good("gateway", format_args!("{name} is running at {listen}")),
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

/// Returns the body of a successful response of the gateway.
pub(super) async fn get(address: SocketAddr, path: &str) -> Option<String> {
    let mut address = address;
    if address.ip().is_unspecified() {
        address.set_ip(if address.is_ipv4() { Ipv4Addr::LOCALHOST.into() } else { Ipv6Addr::LOCALHOST.into() });
    }
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
