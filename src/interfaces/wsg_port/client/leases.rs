//! The lease of a client: taken with its motions, kept while it is connected, and released or lost at its end.

use futures_util::FutureExt as _;
use tokio::io::{AsyncRead, AsyncWrite};

use super::{Served, Step};
use crate::gripper::Handle;
use crate::model::{LossCause, State, TakeLease};

impl<R: AsyncRead + Unpin, W: AsyncWrite + Unpin> Served<R, W> {
    /// Releases the lease of a client that has announced its disconnect, and loses that of any other.
    pub(super) async fn leave_lease(&mut self, has_announced: bool) {
        if has_announced {
            // An error means that the actor has ended and released its device.
            let _ = self.port.gripper.release_lease(Some(self.token.clone())).await;
        } else {
            self.lose_lease().await;
        }
    }

    pub(super) async fn lose_lease(&mut self) {
        // The token belongs to this connection alone, however often the lease was taken.
        self.port.gripper.lose_lease(self.token.clone(), None, LossCause::Disconnected).await;
    }

    /// Keeps the lease that a motion has taken, if it is this client's.
    pub(super) fn keep(&mut self) {
        if self.end.is_some() {
            return;
        }
        let take = TakeLease { token: Some(self.token.clone()), ..TakeLease::by(self.client.clone()) };
        let gripper: Handle = self.port.gripper.clone();
        // Fails if another client has just forced the lease away.
        let kept = async move { Step::Kept(gripper.take_lease(take).await.ok()) };
        self.begin(kept.boxed());
    }

    /// Keeps the lease that a script of this client has taken by moving the fingers.
    pub(super) fn keep_claimed_lease(&mut self, state: &State) {
        let is_own = state.lease_holder.as_deref() == Some(&*self.client.subject);
        if self.uses_scripts && self.kept.is_none() && is_own && state.lease_epoch > self.tried_epoch {
            self.tried_epoch = state.lease_epoch;
            self.keep();
        }
    }

    /// Stops keeping a lease that was forced away or released, so that the client can be evicted again.
    pub(super) fn forget_lost_lease(&mut self, state: &State) {
        self.kept.take_if(|kept| state.lease_holder.is_none() || state.lease_epoch != kept.epoch);
    }
}
