//! The gateway that an interface serves, with its runtimes.

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use crate::connections::metrics::InterfaceMetrics;
use crate::connections::runtimes::Runtimes;
use crate::operations::Gateway;

#[derive(Debug, Clone)]
pub struct Context {
    pub gateway: Arc<Gateway>,
    /// Ends the interface on shutdown.
    pub closing: CancellationToken,
    pub runtimes: Runtimes,
    pub metrics: InterfaceMetrics,
}
