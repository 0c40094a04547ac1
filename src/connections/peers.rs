//! Clients of interfaces without credentials, which are known by their addresses.

use std::net::IpAddr;
use std::sync::Arc;

use ipnet::IpNet;

use crate::access::{Access, Identity, Proof, Right, Role, Unauthorized};
use crate::model::{Client, Door, Name};

/// The addresses that may connect, and the clients that the configuration knows by their addresses.
#[derive(Debug)]
pub struct KnownPeers {
    /// Networks whose clients may connect. Without any, see [`KnownPeers::allows`].
    allow: Vec<IpNet>,
    access: Arc<Access>,
}

impl KnownPeers {
    #[must_use]
    pub fn new(allow: Vec<IpNet>, access: Arc<Access>) -> Self {
        Self { allow, access }
    }

    /// Whether a client may connect: from an allowed network, or as a known client. Without a list of networks, a gateway
    /// that needs credentials accepts known clients and loopback; others accept every client.
    #[must_use]
    pub fn allows(&self, peer: IpAddr) -> bool {
        let peer = peer.to_canonical();
        let is_open = self.allow.is_empty() && (peer.is_loopback() || !self.access.is_guarded());
        let is_allowed = self.allow.iter().any(|net| net.contains(&peer));
        is_open || is_allowed || self.identity(peer).is_some()
    }

    /// The identity of a client that the configuration knows by its address.
    #[must_use]
    pub fn identity(&self, peer: IpAddr) -> Option<Identity> {
        self.access.of_address(&peer.into())
    }

    /// The identity of a client. Clients from an allowed network are operators.
    ///
    /// # Errors
    /// [`Unauthorized`] if the client may not connect (any more).
    pub fn operator(&self, peer: IpAddr) -> Result<Identity, Unauthorized> {
        match self.identity(peer) {
            Some(identity) => Ok(identity),
            None if self.allows(peer) => {
                Ok(Identity { role: Role::Operator, proof: Proof::Address, ..Identity::anyone() })
            }
            None => Err(Unauthorized::Missing),
        }
    }

    /// Whether a client may move this gripper.
    #[must_use]
    pub fn may_move(&self, peer: IpAddr, gripper: &Name) -> bool {
        self.operator(peer).is_ok_and(|identity| identity.may(Right::Operate, Some(gripper)))
    }

    /// Returns a client with its configured name, or else identified by its IP address. A client keeps
    /// its identity after a restart, although its port differs.
    #[must_use]
    pub fn client(&self, peer: IpAddr, interface: &str, door: Door) -> Client {
        let subject = match self.identity(peer).and_then(|identity| identity.name) {
            Some(name) => name.to_string(),
            None => format!("{interface}:{}", peer.to_canonical()),
        };
        Client::new(subject, door)
    }
}
