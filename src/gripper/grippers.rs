//! The grippers of this gateway, by name.

use std::collections::BTreeMap;
use std::sync::Arc;

use tokio::sync::watch;

use super::handle::{FastStop, Handle};
use model::{Client, FastStopId, Name, Reason};

/// The grippers that this gateway owns. Clones share them, so a reload changes them for everyone.
#[derive(Debug, Clone)]
pub struct Grippers(Arc<watch::Sender<GrippersByName>>);

type GrippersByName = Arc<BTreeMap<Name, Handle>>;

impl Grippers {
    #[must_use]
    pub fn new(grippers: impl IntoIterator<Item = Handle>) -> Self {
        Self(Arc::new(watch::Sender::new(Arc::new(by_name(grippers)))))
    }

    #[must_use]
    pub fn get(&self, name: &Name) -> Option<Handle> {
        self.0.borrow().get(name).cloned()
    }

    /// Returns the grippers of this moment, sorted by name.
    #[must_use]
    pub fn all(&self) -> Vec<Handle> {
        self.0.borrow().values().cloned().collect()
    }

    /// Adds and removes grippers, all at the same time.
    pub fn change(&self, added: impl IntoIterator<Item = Handle>, removed: &[Name]) {
        self.0.send_modify(|grippers| {
            let grippers = Arc::make_mut(grippers);
            grippers.retain(|name, _| !removed.contains(name));
            grippers.append(&mut by_name(added));
        });
    }

    /// Returns a receiver that is notified when grippers are added or removed.
    #[must_use]
    pub fn changes(&self) -> GripperChanges {
        GripperChanges(self.0.subscribe())
    }

    /// FAST STOPs all grippers at once, under one id. Returns for each whether its device has confirmed.
    pub async fn fast_stop(&self, client: &Client, reason: &Reason) -> (FastStopId, Vec<(Name, bool)>) {
        let id = FastStopId::generate();
        let stops = self.all().into_iter().map(|handle| async move {
            let FastStop { confirmed, .. } = handle.fast_stop(id, client.clone(), reason.clone()).await;
            (handle.name().clone(), confirmed)
        });
        (id, futures_util::future::join_all(stops).await)
    }

    /// Drains all grippers concurrently.
    pub async fn drain(&self) {
        let grippers = self.all();
        futures_util::future::join_all(grippers.iter().map(Handle::drain)).await;
    }
}

/// Notified when grippers are added or removed.
#[derive(Debug, Clone)]
pub struct GripperChanges(watch::Receiver<GrippersByName>);

impl GripperChanges {
    /// Whether grippers were added or removed since the last call.
    pub fn any(&mut self) -> bool {
        let any = self.0.has_changed().unwrap_or_default();
        self.0.mark_unchanged();
        any
    }

    /// Waits until grippers are added or removed. Cancel-safe.
    pub async fn wait(&mut self) {
        if self.0.changed().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}

fn by_name(grippers: impl IntoIterator<Item = Handle>) -> BTreeMap<Name, Handle> {
    grippers.into_iter().map(|handle| (handle.name().clone(), handle)).collect()
}
