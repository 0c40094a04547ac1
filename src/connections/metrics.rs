//! Prometheus metrics of an interface.

use prometheus::core::Collector;
use prometheus::{IntCounter, IntCounterVec, IntGauge, Opts, Registry, Result};

use super::foreign::ForeignClients;

/// Route label of requests without a route. Clients can invent any number of paths, so the path itself is not a label.
pub(crate) const NO_ROUTE: &str = "none";

/// Metrics of one interface: open connections, answered requests by route, method and status, and skipped updates.
#[derive(Debug, Clone)]
pub struct InterfaceMetrics {
    clients: IntGauge,
    requests: IntCounterVec,
    updates_dropped: IntCounter,
}

impl InterfaceMetrics {
    pub fn register(registry: &Registry, door: &str) -> Result<Self> {
        let clients = door_opts(door, "wsg_clients_connected", "Open client connections.");
        let requests = door_opts(door, "wsg_requests_total", "Answered requests by route, method and status.");
        let help = "Updates that slow clients skipped because newer ones arrived.";
        let dropped = door_opts(door, "wsg_updates_dropped_total", help);
        Ok(Self {
            clients: register_in(registry, IntGauge::with_opts(clients)?)?,
            requests: register_in(registry, IntCounterVec::new(requests, &["route", "method", "status"])?)?,
            updates_dropped: register_in(registry, IntCounter::with_opts(dropped)?)?,
        })
    }

    /// Counts a connected client until the returned guard is dropped.
    #[must_use]
    pub fn connected(&self) -> Connected {
        self.clients.inc();
        Connected(self.clients.clone())
    }

    /// Counts a response. The route must be a template, not a path, and the method one of a bounded set.
    pub fn answered(&self, route: Option<&str>, method: &str, status: u16) {
        self.requests.with_label_values(&[route.unwrap_or(NO_ROUTE), method, &status.to_string()]).inc();
    }

    /// Counts updates that a slow client skipped.
    pub fn dropped(&self, updates: u64) {
        self.updates_dropped.inc_by(updates);
    }
}

/// Metrics of the WSG port.
#[derive(Debug, Clone)]
pub struct WsgPortMetrics {
    refused: IntCounterVec,
    pub foreign: ForeignClients,
}

impl WsgPortMetrics {
    pub fn register(registry: &Registry) -> Result<Self> {
        let refused = Opts::new("wsg_port_refused_total", "Requests refused on the WSG port by gripper and status.");
        let refused = register_in(registry, IntCounterVec::new(refused, &["gripper", "status"])?)?;
        Ok(Self { refused, foreign: ForeignClients::register(registry, "wsg", "WSG")? })
    }

    /// Starts the series of the commonest refusal at 0, so that the first one is an increase.
    pub fn serves(&self, gripper: &str) {
        self.refused.with_label_values(&[gripper, "E_ACCESS_DENIED"]);
    }

    /// Counts a refused request. A device can return any status code, so those without a name share one series.
    pub fn refused(&self, gripper: &str, status: Option<&str>) {
        self.refused.with_label_values(&[gripper, status.unwrap_or("unlisted")]).inc();
    }
}

/// Returns the options of a metric that each interface has: its label `door` names the interface.
pub(super) fn door_opts(door: &str, name: &str, help: &str) -> Opts {
    Opts::new(name, help).const_label("door", door)
}

fn register_in<T: Collector + Clone + 'static>(registry: &Registry, metric: T) -> Result<T> {
    registry.register(Box::new(metric.clone()))?;
    Ok(metric)
}

/// Guard of a connected client.
#[derive(Debug)]
pub struct Connected(IntGauge);

impl Drop for Connected {
    fn drop(&mut self) {
        self.0.dec();
    }
}
