//! A client with what it presents, before each of its requests is checked.

use std::net::IpAddr;

use super::authority::Access;
use super::credential::Credential;
use super::identity::{Identity, Unauthorized};

/// What a client presents. A connection that lasts is checked again for each request, so that a revocation takes effect
/// at once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Visitor {
    pub credential: Credential,
    pub peer: Option<IpAddr>,
}

impl Visitor {
    /// # Errors
    /// The reason why the client is unknown.
    pub fn identity(&self, access: &Access) -> Result<Identity, Unauthorized> {
        access.identify(&self.credential, self.peer)
    }
}
