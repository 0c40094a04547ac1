//! Metrics of a listener's connections, read from its table on each scrape.

use std::sync::{Arc, Mutex, PoisonError};

use prometheus::core::{Collector, Desc};
use prometheus::proto::MetricFamily;
use prometheus::{IntCounter, IntGauge, IntGaugeVec, Registry, Result};

use super::{Admission, Class};
use crate::connections::metrics::door_opts;

/// Classes with a bound, and their names.
const BOUNDED: [(Class, &str); 6] = [
    (Class::Incoming, "incoming"),
    (Class::Idle, "idle"),
    (Class::Answering, "answering"),
    (Class::Urgent, "urgent"),
    (Class::Waiting, "waiting"),
    (Class::Streaming, "streaming"),
];

/// Collector of the connections of each class and their limits.
pub struct Usage {
    admission: Arc<Admission>,
    used: IntGaugeVec,
    limit: IntGaugeVec,
    held: IntGauge,
    evicted: IntCounter,
    /// Number of evictions already added to the counter.
    counted: Mutex<u64>,
}

impl Usage {
    /// Registers the metrics of an interface's connections.
    pub fn register(registry: &Registry, interface: &str, admission: &Arc<Admission>) -> Result<()> {
        let used = door_opts(interface, "wsg_connection_slots_used", "Open connections in each class.");
        let meaning = "Maximum connections in each class; beyond it, one is evicted or refused.";
        let limit = door_opts(interface, "wsg_connection_slots", meaning);
        let meaning = "Bytes held for requests in progress and undelivered responses.";
        let held = door_opts(interface, "wsg_connections_held_bytes", meaning);
        let meaning = "Connections closed to make room for others.";
        let evicted = door_opts(interface, "wsg_connections_evicted_total", meaning);
        registry.register(Box::new(Self {
            admission: admission.clone(),
            used: IntGaugeVec::new(used, &["class"])?,
            limit: IntGaugeVec::new(limit, &["class"])?,
            held: IntGauge::with_opts(held)?,
            evicted: IntCounter::with_opts(evicted)?,
            counted: Mutex::default(),
        }))
    }
}

impl Collector for Usage {
    fn desc(&self) -> Vec<&Desc> {
        [self.used.desc(), self.limit.desc(), self.held.desc(), self.evicted.desc()].concat()
    }

    fn collect(&self) -> Vec<MetricFamily> {
        let table = self.admission.table();
        for (class, name) in BOUNDED {
            let (used, limit) = table.usage(class);
            self.used.with_label_values(&[name]).set(figure(used));
            self.limit.with_label_values(&[name]).set(figure(limit));
        }
        self.held.set(figure(table.held_bytes()));
        let mut counted = self.counted.lock().unwrap_or_else(PoisonError::into_inner);
        self.evicted.inc_by(table.evicted() - *counted);
        *counted = table.evicted();
        [self.used.collect(), self.limit.collect(), self.held.collect(), self.evicted.collect()].concat()
    }
}

fn figure(count: usize) -> i64 {
    i64::try_from(count).unwrap_or(i64::MAX)
}
