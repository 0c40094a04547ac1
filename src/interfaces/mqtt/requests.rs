//! Requests for operations: `PREFIX/command/NAME` and `PREFIX/GRIPPER/command/NAME`.
//!
//! Leases are not offered. The loss of a lease can stop the fingers, and only the broker notices the loss of an MQTT
//! client; renewals through a broker would turn its pauses into FAST STOPs. While nobody holds the lease, motions work,
//! and so they do with a lease token that was taken over another interface.

use std::sync::Arc;

use rumqttc::v5::mqttbytes::v5::Publish;
use serde_json::{Map, Value};
use tokio::runtime::Handle;
use tokio::sync::Semaphore;

use super::fast_stop::{MqttFastStops, retained};
use super::message::{MqttReply, ReplyTo, client, property};
use super::mqtt_settings::MqttSettings;
use super::publisher::JSON;
use super::receiver::{OutgoingPackets, Receive};
use super::topics::{FAST_STOP, Topics};
use crate::access::{Identity, Role};
use crate::connections::metrics::InterfaceMetrics;
use crate::model::{Client, Name, Urgency};
use crate::operations::calls::audit::RefusedRequest;
use crate::operations::parameters::json::{self, MAX_BODY_BYTES};
use crate::operations::parameters::nearest::did_you_mean;
use crate::operations::parameters::values::text;
use crate::operations::{
    self, Caller, Code, Gateway, MAX_LEASE_BYTES, Method, OperationReply, Presence, Problem, Wait, all,
};

/// Maximum number of concurrent requests. More are refused as `overloaded`.
const MAX_REQUESTS: usize = 64;

/// Maximum number of concurrent Stops and cancellations, which have slots of their own.
const MAX_STOPS: usize = 64;

/// Field that names the gripper.
const GRIPPER: &str = "gripper";

/// First part of the names of operations that need a lease to be kept.
const LEASE: &str = "lease.";

/// The requests of MQTT clients.
pub(super) struct Requests {
    gateway: Arc<Gateway>,
    runtime: Handle,
    metrics: InterfaceMetrics,
    topics: Topics,
    role: Role,
    fast_stops: Arc<MqttFastStops>,
    slots: Arc<Semaphore>,
    stop_slots: Arc<Semaphore>,
}

/// A request that names an operation.
struct ParsedRequest {
    method: Method,
    params: Map<String, Value>,
    caller: Caller,
}

impl Requests {
    pub(super) fn new(
        gateway: Arc<Gateway>,
        runtime: Handle,
        metrics: InterfaceMetrics,
        settings: &MqttSettings,
        fast_stops: Arc<MqttFastStops>,
    ) -> Self {
        Self {
            gateway,
            runtime,
            metrics,
            topics: settings.topics.clone(),
            role: settings.rules.role,
            fast_stops,
            slots: Arc::new(Semaphore::new(MAX_REQUESTS)),
            stop_slots: Arc::new(Semaphore::new(MAX_STOPS)),
        }
    }

    fn parse(&self, message: &Publish) -> Result<ParsedRequest, Problem> {
        let topic = std::str::from_utf8(&message.topic).unwrap_or_default();
        let topic = self.topics.request(topic).ok_or_else(|| Problem::not_found("such topic"))?;
        let found = offered_for(topic.gripper.is_some()).find(|operation| operation.name == topic.name);
        let Some(operation) = found else { return Err(no_such_request(topic.name, topic.gripper.is_some())) };
        let method = Method::from(operation);
        if message.payload.len() > MAX_BODY_BYTES {
            let bytes = message.payload.len();
            let detail = format!("the payload has {bytes} bytes; at most {MAX_BODY_BYTES} are allowed");
            return Err(Problem::new(Code::TooLarge, detail));
        }
        let mut params = match json::object(&message.payload) {
            Ok(params) => params,
            // A mistake must not keep fingers moving.
            Err(_) if method.shared().ignores_mistakes => Map::new(),
            Err(problem) => return Err(problem),
        };
        if let Some(gripper) = topic.gripper {
            let other = params.insert(GRIPPER.to_owned(), gripper.into());
            if other.is_some_and(|other| !other.is_null() && other != gripper) {
                return Err(Problem::malformed(GRIPPER, "gripper differs from the gripper in the topic"));
            }
        }
        Ok(ParsedRequest { method, params, caller: self.caller(message) })
    }

    fn caller(&self, message: &Publish) -> Caller {
        let lease = property(message, "lease").map(|given| text::<MAX_LEASE_BYTES>("lease", &given)).transpose();
        let request_id = property(message, "request_id").map(|given| text("request_id", &given)).transpose();
        Caller {
            client: client(message),
            identity: Ok(Identity { role: self.role, ..Identity::anyone() }),
            lease: lease.map(|lease| lease.map(|lease| lease.as_str().into())),
            request_id,
            // Only the broker notices the loss of a client.
            presence: Presence::Unseen,
            wait: Wait::Ms { given: property(message, "wait_ms"), limiter: None },
        }
    }

    async fn run(&self, request: ParsedRequest) -> Result<OperationReply, Problem> {
        let ParsedRequest { method, params, caller } = request;
        let result = operations::call(&self.gateway, caller, method, Value::Object(params)).await;
        self.metrics.answered(Some(method.name()), "PUBLISH", MqttReply::of(&result).status);
        result
    }

    /// Answers a request that was refused before it was run, and records the refusal.
    async fn refuse(&self, client: Client, topic: &str, problem: &Problem) {
        self.metrics.answered(None, "PUBLISH", problem.status().as_u16());
        let topic = self.topics.request(topic);
        let gripper = topic.as_ref().and_then(|topic| topic.gripper?.parse::<Name>().ok());
        let known = topic.and_then(|topic| Method::named(topic.name).ok());
        let Some(method) = known.filter(|method| method.shared().changes_something()) else { return };
        let command = method.shared().journal_command().to_owned();
        let request = RefusedRequest { gripper, client, command, code: problem.code_word() };
        self.gateway.audit.record(request, problem.detail(), Urgency::None).await;
    }

    fn start(self: &Arc<Self>, parsed: Result<ParsedRequest, Problem>, message: &Publish, reply_to: ReplyTo) {
        let urgency = parsed.as_ref().map_or(Urgency::None, |request| request.method.urgency());
        let slots = if urgency == Urgency::None { &self.slots } else { &self.stop_slots };
        let Ok(slot) = slots.clone().try_acquire_owned() else {
            let detail = format!("too many MQTT requests ({MAX_REQUESTS} in progress): wait for their answers");
            let problem = Problem::new(Code::Overloaded, detail);
            self.metrics.answered(None, "PUBLISH", problem.status().as_u16());
            return reply_to.send(&MqttReply::refusing(&problem), JSON);
        };
        let requests = self.clone();
        let client = client(message);
        let topic = String::from_utf8_lossy(&message.topic).into_owned();
        self.runtime.spawn(async move {
            let result = match parsed {
                Ok(request) => requests.run(request).await,
                Err(problem) => {
                    requests.refuse(client, &topic, &problem).await;
                    Err(problem)
                }
            };
            if let Err(problem) = &result {
                tracing::debug!(topic, detail = problem.detail(), "MQTT request refused");
            }
            reply_to.send(&MqttReply::of(&result), JSON);
            drop(slot);
        });
    }
}

impl Receive for Requests {
    fn receive(self: &Arc<Self>, message: Publish, outgoing: &OutgoingPackets) {
        if message.retain && message.payload.is_empty() {
            // A retained message was deleted.
            return;
        }
        let reply_to = ReplyTo::of(&message, &self.topics, outgoing);
        if message.retain {
            tracing::warn!(
                topic = %String::from_utf8_lossy(&message.topic),
                "MQTT message refused: it is retained; delete it from the broker"
            );
            return self.start(Err(retained()), &message, reply_to);
        }
        let topic = String::from_utf8_lossy(&message.topic);
        match self.topics.request(&topic) {
            // A FAST STOP among the commands stops, whatever else is wrong with it.
            Some(topic) if topic.name == FAST_STOP => self.fast_stops.begin(&message, outgoing),
            _ => self.start(self.parse(&message), &message, reply_to),
        }
    }
}

/// Operations that MQTT clients can request.
pub(super) fn offered() -> impl Iterator<Item = &'static operations::Operation> + Clone {
    all().filter(|operation| !operation.name.starts_with(LEASE))
}

/// Operations that MQTT clients can request of a gripper, or of the gateway itself.
fn offered_for(gripper: bool) -> impl Iterator<Item = &'static operations::Operation> + Clone {
    offered().filter(move |operation| operation.is_of_gripper() == gripper)
}

fn no_such_request(name: &str, of_gripper: bool) -> Problem {
    if name.starts_with(LEASE) {
        let detail = "leases cannot be taken over MQTT, because only the broker notices the loss of a client: take the \
                      lease over another interface";
        return Problem::new(Code::MethodNotAllowed, detail);
    }
    let suggestion = did_you_mean(name, offered_for(of_gripper).map(|operation| operation.name));
    Problem::not_found(format!("such command{suggestion}; the guide mqtt.md lists all topics"))
}
