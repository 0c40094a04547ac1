//! Prometheus metrics of MQTT.

use prometheus::core::{Collector, Desc};
use prometheus::proto::MetricFamily;
use prometheus::{IntCounter, IntCounterVec, IntGauge, IntGaugeVec, Opts, Registry, Result};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use super::connection::ConnectionPurpose;
use crate::journal::Journal;

/// Metrics of MQTT, which all configurations share.
#[derive(Debug, Clone)]
pub(super) struct MqttMetrics {
    connected: IntGaugeVec,
    failures: IntCounterVec,
    pub(super) messages: IntCounter,
    pub(super) records: IntCounter,
    /// Newest event that a broker has kept.
    position: Arc<AtomicI64>,
}

impl MqttMetrics {
    /// Registers the metrics.
    pub(super) fn register(registry: &Registry, journal: &Journal) -> Result<Self> {
        let connected = Opts::new("wsg_mqtt_connected", "Whether a connection to the MQTT broker is up (0 or 1).");
        let failures = Opts::new("wsg_mqtt_failures_total", "Failed and lost connections to the MQTT broker.");
        let messages = IntCounter::new("wsg_mqtt_messages_total", "Messages published over MQTT, records included.")?;
        let records = IntCounter::new(
            "wsg_mqtt_records_total",
            "Events and grip records that the MQTT broker has acknowledged, repetitions included.",
        )?;
        let metrics = Self {
            connected: IntGaugeVec::new(connected, &["connection"])?,
            failures: IntCounterVec::new(failures, &["connection"])?,
            messages,
            records,
            position: Arc::new(AtomicI64::new(journal.last_seq())),
        };
        registry.register(Box::new(metrics.connected.clone()))?;
        registry.register(Box::new(metrics.failures.clone()))?;
        registry.register(Box::new(metrics.messages.clone()))?;
        registry.register(Box::new(metrics.records.clone()))?;
        let waiting = Opts::new("wsg_mqtt_waiting_events", "Events that the MQTT broker has not acknowledged yet.");
        let waiting = IntGauge::with_opts(waiting)?;
        let backlog = Backlog { journal: journal.clone(), position: metrics.position.clone(), waiting };
        registry.register(Box::new(backlog))?;
        Ok(metrics)
    }

    /// Starts the series of a connection.
    pub(super) fn serves(&self, purpose: ConnectionPurpose) {
        self.connected.with_label_values(&[purpose.name()]).set(0);
        self.failures.with_label_values(&[purpose.name()]);
    }

    /// Ends the gauge of a connection.
    pub(super) fn ends(&self, purpose: ConnectionPurpose) {
        // The series is absent if the connection has never begun.
        let _ = self.connected.remove_label_values(&[purpose.name()]);
    }

    pub(super) fn connected(&self, purpose: ConnectionPurpose, is_connected: bool) {
        self.connected.with_label_values(&[purpose.name()]).set(is_connected.into());
    }

    pub(super) fn failed(&self, purpose: ConnectionPurpose) {
        self.failures.with_label_values(&[purpose.name()]).inc();
    }

    /// Sets the newest event that needs not be published any more.
    pub(super) fn at(&self, event: i64) {
        self.position.store(event, Ordering::Relaxed);
    }
}

/// The events that are still to be acknowledged, counted at each scrape.
struct Backlog {
    journal: Journal,
    position: Arc<AtomicI64>,
    waiting: IntGauge,
}

impl Collector for Backlog {
    fn desc(&self) -> Vec<&Desc> {
        self.waiting.desc()
    }

    fn collect(&self) -> Vec<MetricFamily> {
        let waiting = self.journal.last_seq().saturating_sub(self.position.load(Ordering::Relaxed));
        self.waiting.set(waiting.max(0));
        self.waiting.collect()
    }
}
