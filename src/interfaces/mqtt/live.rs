//! The retained messages: states, alarms and the description of the gateway; and telemetry, which is not retained.
//!
//! States have QoS 0: a broker keeps the newest one for new subscribers, and does not queue states for subscribers that
//! are away, so that they push no records out of such a queue.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use rumqttc::v5::mqttbytes::QoS;
use serde_json::json;

use super::topics::Topics;
use crate::alarms::Alarms;
use crate::gripper::{Grippers, Handle, Now};
use crate::model::{Link, Name, State};
use crate::operations::Gateway;

/// Interval at which an unchanged state is repeated, in case a broker has dropped it for a slow subscriber.
const REPEATED_EVERY: Duration = Duration::from_secs(10);

/// A message that is not a record of the journal.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct LiveMessage {
    pub(super) topic: String,
    pub(super) payload: String,
    pub(super) qos: QoS,
    pub(super) is_retained: bool,
    /// Name of the payload's schema in the OpenAPI document.
    pub(super) schema: &'static str,
}

/// The messages that were published over the present connection.
pub(super) struct Live {
    topics: Topics,
    gateway: Arc<Gateway>,
    /// States by gripper; absent if none was published.
    states: BTreeMap<Name, Option<PublishedState>>,
    alarms: Option<u64>,
    description: Option<String>,
}

struct PublishedState {
    /// `None` while the link is lost.
    state: Option<Arc<State>>,
    at: Instant,
}

impl Live {
    pub(super) fn new(topics: Topics, gateway: Arc<Gateway>) -> Self {
        Self { topics, gateway, states: BTreeMap::new(), alarms: None, description: None }
    }

    /// Begins a new connection, over which everything is published again.
    pub(super) fn begin(&mut self) {
        self.states.values_mut().for_each(|published| *published = None);
        self.alarms = None;
        self.description = None;
    }

    /// Returns the states that have changed, and a deletion of that of each removed gripper.
    pub(super) fn states(&mut self, now: Instant) -> Vec<LiveMessage> {
        let grippers = self.grippers().all();
        let known = self.states.keys();
        let gone: Vec<Name> =
            known.filter(|name| grippers.iter().all(|gripper| gripper.name() != *name)).cloned().collect();
        let mut messages = Vec::new();
        for name in gone {
            self.states.remove(&name);
            messages.push(self.state_message(&name, String::new()));
        }
        for gripper in grippers {
            messages.extend(self.state(&gripper, now));
        }
        messages
    }

    fn state(&mut self, gripper: &Handle, now: Instant) -> Option<LiveMessage> {
        let state = Some(gripper.state()).filter(|state| state.link == Link::Connected);
        let published = self.states.entry(gripper.name().clone()).or_default();
        if let Some(before) = published
            && now.saturating_duration_since(before.at) < REPEATED_EVERY
            && is_like(before.state.as_deref(), state.as_deref())
        {
            return None;
        }
        let payload = encoded(&state.as_deref())?;
        *published = Some(PublishedState { state, at: now });
        Some(self.state_message(gripper.name(), payload))
    }

    fn state_message(&self, gripper: &Name, payload: String) -> LiveMessage {
        let topic = self.topics.gripper(gripper, "state");
        LiveMessage { topic, payload, qos: QoS::AtMostOnce, is_retained: true, schema: "GripperState" }
    }

    /// Returns unknown states of all grippers, for the end of the gateway.
    pub(super) fn unknown_states(&self) -> Vec<LiveMessage> {
        self.states.keys().map(|name| self.state_message(name, "null".to_owned())).collect()
    }

    /// Returns the measured values of all connected grippers.
    pub(super) fn telemetry(&self) -> Vec<LiveMessage> {
        let mut messages = Vec::new();
        for gripper in self.grippers().all() {
            let state = gripper.state();
            if state.link != Link::Connected {
                continue;
            }
            let topic = self.topics.gripper(gripper.name(), "telemetry");
            let payload = encoded(&state.telemetry(Now::read()));
            messages.extend(payload.map(|payload| LiveMessage {
                topic,
                payload,
                qos: QoS::AtMostOnce,
                is_retained: false,
                schema: "Telemetry",
            }));
        }
        messages
    }

    /// Returns the alarms if they have changed.
    pub(super) fn alarms(&mut self) -> Option<LiveMessage> {
        let alarms: &Alarms = &self.gateway.alarms;
        if self.alarms == Some(alarms.changes()) {
            return None;
        }
        let (changes, report) = alarms.read();
        let payload = encoded(&report)?;
        self.alarms = Some(changes);
        Some(self.own("alarms", payload, "AlarmReport"))
    }

    /// Returns the description of the gateway if it has changed.
    pub(super) fn description(&mut self) -> Option<LiveMessage> {
        let grippers: Vec<Name> = self.grippers().all().iter().map(|gripper| gripper.name().clone()).collect();
        let payload = json!({
            "gateway": self.gateway.name,
            "version": env!("CARGO_PKG_VERSION"),
            "journal_id": self.gateway.journal.id(),
            "grippers": grippers,
        });
        let payload = payload.to_string();
        if self.description.as_ref() == Some(&payload) {
            return None;
        }
        self.description = Some(payload.clone());
        Some(self.own("description", payload, "MqttDescription"))
    }

    fn own(&self, what: &str, payload: String, schema: &'static str) -> LiveMessage {
        LiveMessage { topic: self.topics.own(what), payload, qos: QoS::AtLeastOnce, is_retained: true, schema }
    }

    fn grippers(&self) -> &Grippers {
        &self.gateway.grippers
    }
}

/// Whether two published states say the same.
fn is_like(before: Option<&State>, after: Option<&State>) -> bool {
    match (before, after) {
        (Some(before), Some(after)) => before.is_like(after),
        (None, None) => true,
        _ => false,
    }
}

fn encoded(body: &impl serde::Serialize) -> Option<String> {
    let json = serde_json::to_string(body);
    json.inspect_err(|error| tracing::error!(%error, "MQTT message cannot be encoded as JSON")).ok()
}
