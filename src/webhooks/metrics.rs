//! Prometheus metrics of a webhook.

use std::sync::Arc;

use prometheus::core::{Collector, Desc};
use prometheus::proto::MetricFamily;
use prometheus::{IntCounter, IntGauge, Opts, Registry, Result};

use super::Webhook;
use crate::model::Name;

#[derive(Debug, Clone)]
pub(super) struct WebhookMetrics {
    pub(super) deliveries: IntCounter,
    pub(super) failures: IntCounter,
}

impl WebhookMetrics {
    pub(super) fn new(webhook: &Name) -> Result<Self> {
        Ok(Self {
            deliveries: IntCounter::with_opts(opts(
                webhook,
                "wsg_webhook_deliveries_total",
                "Deliveries that the receiver accepted.",
            ))?,
            failures: IntCounter::with_opts(opts(
                webhook,
                "wsg_webhook_failures_total",
                "Attempts to deliver that failed.",
            ))?,
        })
    }
}

/// Registers a webhook's metrics.
pub(super) fn register(registry: &Registry, webhook: &Arc<Webhook>) -> Result<()> {
    collectors(webhook)?.into_iter().try_for_each(|collector| registry.register(collector))
}

/// Removes the metrics of a webhook that has ended.
pub(super) fn unregister(registry: &Registry, webhook: &Arc<Webhook>) -> Result<()> {
    collectors(webhook)?.into_iter().try_for_each(|collector| registry.unregister(collector))
}

fn collectors(webhook: &Arc<Webhook>) -> Result<[Box<dyn Collector>; 3]> {
    let waiting = opts(webhook.name(), "wsg_webhook_waiting_events", "Events that the webhook has yet to handle.");
    let waiting = IntGauge::with_opts(waiting)?;
    Ok([
        Box::new(webhook.metrics.deliveries.clone()),
        Box::new(webhook.metrics.failures.clone()),
        Box::new(Backlog { webhook: webhook.clone(), waiting }),
    ])
}

fn opts(webhook: &Name, name: &str, help: &str) -> Opts {
    Opts::new(name, help).const_label("webhook", webhook.as_str())
}

/// Backlog of a webhook, read at each scrape.
struct Backlog {
    webhook: Arc<Webhook>,
    waiting: IntGauge,
}

impl Collector for Backlog {
    fn desc(&self) -> Vec<&Desc> {
        self.waiting.desc()
    }

    fn collect(&self) -> Vec<MetricFamily> {
        self.waiting.set(self.webhook.waiting());
        self.waiting.collect()
    }
}
