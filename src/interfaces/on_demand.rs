//! Values that are computed when a client first needs them.

use std::sync::Arc;

use tokio::sync::OnceCell;
use tokio::task::spawn_blocking;

use crate::operations::Problem;

/// A value that takes some time to compute, and that a gateway may never need.
///
/// A thread for blocking work computes the value, so that no other request waits for it.
pub struct OnDemand<T> {
    compute: Arc<dyn Fn() -> T + Send + Sync>,
    value: OnceCell<T>,
}

impl<T: Send + Sync + 'static> OnDemand<T> {
    pub fn new(compute: impl Fn() -> T + Send + Sync + 'static) -> Self {
        Self { compute: Arc::new(compute), value: OnceCell::new() }
    }

    /// Returns the value, which the first call computes.
    ///
    /// # Errors
    /// An internal error if the computation panics. The next call repeats it.
    pub async fn get(&self) -> Result<&T, Problem> {
        let compute = self.compute.clone();
        let value = self.value.get_or_try_init(async || spawn_blocking(move || compute()).await).await;
        value.map_err(|error| {
            tracing::error!(%error, "part of the documentation or the dashboard could not be prepared");
            Problem::internal()
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU32, Ordering};

    use super::*;

    #[tokio::test]
    async fn value_is_computed_once_and_only_if_it_is_needed() {
        let computed = Arc::new(AtomicU32::new(0));
        let counter = computed.clone();
        let value = OnDemand::new(move || counter.fetch_add(1, Ordering::Relaxed));
        assert_eq!(computed.load(Ordering::Relaxed), 0);
        let (first, second) = tokio::join!(value.get(), value.get());
        assert_eq!((first.unwrap(), second.unwrap()), (&0, &0));
        assert_eq!(computed.load(Ordering::Relaxed), 1);
    }

    #[tokio::test]
    async fn computation_that_panics_is_repeated() {
        let computed = Arc::new(AtomicU32::new(0));
        let counter = computed.clone();
        let value = OnDemand::new(move || {
            let before = counter.fetch_add(1, Ordering::Relaxed);
            assert!(before > 0, "the first computation fails");
            before
        });
        assert_eq!(value.get().await.unwrap_err().status(), 500);
        assert_eq!(value.get().await.unwrap(), &1);
    }
}
