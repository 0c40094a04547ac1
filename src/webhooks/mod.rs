//! Webhooks: the journal's events as HTTP requests to receivers, at least once and in order.
//!
//! Each webhook has one task, which follows the journal and repeats a delivery until its receiver accepts it. The task
//! stores its position in the journal's file, and continues there after a restart. The task holds one event at a time
//! and never delays a gripper: events wait in the journal until the receiver accepts them.

mod client;
mod delivery;
mod metrics;
mod settings;
#[cfg(test)]
mod tests;
mod worker;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use http::StatusCode;
use jiff::Timestamp;
use prometheus::Registry;
use tokio::runtime::Handle;
use tokio::sync::{Notify, Semaphore};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

use crate::gripper::Now;
use crate::gripper::model::{Name, PersistedKey, PersistedState};
use crate::journal::{EventKind, Journal};
use client::WebhookClient;
use delivery::Delivery;
use metrics::WebhookMetrics;
use worker::Worker;

pub use client::DeliveryFailure;
pub use settings::{Authorities, InvalidSetting, Receiver, SigningSecret, WebhookSettings};

/// Parts of the gateway that webhooks use.
#[derive(Debug)]
pub struct WebhookContext<'a> {
    pub gateway: &'a Name,
    pub journal: &'a Journal,
    /// Persisted values of earlier runs.
    pub persisted: &'a [PersistedState],
    pub registry: &'a Registry,
    /// Ends the webhooks on shutdown.
    pub closing: &'a CancellationToken,
    pub runtime: &'a Handle,
}

/// All webhooks of the gateway.
#[derive(Debug, Default)]
pub struct Webhooks {
    webhooks: Vec<Arc<Webhook>>,
    tasks: TaskTracker,
}

impl Webhooks {
    /// Starts a task for each webhook.
    ///
    /// # Errors
    /// A TLS configuration or a metric is invalid.
    pub fn start(settings: &[WebhookSettings], context: &WebhookContext<'_>) -> anyhow::Result<Self> {
        let mut all = Self::default();
        for settings in settings {
            let is_position =
                |state: &&PersistedState| state.gripper == settings.name && state.key == PersistedKey::Webhook;
            let persisted = context.persisted.iter().find(is_position);
            let position = persisted.and_then(|state| state.value.as_ref()?.parse().ok());
            let webhook = Webhook::new(settings, context, position)?;
            metrics::register(context.registry, &webhook)?;
            let worker = Worker::new(webhook.clone(), context.closing.clone(), position);
            all.tasks.spawn_on(worker.run(), context.runtime);
            all.webhooks.push(webhook);
        }
        Ok(all)
    }

    /// Waits until all tasks have ended and passed their positions to the journal.
    pub async fn ended(&self) {
        self.tasks.close();
        self.tasks.wait().await;
    }

    pub fn iter(&self) -> impl Iterator<Item = &Arc<Webhook>> {
        self.webhooks.iter()
    }
}

/// One webhook.
#[derive(Debug)]
pub struct Webhook {
    settings: WebhookSettings,
    gateway: Name,
    client: WebhookClient,
    journal: Journal,
    runtime: Handle,
    progress: Mutex<WebhookProgress>,
    /// Ends the pause before the next attempt.
    retry: Notify,
    /// Permit for a test delivery, one at a time.
    testing: Arc<Semaphore>,
    metrics: WebhookMetrics,
}

/// Progress of a webhook through the journal.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WebhookProgress {
    /// Sequence number of the newest event that was delivered or skipped.
    pub position: i64,
    pub last_success_at: Option<Timestamp>,
    pub last_error_at: Option<Timestamp>,
    pub last_error: Option<String>,
    /// Failed attempts since the last success.
    pub failed_attempts: u32,
    /// Time of the next attempt, after a failed one.
    pub retry_at: Option<Timestamp>,
}

impl WebhookProgress {
    fn erred(&mut self, now: Timestamp, error: String) {
        (self.last_error_at, self.last_error) = (Some(now), Some(error));
    }
}

/// Result of a test delivery.
#[derive(Debug)]
pub struct Tested {
    pub result: Result<StatusCode, DeliveryFailure>,
    pub duration: Duration,
}

impl Webhook {
    fn new(
        settings: &WebhookSettings,
        context: &WebhookContext<'_>,
        position: Option<i64>,
    ) -> anyhow::Result<Arc<Self>> {
        // A new webhook delivers only events from now on.
        let position = position.unwrap_or_else(|| context.journal.last_seq());
        Ok(Arc::new(Self {
            gateway: context.gateway.clone(),
            client: WebhookClient::new(settings.receiver.clone(), &settings.authorities)?,
            journal: context.journal.clone(),
            runtime: context.runtime.clone(),
            progress: Mutex::new(WebhookProgress { position, ..WebhookProgress::default() }),
            retry: Notify::new(),
            testing: Arc::new(Semaphore::new(1)),
            metrics: WebhookMetrics::new(&settings.name)?,
            settings: settings.clone(),
        }))
    }

    #[must_use]
    pub fn name(&self) -> &Name {
        &self.settings.name
    }

    #[must_use]
    pub fn receiver(&self) -> &Receiver {
        &self.settings.receiver
    }

    /// Kinds of events that are delivered; `None` means all.
    #[must_use]
    pub fn kinds(&self) -> Option<&[EventKind]> {
        self.settings.kinds.as_deref()
    }

    #[must_use]
    pub fn progress(&self) -> WebhookProgress {
        self.lock().clone()
    }

    /// Number of events after the position, of any kind.
    #[must_use]
    pub fn waiting(&self) -> i64 {
        self.journal.last_seq().saturating_sub(self.lock().position).max(0)
    }

    /// Sends a test delivery. Returns `None` while another one is in progress. After a success, a waiting delivery is
    /// attempted at once.
    pub async fn test(self: &Arc<Self>) -> Option<Tested> {
        let permit = self.testing.clone().try_acquire_owned().ok()?;
        let webhook = self.clone();
        let testing = self.runtime.spawn(async move {
            let _permit = permit;
            let begin = Instant::now();
            let at = format!("{:.3}", Now::read().wall);
            let body = serde_json::json!({"kind": "test", "at": at, "gateway": webhook.gateway});
            let delivery = Delivery::new(&webhook.gateway, 0, &body.to_string());
            let result = webhook.attempt(&delivery).await;
            if result.is_ok() {
                webhook.retry.notify_waiters();
            }
            Tested { result, duration: begin.elapsed() }
        });
        testing.await.ok()
    }

    async fn attempt(&self, delivery: &Delivery) -> Result<StatusCode, DeliveryFailure> {
        let request = delivery.request(&self.settings.receiver, &self.settings.secret, Now::read().wall)?;
        self.client.send(request).await
    }

    /// Whether events of this kind are delivered.
    fn wants(&self, kind: EventKind) -> bool {
        self.kinds().is_none_or(|kinds| kinds.contains(&kind))
    }

    fn lock(&self) -> MutexGuard<'_, WebhookProgress> {
        // The values stay consistent even if a thread panics while it holds the lock.
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
