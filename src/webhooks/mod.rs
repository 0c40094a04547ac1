//! Webhooks: the journal's events as HTTP requests to receivers, at least once and in order.
//!
//! Each webhook has one task, which follows the journal and repeats a delivery until its receiver accepts it. The task
//! stores its position in the journal's file, and continues there after a restart. The task holds one event at a time
//! and never delays a gripper: events wait in the journal until the receiver accepts them.

mod client;
mod delivery;
mod metrics;
#[cfg(test)]
mod tests;
mod webhook_settings;
mod worker;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
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
use crate::journal::{EventKind, Journal};
use crate::model::{Name, PersistedKey, PersistedState};
use client::WebhookClient;
use delivery::Delivery;
use metrics::WebhookMetrics;
use worker::Worker;

pub use client::DeliveryFailure;
pub use webhook_settings::{Authorities, InvalidSetting, Receiver, SigningSecret, WebhookSettings};

/// Parts of the gateway that webhooks use.
#[derive(Debug, Clone)]
pub struct WebhookContext {
    pub gateway: Name,
    pub journal: Journal,
    pub registry: Registry,
    /// Ends the webhooks on shutdown.
    pub closing: CancellationToken,
    pub runtime: Handle,
}

/// All webhooks of the gateway. Clones of the list stay valid while a reload changes it.
#[derive(Debug, Default)]
pub struct Webhooks(RwLock<Vec<Arc<Webhook>>>);

/// Starts, changes and ends the webhooks.
#[derive(Debug)]
pub struct WebhookRunner {
    context: WebhookContext,
    webhooks: Arc<Webhooks>,
    tasks: TaskTracker,
}

/// Webhooks of a new configuration, which are not started yet.
#[derive(Debug)]
pub struct WebhookChanges {
    /// All webhooks, in the order of the configuration.
    all: Vec<PreparedWebhook>,
}

#[derive(Debug)]
enum PreparedWebhook {
    /// A webhook whose settings stay.
    Kept(Arc<Webhook>),
    New(Box<NewWebhook>),
}

#[derive(Debug)]
struct NewWebhook {
    settings: WebhookSettings,
    client: WebhookClient,
}

impl WebhookChanges {
    fn keeps(&self, webhook: &Arc<Webhook>) -> bool {
        self.all.iter().any(|change| matches!(change, PreparedWebhook::Kept(kept) if Arc::ptr_eq(kept, webhook)))
    }
}

impl Webhooks {
    /// Returns the webhooks, in the order of the configuration.
    #[must_use]
    pub fn all(&self) -> Vec<Arc<Webhook>> {
        self.0.read().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the webhook with this name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<Arc<Webhook>> {
        self.all().into_iter().find(|webhook| webhook.name().as_str() == name)
    }
}

impl WebhookRunner {
    #[must_use]
    pub fn new(context: WebhookContext) -> Self {
        Self { context, webhooks: Arc::default(), tasks: TaskTracker::new() }
    }

    #[must_use]
    pub fn webhooks(&self) -> &Arc<Webhooks> {
        &self.webhooks
    }

    /// Compares the webhooks with new settings, and prepares what is new.
    ///
    /// # Errors
    /// A TLS configuration is invalid.
    pub fn prepare(&self, settings: &[WebhookSettings]) -> anyhow::Result<WebhookChanges> {
        let running = self.webhooks.all();
        let mut all = Vec::new();
        for settings in settings {
            if let Some(webhook) = running.iter().find(|webhook| webhook.settings == *settings) {
                all.push(PreparedWebhook::Kept(webhook.clone()));
                continue;
            }
            let client = WebhookClient::new(settings.receiver.clone(), &settings.authorities)?;
            all.push(PreparedWebhook::New(Box::new(NewWebhook { settings: settings.clone(), client })));
        }
        Ok(WebhookChanges { all })
    }

    /// Ends removed and changed webhooks, and starts changed and new ones. A changed webhook continues after the newest
    /// event that it has delivered; a new one continues at its persisted position, if it has one.
    ///
    /// # Errors
    /// A metric cannot be registered.
    pub async fn apply(&self, changes: WebhookChanges, persisted: &[PersistedState]) -> anyhow::Result<()> {
        let before = self.webhooks.all();
        let ending: Vec<_> = before.iter().filter(|webhook| !changes.keeps(webhook)).collect();
        for webhook in &ending {
            webhook.ending.cancel();
        }
        for webhook in ending {
            webhook.ended.cancelled().await;
            metrics::unregister(&self.context.registry, webhook)?;
        }
        let mut all = Vec::new();
        for change in changes.all {
            let webhook = match change {
                PreparedWebhook::Kept(webhook) => webhook,
                PreparedWebhook::New(new) => {
                    let name = &new.settings.name;
                    let former = before.iter().find(|webhook| webhook.name() == name);
                    let position = former.map(|webhook| webhook.progress().position);
                    let stored = position.or_else(|| stored_position(persisted, name));
                    self.start(*new, stored)?
                }
            };
            all.push(webhook);
        }
        *self.webhooks.0.write().unwrap_or_else(PoisonError::into_inner) = all;
        Ok(())
    }

    fn start(&self, new: NewWebhook, stored: Option<i64>) -> anyhow::Result<Arc<Webhook>> {
        let webhook = Webhook::new(new, &self.context, stored)?;
        metrics::register(&self.context.registry, &webhook)?;
        let worker = Worker::new(webhook.clone(), stored);
        let ended = webhook.ended.clone().drop_guard();
        let running = async move {
            let _ended = ended;
            worker.run().await;
        };
        self.tasks.spawn_on(running, &self.context.runtime);
        Ok(webhook)
    }

    /// Waits until all tasks have ended and passed their positions to the journal.
    pub async fn ended(&self) {
        self.tasks.close();
        self.tasks.wait().await;
    }
}

/// Returns the position that an earlier run of a webhook has stored.
fn stored_position(persisted: &[PersistedState], name: &Name) -> Option<i64> {
    let state = persisted.iter().find(|state| state.gripper == *name && state.key == PersistedKey::Webhook)?;
    state.value.as_ref()?.parse().ok()
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
    /// Ends the webhook's task.
    ending: CancellationToken,
    /// Cancelled when the task has ended.
    ended: CancellationToken,
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
    /// Time of the first of them.
    pub failing_since: Option<std::time::Instant>,
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
        NewWebhook { settings, client }: NewWebhook,
        context: &WebhookContext,
        position: Option<i64>,
    ) -> anyhow::Result<Arc<Self>> {
        // A new webhook delivers only events from now on.
        let position = position.unwrap_or_else(|| context.journal.last_seq());
        Ok(Arc::new(Self {
            gateway: context.gateway.clone(),
            client,
            journal: context.journal.clone(),
            runtime: context.runtime.clone(),
            progress: Mutex::new(WebhookProgress { position, ..WebhookProgress::default() }),
            retry: Notify::new(),
            testing: Arc::new(Semaphore::new(1)),
            metrics: WebhookMetrics::new(&settings.name)?,
            ending: context.closing.child_token(),
            ended: CancellationToken::new(),
            settings,
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
