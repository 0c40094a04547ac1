//! A lease that ends with its client's connection.

use crate::gripper::{Handle, LeaseKeepAlive};
use crate::model::{Lease, LeaseToken, LossCause, Name};

/// An acquired lease, tracked by interfaces that notice when their client is gone. HTTP does not notice this, and drops
/// the value.
#[derive(Debug)]
pub struct ConnectionLease {
    handle: Handle,
    token: LeaseToken,
    epoch: u64,
    takes: u64,
    /// Guard that keeps the lease alive while the connection lives; `None` for a lease that expires without use.
    _keep: Option<LeaseKeepAlive>,
}

impl ConnectionLease {
    /// Returns `None` if the lease has no token. `takes` is the number of times that the lease was taken so far.
    pub fn new(handle: Handle, lease: &Lease, takes: u64, keep: Option<LeaseKeepAlive>) -> Option<Self> {
        Some(Self { handle, token: lease.token.clone()?, epoch: lease.epoch, takes, _keep: keep })
    }

    /// Returns a copy that does not keep the lease from expiring.
    pub fn without_keep(&self) -> Self {
        let handle = self.handle.clone();
        let token = self.token.clone();
        Self { handle, token, epoch: self.epoch, takes: self.takes, _keep: None }
    }

    pub fn token(&self) -> &LeaseToken {
        &self.token
    }

    /// Whether the lease has this token.
    pub fn is(&self, token: &str) -> bool {
        self.token.as_str() == token
    }

    /// Whether the lease is still held, rather than free or another client's. It ends with the gripper that a reload
    /// removes or replaces.
    pub fn is_held(&self) -> bool {
        let state = self.handle.state();
        !self.handle.has_ended() && state.lease_holder.is_some() && state.lease_epoch == self.epoch
    }

    pub fn gripper(&self) -> &Name {
        self.handle.name()
    }

    /// Reports that the client is lost. Changes nothing if the lease was released, taken again elsewhere, or belongs to
    /// another client.
    pub async fn lose(&self, cause: LossCause) {
        self.handle.lose_lease(self.token.clone(), Some(self.takes), cause).await;
    }
}
