//! The grippers of this gateway, by name.

use std::collections::BTreeMap;

use super::handle::{FastStop, Handle};
use super::model::{Client, FastStopId, Name, Reason};

/// The grippers that this gateway owns.
#[derive(Debug, Clone, Default)]
pub struct Grippers {
    grippers: BTreeMap<Name, Handle>,
}

impl Grippers {
    #[must_use]
    pub fn new(grippers: impl IntoIterator<Item = Handle>) -> Self {
        Self { grippers: grippers.into_iter().map(|handle| (handle.name().clone(), handle)).collect() }
    }

    #[must_use]
    pub fn get(&self, name: &Name) -> Option<&Handle> {
        self.grippers.get(name)
    }

    /// Iterates over the grippers, sorted by name.
    pub fn iter(&self) -> impl Iterator<Item = &Handle> {
        self.grippers.values()
    }

    /// FAST STOPs all grippers at once, under one id. Returns for each whether its device has confirmed.
    pub async fn fast_stop(&self, client: &Client, reason: &Reason) -> (FastStopId, Vec<(Name, bool)>) {
        let id = FastStopId::generate();
        let stops = self.iter().map(|handle| async {
            let FastStop { confirmed, .. } = handle.fast_stop(id, client.clone(), reason.clone()).await;
            (handle.name().clone(), confirmed)
        });
        (id, futures_util::future::join_all(stops).await)
    }

    /// Drains all grippers concurrently.
    pub async fn drain(&self) {
        futures_util::future::join_all(self.iter().map(Handle::drain)).await;
    }
}
