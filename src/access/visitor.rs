//! A client before its identification.

use super::authority::Access;
use super::credential::Credential;
use super::identity::{Identity, Unauthorized};
use super::known::ClientOrigin;
use super::role::Right;

/// Credential and origin of a client. A connection that lasts is checked again for each request, so that a revocation takes effect
/// at once.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Visitor {
    pub credential: Credential,
    pub origin: ClientOrigin,
}

impl Visitor {
    /// # Errors
    /// The reason why the client is unknown.
    pub fn identity(&self, access: &Access) -> Result<Identity, Unauthorized> {
        access.identify(&self.credential, &self.origin)
    }

    /// Whether the client may still read.
    #[must_use]
    pub fn may_read(&self, access: &Access) -> bool {
        self.identity(access).is_ok_and(|identity| identity.may(Right::Read, None))
    }

    /// Whether the client is still known.
    #[must_use]
    pub fn is_known(&self, access: &Access) -> bool {
        access.identify(&self.credential, &self.origin).is_ok()
    }
}
