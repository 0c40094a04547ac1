//! State of the connections to the broker, for metrics, log and alarm.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::watch;

use super::connection::ConnectionPurpose;
use super::failure::MqttFailure;
use super::metrics::MqttMetrics;
use crate::alarms::BrokerOutage;
use crate::gripper::Now;

/// Pause after the first failure. It doubles with each further one.
const FIRST_PAUSE: Duration = Duration::from_millis(250);

/// Longest pause after a failure. A FAST STOP can be the first message after the broker is back.
const LONGEST_PAUSE: Duration = Duration::from_secs(5);

#[derive(Debug)]
pub(super) struct MqttStatus {
    broker: Arc<str>,
    pub(super) metrics: MqttMetrics,
    outage: watch::Sender<Option<BrokerOutage>>,
    /// Failures of each connection until it has lasted.
    failures: Mutex<BTreeMap<ConnectionPurpose, Failures>>,
}

#[derive(Debug, Clone)]
struct Failures {
    /// Number of failures since the connection was up.
    count: u32,
    outage: BrokerOutage,
}

impl MqttStatus {
    pub(super) fn new(broker: String, metrics: MqttMetrics, outage: watch::Sender<Option<BrokerOutage>>) -> Self {
        outage.send_replace(None);
        Self { broker: broker.into(), metrics, outage, failures: Mutex::default() }
    }

    /// Notes that a connection works.
    pub(super) fn connected(&self, purpose: ConnectionPurpose) {
        self.metrics.connected(purpose, true);
        let attempts = self.change(|failures| {
            let failures = failures.get_mut(&purpose)?;
            failures.outage.connected_at = Some(Now::read().instant);
            Some(std::mem::take(&mut failures.count))
        });
        let attempts = attempts.unwrap_or_default();
        let broker = &*self.broker;
        tracing::info!(broker, connection = purpose.name(), attempts, "MQTT connected");
    }

    /// Notes a failure, and returns the pause before the next attempt.
    pub(super) fn failed(&self, purpose: ConnectionPurpose, failure: &MqttFailure) -> Duration {
        self.metrics.connected(purpose, false);
        self.metrics.failed(purpose);
        let error = failure.to_string();
        let count = self.change(|failures| {
            let before = failures.remove(&purpose);
            let earlier = before.as_ref().map(|before| &before.outage);
            let since = earlier.map_or_else(|| Now::read().instant, |earlier| earlier.since);
            let relapses = earlier.map_or(0, |earlier| earlier.relapses + u32::from(earlier.connected_at.is_some()));
            let count = before.as_ref().map_or(0, |before| before.count).saturating_add(1);
            let cause = error.as_str().into();
            let outage = BrokerOutage { since, connected_at: None, relapses, broker: self.broker.clone(), cause };
            failures.insert(purpose, Failures { count, outage });
            count
        });
        let pause = pause(count, rand::random()).max(failure.pause());
        let retry_in_ms = pause.as_millis();
        let connection = purpose.name();
        if count == 1 {
            tracing::warn!(broker = &*self.broker, connection, error, retry_in_ms, "MQTT connection failed; retrying");
        } else {
            tracing::debug!(broker = &*self.broker, connection, error, retry_in_ms, "MQTT connection failed again");
        }
        pause
    }

    /// Forgets outages that are over, changes the failures, and shows the longest outage to the alarms.
    fn change<T>(&self, change: impl FnOnce(&mut BTreeMap<ConnectionPurpose, Failures>) -> T) -> T {
        let now = Now::read().instant;
        let mut failures = self.failures.lock().unwrap_or_else(PoisonError::into_inner);
        failures.retain(|_, failures| !failures.outage.is_over(now));
        let result = change(&mut failures);
        let outages = failures.values().map(|failures| &failures.outage);
        let longest = outages.min_by_key(|outage| (!outage.is_felt(), outage.since));
        self.outage.send_replace(longest.cloned());
        result
    }
}

/// Returns the pause after a failure. `jitter` from 0 to 1 selects one from half of the maximum to all of it.
fn pause(count: u32, jitter: f64) -> Duration {
    let doubled = 2_u32.saturating_pow(count.saturating_sub(1));
    FIRST_PAUSE.saturating_mul(doubled).min(LONGEST_PAUSE).mul_f64(0.5 + jitter / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pause_grows_to_its_limit() {
        let grown = [1, 2, 3, 5, 6, u32::MAX].map(|count| pause(count, 1.0).as_millis());
        assert_eq!(grown, [250, 500, 1000, 4000, 5000, 5000]);
        assert_eq!(pause(1, 0.0).as_millis(), 125);
    }
}
