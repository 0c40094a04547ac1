//! The gateway that an interface serves, with its runtimes.

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use super::metrics::Metrics;
use super::runtimes::Runtimes;
use crate::operations::Gateway;

/// The gateway that an interface serves, with its runtimes.
#[derive(Debug, Clone)]
pub struct Context {
    /// The gateway that operations work on.
    pub gateway: Arc<Gateway>,
    /// Ends the interface when the gateway ends.
    pub closing: CancellationToken,
    /// Runtimes that serve clients.
    pub runtimes: Runtimes,
    /// Figures of the interface.
    pub metrics: Metrics,
}
