//! A message with a request: its properties, and the answer to it.

use bytes::Bytes;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Publish, PublishProperties};
use serde_json::value::RawValue;

use super::receiver::OutgoingPackets;
use super::topics::Topics;
use crate::fleet::keys::MAX_CLIENT_BYTES;
use crate::model::{Client, Door, ShownName};
use crate::operations::{OperationReply, Problem};

/// Longest correlation data, in bytes. It is kept until the answer.
const MAX_CORRELATION_BYTES: usize = 1024;

/// User property of an answer with the status that HTTP would have.
const STATUS: &str = "status";

/// Content type of a problem (RFC 9457).
const PROBLEM: &str = "application/problem+json";

/// Where the answer to a request goes.
#[derive(Debug, Clone)]
pub(super) struct ReplyTo {
    /// `None` if the requester wants no answer.
    topic: Option<String>,
    pub(super) correlation: Option<Bytes>,
    outgoing: OutgoingPackets,
}

/// Result of a request, and its status.
#[derive(Debug, Clone)]
pub(super) struct MqttReply {
    pub(super) status: u16,
    pub(super) body: String,
}

impl MqttReply {
    pub(super) fn of(result: &Result<OperationReply, Problem>) -> Self {
        match result {
            Ok(reply) => Self { status: 200, body: RawValue::get(&reply.body).to_owned() },
            Err(problem) => Self::refusing(problem),
        }
    }

    pub(super) fn refusing(problem: &Problem) -> Self {
        let body = serde_json::to_string(problem).unwrap_or_default();
        Self { status: problem.status().as_u16(), body }
    }
}

impl ReplyTo {
    pub(super) fn of(message: &Publish, topics: &Topics, outgoing: &OutgoingPackets) -> Self {
        let properties = message.properties.as_ref();
        let asked = properties.and_then(|properties| properties.response_topic.clone());
        let topic = asked.clone().filter(|topic| topics.allows_response(topic));
        if let (Some(asked), None) = (&asked, &topic) {
            tracing::warn!(topic = asked, "MQTT answer not sent: its topic is not allowed");
        }
        let correlation = properties.and_then(|properties| properties.correlation_data.clone());
        let correlation = correlation.filter(|data| data.len() <= MAX_CORRELATION_BYTES);
        Self { topic, correlation, outgoing: outgoing.clone() }
    }

    /// Sends an answer, if the requester wants one. It has QoS 0: a requester without an answer repeats its request.
    pub(super) fn send(&self, reply: &MqttReply, json: &str) {
        let Some(topic) = &self.topic else { return };
        let content_type = if reply.status < 300 { json } else { PROBLEM };
        let properties = PublishProperties {
            content_type: Some(content_type.to_owned()),
            correlation_data: self.correlation.clone(),
            user_properties: vec![(STATUS.to_owned(), reply.status.to_string())],
            ..PublishProperties::default()
        };
        let publish = Publish::new(topic, QoS::AtMostOnce, reply.body.clone(), Some(properties));
        if !self.outgoing.answer(publish) {
            tracing::debug!(topic, "MQTT answer not sent: the connection has ended, or too many answers wait");
        }
    }
}

/// Returns a user property of a message. An empty one counts as absent.
pub(super) fn property(message: &Publish, key: &str) -> Option<String> {
    let properties = &message.properties.as_ref()?.user_properties;
    properties.iter().find(|(name, value)| name == key && !value.is_empty()).map(|(_, value)| value.clone())
}

/// Returns a client by the name that it claims in the user property `client`. A wrong name counts as none.
pub(super) fn client(message: &Publish) -> Client {
    let name = property(message, "client").and_then(|name| ShownName::<MAX_CLIENT_BYTES>::new(&name).ok());
    let name = name.as_ref().map_or("unknown", ShownName::as_str);
    Client::new(format!("mqtt:{name}"), Door::Mqtt)
}
