//! Values that are computed when a client first needs them.

use std::sync::Arc;

use tokio::sync::OnceCell;
use tokio::task::spawn_blocking;

use crate::operations::Problem;

/// A value that takes some time to compute, and that a gateway may never need.
///
/// A thread for blocking work computes the value once, even if the client that needed it leaves meanwhile.
pub struct OnDemand<T> {
    compute: Arc<dyn Fn() -> T + Send + Sync>,
    value: Arc<OnceCell<T>>,
}

impl<T: Send + Sync + 'static> OnDemand<T> {
    pub fn new(compute: impl Fn() -> T + Send + Sync + 'static) -> Self {
        Self { compute: Arc::new(compute), value: Arc::default() }
    }

    /// Returns the value, which the first call computes.
    ///
    /// # Errors
    /// An internal error if the computation panics. The next call computes the value again.
    pub async fn get(&self) -> Result<&T, Problem> {
        if !self.value.initialized() {
            let compute = self.compute.clone();
            let value = self.value.clone();
            // A task of its own, because a client that leaves would end this future, and its next request would start
            // the computation a second time.
            let computing = tokio::spawn(async move {
                value.get_or_try_init(async || spawn_blocking(move || compute()).await).await.map(drop)
            });
            if let Err(error) = computing.await.flatten() {
                tracing::error!(%error, "part of the documentation or the dashboard could not be prepared");
            }
        }
        self.value.get().ok_or_else(Problem::internal)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicU32, Ordering};

    use futures_util::FutureExt as _;

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
    async fn client_that_leaves_does_not_start_it_again() {
        let computed = Arc::new(AtomicU32::new(0));
        let counter = computed.clone();
        let (clients_have_left, wait) = std::sync::mpsc::channel::<()>();
        let wait = Mutex::new(wait);
        let value = OnDemand::new(move || {
            let _ = wait.lock().unwrap().recv();
            counter.fetch_add(1, Ordering::Relaxed)
        });
        for _ in 0..10 {
            assert!(value.get().now_or_never().is_none());
            tokio::task::yield_now().await;
        }
        drop(clients_have_left);
        assert_eq!((value.get().await.unwrap(), computed.load(Ordering::Relaxed)), (&0, 1));
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
