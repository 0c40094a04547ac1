//! What an interface serves, and on what.

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use super::metrics::Metrics;
use super::runtimes::Runtimes;
use crate::operations::Gateway;

/// What an interface serves, and on what.
#[derive(Debug, Clone)]
pub struct Context {
    /// The gateway that operations work on.
    pub gateway: Arc<Gateway>,
    /// Ends the interface when the gateway ends.
    pub closing: CancellationToken,
    /// Runtimes that serve clients.
    pub runtimes: Runtimes,
    /// What the interface counts.
    pub metrics: Metrics,
}
