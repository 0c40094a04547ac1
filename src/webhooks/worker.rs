//! The task of a webhook.

use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::Timestamp;
use rand::RngExt as _;
use serde_json::json;
use tokio::time::sleep;

use super::Webhook;
use super::client::DeliveryFailure;
use super::delivery::Delivery;
use crate::gripper::Now;
use crate::gripper::recorder::{Record, Recorder as _};
use crate::journal::{Filter, StreamItem};
use crate::model::clock::sleep_until;
use crate::model::{PersistedKey, PersistedState};

/// Time after which a new position is stored. After a kill, the gateway repeats the deliveries of this time.
const STORED_AFTER: Duration = Duration::from_secs(1);

/// Pause after the first failed attempt. It doubles with each further one.
const FIRST_PAUSE: Duration = Duration::from_secs(1);

/// Longest pause between two attempts, unless the receiver asks for a longer one.
const LONGEST_PAUSE: Duration = Duration::from_mins(5);

/// Longest pause that a receiver can ask for.
const LONGEST_RETRY_AFTER: Duration = Duration::from_hours(1);

/// Pause after the journal could not be read.
const READ_RETRY_PAUSE: Duration = Duration::from_secs(1);

/// Time for an attempt in progress to end with the webhook, so that the next start does not repeat it.
const FINISHED_WITHIN: Duration = Duration::from_secs(2);

pub(super) struct Worker {
    webhook: Arc<Webhook>,
    /// Position that was stored last; `None` if none was stored yet.
    stored: Option<i64>,
    /// Time at which a newer position will be stored.
    store_at: Option<Instant>,
}

impl Worker {
    pub(super) fn new(webhook: Arc<Webhook>, stored: Option<i64>) -> Self {
        Self { webhook, stored, store_at: None }
    }

    /// Delivers events until the webhook or the journal ends.
    pub(super) async fn run(mut self) {
        let mut events = self.webhook.journal.follow(Some(self.webhook.lock().position), Filter::default());
        // Without a stored position, a restart before the first delivery would skip the events until then.
        self.store();
        loop {
            let item = tokio::select! {
                biased;
                () = self.webhook.ending.cancelled() => break,
                () = sleep_until(self.store_at) => {
                    self.store();
                    continue;
                }
                item = events.next() => item,
            };
            let (seq, body) = match item {
                Ok(Some(StreamItem::Event(event))) if self.webhook.wants(event.kind) => (event.seq, event.body.clone()),
                Ok(Some(StreamItem::Event(event))) => {
                    self.advance(event.seq);
                    continue;
                }
                Ok(Some(StreamItem::Removed { after, missed })) => {
                    let seq = after + missed;
                    let gateway = &self.webhook.gateway;
                    (seq, json!({"kind": "gap", "gateway": gateway, "seq": after, "missed": missed}).to_string().into())
                }
                Ok(None) => break,
                Err(error) => {
                    tracing::warn!(webhook = %self.webhook.name(), %error, "webhook events could not be read; retrying");
                    self.webhook.lock().erred(Now::read().wall, error.to_string());
                    self.pause(READ_RETRY_PAUSE).await;
                    continue;
                }
            };
            if !self.deliver(&Delivery::new(&self.webhook.gateway, seq, &body)).await {
                break;
            }
            self.advance(seq);
        }
        self.store();
    }

    /// Repeats a delivery until the receiver accepts it. Returns `false` if the webhook ends before.
    async fn deliver(&mut self, delivery: &Delivery) -> bool {
        loop {
            let too_late = async {
                self.webhook.ending.cancelled().await;
                sleep(FINISHED_WITHIN).await;
            };
            let result = tokio::select! {
                result = self.webhook.attempt(delivery) => result,
                () = too_late => return false,
            };
            match result {
                Ok(_) => {
                    self.succeeded();
                    return true;
                }
                Err(failure) => {
                    let pause = self.failed(&failure);
                    // The position does not change in a long outage, so it is stored now.
                    self.store();
                    self.pause(pause).await;
                }
            }
            if self.webhook.ending.is_cancelled() {
                return false;
            }
        }
    }

    fn succeeded(&self) {
        self.webhook.metrics.deliveries.inc();
        let mut progress = self.webhook.lock();
        if progress.failed_attempts > 0 {
            tracing::info!(webhook = %self.webhook.name(), attempts = progress.failed_attempts, "webhook recovered");
        }
        progress.last_success_at = Some(Now::read().wall);
        (progress.failed_attempts, progress.retry_at, progress.failing_since) = (0, None, None);
    }

    /// Notes a failed attempt, and returns the pause before the next one.
    fn failed(&self, failure: &DeliveryFailure) -> Duration {
        self.webhook.metrics.failures.inc();
        let Now { instant, wall: now, .. } = Now::read();
        let mut progress = self.webhook.lock();
        progress.failed_attempts = progress.failed_attempts.saturating_add(1);
        progress.failing_since.get_or_insert(instant);
        let pause = pause(progress.failed_attempts, failure.retry_after(), rand::rng().random());
        let error = failure.to_string();
        let retry_in_s = pause.as_secs();
        if progress.failed_attempts == 1 {
            tracing::warn!(webhook = %self.webhook.name(), error, retry_in_s, "webhook delivery failed; retrying");
        } else {
            tracing::debug!(webhook = %self.webhook.name(), error, retry_in_s, "webhook delivery failed again");
        }
        progress.erred(now, error);
        progress.retry_at = later(now, pause);
        pause
    }

    /// Waits, unless the webhook ends or a test delivery succeeds.
    async fn pause(&self, pause: Duration) {
        tokio::select! {
            () = sleep(pause) => {}
            () = self.webhook.retry.notified() => {}
            () = self.webhook.ending.cancelled() => {}
        }
    }

    fn advance(&mut self, seq: i64) {
        self.webhook.lock().position = seq;
        self.store_at.get_or_insert_with(|| Now::read().instant + STORED_AFTER);
    }

    /// Passes a new position to the journal.
    fn store(&mut self) {
        self.store_at = None;
        let position = self.webhook.lock().position;
        if self.stored != Some(position) {
            self.stored = Some(position);
            let gripper = self.webhook.name().clone();
            let value = Some(position.to_string());
            let state = PersistedState { gripper, key: PersistedKey::Webhook, value };
            self.webhook.journal.record(Record::Persisted(state));
        }
    }
}

/// Returns the pause after a failed attempt. Its maximum grows exponentially, and `jitter` from 0 to 1 selects a pause
/// from half of this maximum to all of it. A longer pause that the receiver asked for has priority.
fn pause(failed_attempts: u32, retry_after: Option<Duration>, jitter: f64) -> Duration {
    let doubled = 2_u32.saturating_pow(failed_attempts.saturating_sub(1));
    let longest = FIRST_PAUSE.saturating_mul(doubled).min(LONGEST_PAUSE);
    let pause = longest.mul_f64(0.5 + jitter / 2.0);
    pause.max(retry_after.unwrap_or_default().min(LONGEST_RETRY_AFTER))
}

fn later(now: Timestamp, pause: Duration) -> Option<Timestamp> {
    let later = now.checked_add(pause).ok()?;
    Timestamp::from_millisecond(later.as_millisecond()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pause_grows_to_its_limit() {
        let milliseconds =
            |failed, asked: Option<u64>, jitter| pause(failed, asked.map(Duration::from_secs), jitter).as_millis();
        let grown = [1, 2, 3, 9, 10, u32::MAX].map(|failed| milliseconds(failed, None, 1.0));
        assert_eq!(grown, [1000, 2000, 4000, 256_000, 300_000, 300_000]);
        assert_eq!([1, 10].map(|failed| milliseconds(failed, None, 0.0)), [500, 150_000]);
        let asked = [(1, 60), (10, 60), (1, u64::MAX)].map(|(failed, asked)| milliseconds(failed, Some(asked), 1.0));
        assert_eq!(asked, [60_000, 300_000, 3_600_000]);
    }
}
