//! Clients that send no credential: known by their certificate or their address.

use std::net::IpAddr;
use std::sync::Arc;

use ipnet::IpNet;
use jiff::Timestamp;

use super::identity::{Identity, Proof, Scope};
use super::role::Role;
use crate::model::Name;

/// A client that the configuration names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KnownClient {
    pub name: Name,
    pub matched_by: ClientMatch,
    pub role: Role,
    pub scope: Scope,
}

/// The address or certificate by which a client is known.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ClientMatch {
    /// An address in this network.
    Address(IpNet),
    /// A certificate for this common name (RFC 5280, 4.1.2.6), signed by an authority of `client_ca`.
    Certificate(String),
}

/// The origin of a connection.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ClientOrigin {
    /// Address of the client; `None` on an interface without addresses.
    pub address: Option<IpAddr>,
    /// The client's certificate, which was verified.
    pub certificate: Option<ClientCertificate>,
}

/// The holder of a certificate.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ClientCertificate {
    /// Common name (RFC 5280, 4.1.2.6).
    pub common_name: Arc<str>,
    pub expires_at: Timestamp,
}

impl From<IpAddr> for ClientOrigin {
    fn from(address: IpAddr) -> Self {
        Self { address: Some(address.to_canonical()), certificate: None }
    }
}

impl KnownClient {
    /// Returns the identity of the client with this origin, if one of these clients has it. A certificate proves more
    /// than an address, so it decides first.
    pub(super) fn find(clients: &[Self], origin: &ClientOrigin) -> Option<Identity> {
        // A connection can outlast its certificate.
        let certificate = origin.certificate.as_ref().filter(|certificate| certificate.expires_at > Timestamp::now());
        if let Some(certificate) = certificate
            && let Some(holder) = clients.iter().find(|client| client.holds(certificate))
        {
            return Some(holder.identity());
        }
        let address = origin.address?;
        clients.iter().find(|client| client.is_at(address)).map(Self::identity)
    }

    fn holds(&self, certificate: &ClientCertificate) -> bool {
        matches!(&self.matched_by, ClientMatch::Certificate(name) if **name == *certificate.common_name)
    }

    fn is_at(&self, address: IpAddr) -> bool {
        matches!(&self.matched_by, ClientMatch::Address(network) if network.contains(&address))
    }

    fn identity(&self) -> Identity {
        let proof = match self.matched_by {
            ClientMatch::Address(_) => Proof::Address,
            ClientMatch::Certificate(_) => Proof::Certificate,
        };
        let name = Some(self.name.clone());
        let scope = self.scope.clone();
        Identity { name, role: self.role, scope, expires_at: None, proof, session: None }
    }
}
