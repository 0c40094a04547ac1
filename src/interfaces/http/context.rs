//! State that the handlers share.

use std::sync::Arc;

use prometheus::Registry;
use tokio_util::sync::CancellationToken;

use crate::interfaces::metrics::Metrics;
use crate::interfaces::{self, Runtimes};
use crate::operations::Gateway;

/// Path below which the API is.
pub const API: &str = "/api/v1";

/// State that the handlers share.
#[derive(Debug, Clone)]
pub struct Context {
    /// The gateway that operations work on.
    pub gateway: Arc<Gateway>,
    /// Ends the streams when the gateway ends.
    pub closing: CancellationToken,
    /// Runtimes that serve clients.
    pub runtimes: Runtimes,
    /// Figures of HTTP.
    pub metrics: Metrics,
    /// Figures of WebSocket.
    pub ws_metrics: Metrics,
    /// All figures.
    pub registry: Registry,
    /// The names that the gateway may be called by, besides its addresses and `localhost`. Without ports.
    pub allowed_hosts: Vec<String>,
}

impl Context {
    /// Returns what another interface serves, with its figures.
    #[must_use]
    pub fn of_interface(&self, metrics: Metrics) -> interfaces::Context {
        let (gateway, closing, runtimes) = (self.gateway.clone(), self.closing.clone(), self.runtimes.clone());
        interfaces::Context { gateway, closing, runtimes, metrics }
    }
}

#[cfg(test)]
impl Context {
    /// Returns a context with these grippers and a journal in memory.
    pub(crate) fn of(grippers: impl IntoIterator<Item = crate::gripper::Handle>) -> Self {
        let registry = Registry::new();
        let [metrics, ws_metrics] = ["http", "ws"].map(|name| Metrics::register(&registry, name).unwrap());
        Self {
            gateway: Gateway::of(grippers),
            closing: CancellationToken::new(),
            runtimes: Runtimes::current(),
            metrics,
            ws_metrics,
            registry,
            allowed_hosts: Vec::new(),
        }
    }
}
