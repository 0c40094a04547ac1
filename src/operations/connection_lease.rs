//! A lease that ends with its client's connection.

use crate::gripper::model::{Lease, LeaseToken, Name};
use crate::gripper::{Handle, LeaseKeepAlive};

/// An acquired lease, as an interface keeps it that sees its client's end. HTTP, which does not, drops it.
#[derive(Debug)]
pub struct ConnectionLease {
    handle: Handle,
    token: LeaseToken,
    epoch: u64,
    takes: u64,
    /// Keeps a lease without a time of its own for as long as the connection lives.
    _keep: Option<LeaseKeepAlive>,
}

impl ConnectionLease {
    /// Returns a lease that has a token, as taken this many times.
    pub fn new(handle: Handle, lease: &Lease, takes: u64, keep: Option<LeaseKeepAlive>) -> Option<Self> {
        Some(Self { handle, token: lease.token.clone()?, epoch: lease.epoch, takes, _keep: keep })
    }

    /// The same, which runs out without use.
    pub fn without_keep(&self) -> Self {
        let (handle, token) = (self.handle.clone(), self.token.clone());
        Self { handle, token, epoch: self.epoch, takes: self.takes, _keep: None }
    }

    /// Whether it is the lease of this token.
    pub fn is(&self, token: &str) -> bool {
        self.token.as_str() == token
    }

    /// Whether it is held: no longer once another client has the lease, or nobody.
    pub fn is_held(&self) -> bool {
        let state = self.handle.state();
        state.lease_holder.is_some() && state.lease_epoch == self.epoch
    }

    /// The gripper's name.
    pub fn gripper(&self) -> &Name {
        self.handle.name()
    }

    /// Its client has gone. One that was released, is another's by now, or was taken again elsewhere, stays as it is.
    pub async fn lose(&self) {
        self.handle.lose_lease(self.token.clone(), Some(self.takes)).await;
    }
}
