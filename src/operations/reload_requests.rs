//! Requests to reload, on their way to the daemon.

use tokio::sync::mpsc::error::TrySendError;
use tokio::sync::{mpsc, oneshot};

use crate::model::Client;

/// Reloads that can wait.
const MAX_WAITING: usize = 4;

/// Sends requests to reload to the daemon.
#[derive(Debug, Clone)]
pub struct Reloads(mpsc::Sender<ReloadRequest>);

/// A request to reload.
#[derive(Debug)]
pub struct ReloadRequest {
    pub client: Client,
    /// Channel for the changes, or for the reason why nothing has changed.
    pub answer: oneshot::Sender<Result<Vec<String>, String>>,
}

impl Reloads {
    /// Returns a sender, and the receiver for the daemon.
    #[must_use]
    pub fn channel() -> (Self, mpsc::Receiver<ReloadRequest>) {
        let (sender, requests) = mpsc::channel(MAX_WAITING);
        (Self(sender), requests)
    }

    /// Sends a request, or returns it if too many wait.
    pub(super) fn request(&self, request: ReloadRequest) -> Result<(), ReloadRequest> {
        self.0.try_send(request).map_err(TrySendError::into_inner)
    }
}
