//! Discovery of WSG devices in networks, on serial ports and on CAN interfaces.

use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

use futures_util::{StreamExt as _, stream};
use ipnet::IpNet;
use tokio::time::timeout;

use super::clients;
use super::probe::{Identification, identify};
use crate::transport::{Address, Pipe, TcpAddress, available};

/// Addresses that are tried at the same time.
const AT_ONCE: usize = 64;

/// Maximum number of addresses in one search.
pub const MAX_ADDRESSES: usize = 4096;

/// Time for a connection within a plant network.
const CONNECTS_WITHIN: Duration = Duration::from_millis(500);

/// Time for a reply.
const ANSWERS_WITHIN: Duration = Duration::from_millis(800);

/// Addresses to be tried.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SearchPlan {
    tcp: Vec<SocketAddr>,
    others: Vec<Address>,
}

/// Reason why a search is not possible.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the networks have more than {MAX_ADDRESSES} addresses: name smaller ones, e.g. 192.168.1.0/24")]
pub struct TooManyAddresses;

/// Outcome at one address. Addresses without an outcome are silent.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Discovered {
    pub address: Address,
    /// Description of the device, or the reason why it is not known.
    pub text: String,
    pub is_device: bool,
}

impl SearchPlan {
    /// Plans a search in networks, and on this machine's serial ports and CAN interfaces if `is_local`.
    ///
    /// # Errors
    /// [`TooManyAddresses`].
    pub fn new(networks: &[IpNet], port: u16, is_local: bool) -> Result<Self, TooManyAddresses> {
        let hosts = networks.iter().flat_map(IpNet::hosts).take(MAX_ADDRESSES + 1);
        let tcp: Vec<_> = hosts.map(|host: IpAddr| SocketAddr::new(host, port)).collect();
        if tcp.len() > MAX_ADDRESSES {
            return Err(TooManyAddresses);
        }
        let urls = if is_local { available() } else { Vec::new() };
        let others = urls.iter().filter_map(|url| url.parse().ok()).collect();
        Ok(Self { tcp, others })
    }

    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.tcp.is_empty() && self.others.is_empty()
    }

    /// Describes what the search contacts.
    #[must_use]
    pub fn describe(&self) -> String {
        let networks = (!self.tcp.is_empty()).then(|| format!("{} network addresses", self.tcp.len()));
        let others = self.others.iter().map(ToString::to_string);
        networks.into_iter().chain(others).collect::<Vec<_>>().join(", ")
    }

    /// Contacts all addresses, and reports each outcome.
    pub async fn run(self, mut report: impl FnMut(&Discovered)) {
        let tcp = self.tcp.into_iter().map(try_tcp);
        let mut outcomes = stream::iter(tcp).buffer_unordered(AT_ONCE);
        while let Some(outcome) = outcomes.next().await {
            outcome.iter().for_each(&mut report);
        }
        for address in self.others {
            let connected = address.connect().await;
            report(&outcome(address, connected).await);
        }
    }
}

async fn try_tcp(socket: SocketAddr) -> Option<Discovered> {
    let address = Address::Tcp(TcpAddress { host: socket.ip().to_string(), port: socket.port() });
    if let Some(client) = clients::of(&[socket]) {
        let process = client.process.unwrap_or_else(|| "another program".to_owned());
        let text = format!("not contacted, because {process} is connected to it");
        return Some(Discovered { address, text, is_device: false });
    }
    // Most addresses are silent.
    let connected = timeout(CONNECTS_WITHIN, address.connect()).await.ok()?;
    Some(outcome(address, Ok(connected.ok()?)).await)
}

async fn outcome(address: Address, connected: std::io::Result<Pipe>) -> Discovered {
    let identification = match connected {
        Ok(pipe) => identify(pipe, address.properties().connection_oriented, ANSWERS_WITHIN).await,
        Err(error) => Identification::Closed(error.to_string()),
    };
    let is_device = identification.is_device();
    let text = match identification {
        Identification::Device(identity) => identity.to_string(),
        Identification::Status(status) => format!("a gripper that answers with the status {status}"),
        Identification::Garbage => "bytes arrive, but no frames: another device, or another bit rate".to_owned(),
        Identification::Silence => "no answer".to_owned(),
        Identification::Closed(cause) => cause,
    };
    Discovered { address, text, is_device }
}
