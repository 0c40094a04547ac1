//! State that the handlers share.

use std::sync::Arc;

use prometheus::Registry;
use tokio_util::sync::CancellationToken;

use super::http_settings::SharedSettings;
use super::requests::refused_sockets::RefusedSockets;
use crate::connections::Runtimes;
use crate::connections::metrics::InterfaceMetrics;
use crate::interfaces;
use crate::operations::Gateway;

pub const API: &str = "/api/v1";

/// Paths of the WebSocket and of the event stream.
pub const SOCKET: &str = "/ws";
pub const STREAM: &str = "/stream";

#[derive(Debug, Clone)]
pub struct HttpContext {
    pub gateway: Arc<Gateway>,
    /// Ends the streams on shutdown.
    pub closing: CancellationToken,
    pub runtimes: Runtimes,
    pub metrics: InterfaceMetrics,
    pub ws_metrics: InterfaceMetrics,
    pub registry: Registry,
    pub settings: SharedSettings,
    pub refused_sockets: Arc<RefusedSockets>,
}

impl HttpContext {
    /// Returns the context of another interface, with its own metrics.
    #[must_use]
    pub fn of_interface(&self, metrics: InterfaceMetrics) -> interfaces::Context {
        let gateway = self.gateway.clone();
        let closing = self.closing.clone();
        let runtimes = self.runtimes.clone();
        interfaces::Context { gateway, closing, runtimes, metrics }
    }
}

#[cfg(test)]
impl HttpContext {
    /// Returns a context with these grippers and an in-memory journal.
    pub(crate) fn of(grippers: impl IntoIterator<Item = crate::gripper::Handle>) -> Self {
        let registry = Registry::new();
        let [metrics, ws_metrics] = ["http", "ws"].map(|name| InterfaceMetrics::register(&registry, name).unwrap());
        Self {
            gateway: Gateway::of(grippers),
            closing: CancellationToken::new(),
            runtimes: Runtimes::current(),
            metrics,
            ws_metrics,
            registry,
            settings: SharedSettings::default(),
            refused_sockets: Arc::default(),
        }
    }
}
