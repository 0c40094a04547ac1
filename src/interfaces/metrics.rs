//! What is counted at a door, for Prometheus.

use prometheus::core::Collector;
use prometheus::{IntCounter, IntCounterVec, IntGauge, Opts, Registry, Result};

/// The route of what no route was found for: paths are the clients', and there is no end of them.
pub(super) const NO_ROUTE: &str = "none";

/// One door's figures. There is a series for each route, method and status that was answered, and two more.
#[derive(Debug, Clone)]
pub struct Metrics {
    clients: IntGauge,
    requests: IntCounterVec,
    updates_dropped: IntCounter,
}

impl Metrics {
    /// Of the door of this name.
    ///
    /// # Errors
    /// Where the registry has one of this name already.
    pub fn register(registry: &Registry, door: &str) -> Result<Self> {
        let opts = |name: &str, help: &str| Opts::new(name, help).const_label("door", door);
        let clients = opts("wsg_clients_connected", "Connections of clients that are open.");
        let requests = opts("wsg_requests_total", "Requests that were answered, by route, method and status.");
        let dropped = opts("wsg_updates_dropped_total", "Updates that slow clients didn't get, since newer ones came.");
        Ok(Self {
            clients: register_in(registry, IntGauge::with_opts(clients)?)?,
            requests: register_in(registry, IntCounterVec::new(requests, &["route", "method", "status"])?)?,
            updates_dropped: register_in(registry, IntCounter::with_opts(dropped)?)?,
        })
    }

    /// Counts a client that is connected, until it is dropped.
    #[must_use]
    pub fn connected(&self) -> Connected {
        self.clients.inc();
        Connected(self.clients.clone())
    }

    /// Counts an answer. The route is its template, not a path, and the method one of a few.
    pub fn answered(&self, route: Option<&str>, method: &str, status: u16) {
        self.requests.with_label_values(&[route.unwrap_or(NO_ROUTE), method, &status.to_string()]).inc();
    }

    /// Counts updates that a slow client didn't get.
    pub fn dropped(&self, updates: u64) {
        self.updates_dropped.inc_by(updates);
    }
}

fn register_in<T: Collector + Clone + 'static>(registry: &Registry, metric: T) -> Result<T> {
    registry.register(Box::new(metric.clone()))?;
    Ok(metric)
}

/// A client that is connected.
#[derive(Debug)]
pub struct Connected(IntGauge);

impl Drop for Connected {
    fn drop(&mut self) {
        self.0.dec();
    }
}
