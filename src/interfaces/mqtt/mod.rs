//! MQTT 5: states, alarms and the journal's records to a broker; requests and FAST STOPs from it.
//!
//! | topic below the prefix | use |
//! | --- | --- |
//! | `availability` | retained: `online`, or `offline`, which is also the last will |
//! | `description`, `alarms` | retained: the gateway, and its alarms |
//! | `{gripper}/state` | retained: the newest state, or `null` while the link is lost |
//! | `{gripper}/telemetry` | measured values, if they are configured |
//! | `{gripper}/events`, `{gripper}/grips`, `events` | records of the journal, in order and at least once |
//! | `{gripper}/command/{name}`, `command/{name}` | requests, if they are configured |
//! | `{gripper}/fast-stop`, `fast-stop` | FAST STOPs, if they are configured |
//!
//! The gateway has a connection for each purpose, so that a flood of requests fills neither the broker's queue nor the
//! socket through which a FAST STOP comes. Each receiving connection reads without waiting for what it writes.
//!
//! rumqttc encodes and decodes the packets. Its event loop is not used: it stops acknowledging what it has received
//! while its own messages wait, repeats messages from a list of its own, and opens connections itself. The journal
//! already knows what to repeat.

mod connection;
#[cfg(test)]
mod documents_tests;
mod failure;
mod fast_stop;
mod live;
mod message;
mod metrics;
mod mqtt_settings;
mod position;
mod publisher;
mod receiver;
mod records;
mod requests;
mod status;
mod supervision;
mod topics;
mod window;

use std::sync::Arc;

use prometheus::Registry;
use tokio::sync::{Mutex, watch};
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

use crate::alarms::BrokerOutage;
use crate::connections::Runtimes;
use crate::connections::metrics::InterfaceMetrics;
use crate::model::{PersistedKey, PersistedState};
use crate::operations::Gateway;
use connection::ConnectionPurpose;
use fast_stop::MqttFastStops;
use metrics::MqttMetrics;
use position::StoredPosition;
use publisher::Publisher;
use receiver::{MqttReceiver, Receive, TopicSubscription};
use requests::Requests;
use status::MqttStatus;
use supervision::keep_serving;

pub use connection::check;
pub use failure::MqttFailure;
pub use mqtt_settings::{
    Broker, BrokerCertificate, BrokerLogin, BrokerTls, BrokerUrl, InvalidMqttSetting, MqttRules, MqttSettings,
};
pub use topics::{InvalidPrefix, Topics};

/// Parts of the gateway that MQTT uses.
#[derive(Debug, Clone)]
pub struct MqttContext {
    pub gateway: Arc<Gateway>,
    pub runtimes: Runtimes,
    pub registry: Registry,
    /// Ends MQTT on shutdown.
    pub closing: CancellationToken,
    /// Shows the alarms how long the broker has been away.
    pub outage: watch::Sender<Option<BrokerOutage>>,
}

/// Starts, changes and ends MQTT.
#[derive(Debug)]
pub struct MqttRunner {
    context: MqttContext,
    state: Mutex<RunnerState>,
}

#[derive(Debug, Default)]
struct RunnerState {
    /// Metrics, from the first configuration with MQTT on.
    metrics: Option<(MqttMetrics, InterfaceMetrics)>,
    running: Option<RunningMqtt>,
}

#[derive(Debug)]
struct RunningMqtt {
    settings: Arc<MqttSettings>,
    ending: CancellationToken,
    publishing: JoinHandle<Option<StoredPosition>>,
    receiving: Vec<JoinHandle<()>>,
}

impl RunningMqtt {
    /// Ends all connections, and returns the position of the records.
    async fn end(self) -> Option<StoredPosition> {
        self.ending.cancel();
        for receiving in self.receiving {
            // A panic has ended that connection already.
            let _ = receiving.await;
        }
        self.publishing.await.unwrap_or_default()
    }
}

impl MqttRunner {
    #[must_use]
    pub fn new(context: MqttContext) -> Self {
        Self { context, state: Mutex::default() }
    }

    /// Ends MQTT if its settings have changed, and starts it with the new ones. `None` switches it off. The records
    /// continue after the newest one that the broker has acknowledged, or after the persisted position.
    ///
    /// # Errors
    /// A metric cannot be registered, or the journal cannot be read.
    pub async fn apply(&self, settings: Option<MqttSettings>, persisted: &[PersistedState]) -> anyhow::Result<()> {
        let mut state = self.state.lock().await;
        if state.running.as_ref().map(|running| &*running.settings) == settings.as_ref() {
            return Ok(());
        }
        let position = match state.running.take() {
            Some(running) => running.end().await,
            None => None,
        };
        let Some(settings) = settings else {
            self.context.outage.send_replace(None);
            if let Some((metrics, _)) = &state.metrics {
                // Nothing waits while MQTT is off.
                metrics.at(i64::MAX);
            }
            return Ok(());
        };
        let metrics = match state.metrics.clone() {
            Some(metrics) => metrics,
            None => self.register()?,
        };
        state.metrics = Some(metrics.clone());
        state.running = Some(self.start(settings, metrics, position.or_else(|| stored_position(persisted))).await?);
        Ok(())
    }

    fn register(&self) -> prometheus::Result<(MqttMetrics, InterfaceMetrics)> {
        let registry = &self.context.registry;
        Ok((
            MqttMetrics::register(registry, &self.context.gateway.journal)?,
            InterfaceMetrics::register(registry, "mqtt")?,
        ))
    }

    async fn start(
        &self,
        settings: MqttSettings,
        (metrics, of_interface): (MqttMetrics, InterfaceMetrics),
        stored: Option<StoredPosition>,
    ) -> anyhow::Result<RunningMqtt> {
        let MqttContext { gateway, runtimes, outage, closing, .. } = &self.context;
        let newest = records::newest(&gateway.journal).await?;
        let settings = Arc::new(settings);
        let ending = closing.child_token();
        let status = Arc::new(MqttStatus::new(settings.broker.to_string(), metrics, outage.clone()));
        let mut receiving = Vec::new();
        let stops = MqttFastStops::new(gateway.clone(), runtimes.accept.clone(), of_interface.clone(), &settings);
        let stops = Arc::new(stops);
        if settings.rules.fast_stop {
            let receiver = MqttReceiver {
                purpose: ConnectionPurpose::FastStops,
                // A FAST STOP that is published as a retained one stops, too: only the broker's repetitions do not.
                subscription: TopicSubscription { topics: settings.topics.fast_stops().into(), shows_retained: false },
                receive: stops.clone(),
                status: status.clone(),
                metrics: of_interface.clone(),
                ending: ending.clone(),
            };
            receiving.push(runtimes.accept.spawn(receive(receiver, settings.clone())));
        }
        if settings.rules.commands {
            let runtime = runtimes.requests.clone();
            let requests = Requests::new(gateway.clone(), runtime, of_interface.clone(), &settings, stops);
            let receiver = MqttReceiver {
                purpose: ConnectionPurpose::Commands,
                subscription: TopicSubscription { topics: settings.topics.requests().into(), shows_retained: true },
                receive: Arc::new(requests),
                status: status.clone(),
                metrics: of_interface,
                ending: ending.clone(),
            };
            receiving.push(runtimes.requests.spawn(receive(receiver, settings.clone())));
        }
        let publisher = Publisher::new(gateway.clone(), settings.clone(), status, ending.clone(), stored, newest);
        let publishing = runtimes.observers.spawn(publisher.run());
        Ok(RunningMqtt { settings, ending, publishing, receiving })
    }

    /// Waits until all connections have ended, and the position is on its way to the journal.
    pub async fn ended(&self) {
        if let Some(running) = self.state.lock().await.running.take() {
            running.end().await;
        }
    }
}

async fn receive<R: Receive>(mut receiver: MqttReceiver<R>, settings: Arc<MqttSettings>) {
    let status = receiver.status.clone();
    let ending = receiver.ending.clone();
    keep_serving(&mut receiver, &settings, &status, &ending).await;
}

/// Returns the position that an earlier run has stored.
fn stored_position(persisted: &[PersistedState]) -> Option<StoredPosition> {
    let state = persisted.iter().find(|state| state.key == PersistedKey::Mqtt)?;
    serde_json::from_str(state.value.as_deref()?).ok()
}
