//! FAST STOP over MQTT, on a connection of its own. Any payload stops, whoever holds the lease, and with motions off.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bytes::Bytes;
use rumqttc::v5::mqttbytes::v5::Publish;
use serde::Deserialize;
use serde_json::{Map, Value};
use tokio::runtime::Handle;

use super::message::{MqttReply, ReplyTo, client};
use super::mqtt_settings::MqttSettings;
use super::publisher::JSON;
use super::receiver::{OutgoingPackets, Receive};
use super::topics::{FAST_STOP, Topics};
use crate::access::{Identity, Role};
use crate::connections::metrics::InterfaceMetrics;
use crate::gripper::Grippers;
use crate::model::{Client, FastStopId, Name, without_byte_order_mark};
use crate::operations::gripper::fast_stop;
use crate::operations::parameters::json;
use crate::operations::{self, Caller, Gateway, Method, Problem};

/// Maximum number of concurrent FAST STOPs of a gripper, and of all grippers, each of which ends within 250 ms. Beyond
/// it only the newest is kept, which starts when one has ended: the gripper is already being stopped.
const MAX_UNDER_WAY: usize = 16;

/// FAST STOPs that are remembered to recognise repetitions.
const MAX_REMEMBERED: usize = 64;

/// Bytes of a payload that are searched for a reason.
const MAX_REASON_BYTES: usize = 1024;

/// Field that names the gripper.
const GRIPPER: &str = "gripper";

/// The FAST STOPs of MQTT clients.
pub(super) struct MqttFastStops {
    gateway: Arc<Gateway>,
    runtime: Handle,
    metrics: InterfaceMetrics,
    topics: Topics,
    role: Role,
    lanes: Mutex<Lanes>,
}

#[derive(Default)]
struct Lanes {
    under_way: BTreeMap<StopTarget, UnderWay>,
    /// Newest last.
    remembered: VecDeque<Remembered>,
}

#[derive(Default)]
struct UnderWay {
    count: usize,
    next: Option<FastStopRequest>,
}

/// The grippers that a FAST STOP stops.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
enum StopTarget {
    All,
    Gripper(Name),
}

struct FastStopRequest {
    target: StopTarget,
    reason: Value,
    client: Client,
    reply_to: ReplyTo,
}

/// A FAST STOP that can be repeated: its target, its correlation data, and its result.
struct Remembered {
    target: StopTarget,
    correlation: Bytes,
    /// `None` while it is under way.
    done: Option<(FastStopId, MqttReply)>,
}

/// What is known of a FAST STOP that may be a repetition.
enum Repetition {
    New,
    UnderWay,
    /// Its own latch is still there.
    Latched(MqttReply),
}

impl MqttFastStops {
    pub(super) fn new(
        gateway: Arc<Gateway>,
        runtime: Handle,
        metrics: InterfaceMetrics,
        settings: &MqttSettings,
    ) -> Self {
        let topics = settings.topics.clone();
        Self { gateway, runtime, metrics, topics, role: settings.rules.role, lanes: Mutex::default() }
    }

    /// Begins a FAST STOP without waiting.
    pub(super) fn begin(self: &Arc<Self>, message: &Publish, outgoing: &OutgoingPackets) {
        let topic = String::from_utf8_lossy(&message.topic);
        let named = self.topics.request(&topic).and_then(|topic| topic.gripper?.parse::<Name>().ok());
        // Without a gripper of this name, all are stopped: the intended one is among them.
        let known = named.filter(|name| self.gateway.grippers.get(name).is_some());
        let request = FastStopRequest {
            target: known.map_or(StopTarget::All, StopTarget::Gripper),
            reason: reason(&message.payload),
            client: client(message),
            reply_to: ReplyTo::of(message, &self.topics, outgoing),
        };
        let mut lanes = self.lock();
        match lanes.repetition(&request, &self.gateway.grippers) {
            Repetition::UnderWay => return,
            Repetition::Latched(reply) => return request.reply_to.send(&reply, JSON),
            Repetition::New => {}
        }
        let lane = lanes.under_way.entry(request.target.clone()).or_default();
        if lane.count >= MAX_UNDER_WAY {
            lane.next = Some(request);
            return;
        }
        lane.count += 1;
        lanes.remember(&request);
        drop(lanes);
        let stops = self.clone();
        self.runtime.spawn(async move {
            let mut next = Some(request);
            while let Some(request) = next {
                let target = request.target.clone();
                stops.run(request).await;
                next = stops.ended(&target);
            }
        });
    }

    async fn run(&self, request: FastStopRequest) {
        let FastStopRequest { target, reason, client, reply_to } = request;
        let identity = Identity { role: self.role, ..Identity::anyone() };
        let caller = Caller::new(client, Ok(identity));
        let mut params = Map::from_iter([("reason".to_owned(), reason)]);
        params.extend(target.gripper().map(|name| (GRIPPER.to_owned(), name.as_str().into())));
        let result =
            operations::call(&self.gateway, caller, Method::from(&fast_stop::ALL), Value::Object(params)).await;
        let reply = MqttReply::of(&result);
        self.metrics.answered(Some(FAST_STOP), "PUBLISH", reply.status);
        tracing::info!(gripper = target.gripper().map_or("all", Name::as_str), "FAST STOP via MQTT");
        reply_to.send(&reply, JSON);
        if let Some(correlation) = reply_to.correlation {
            self.lock().note(&target, &correlation, &reply);
        }
    }

    /// Returns the FAST STOP that the calling task runs next; `None` ends the task.
    fn ended(&self, target: &StopTarget) -> Option<FastStopRequest> {
        let mut lanes = self.lock();
        let lane = lanes.under_way.get_mut(target)?;
        let next = lane.next.take();
        if next.is_none() {
            lane.count -= 1;
        }
        next
    }

    /// Refuses a FAST STOP that the broker has kept. It would stop at each new connection.
    fn refuse_retained(&self, message: &Publish, outgoing: &OutgoingPackets) {
        let problem = retained();
        self.metrics.answered(Some(FAST_STOP), "PUBLISH", problem.status().as_u16());
        tracing::warn!(
            topic = %String::from_utf8_lossy(&message.topic),
            "MQTT message refused: it is retained; delete it from the broker"
        );
        ReplyTo::of(message, &self.topics, outgoing).send(&MqttReply::refusing(&problem), JSON);
    }

    fn lock(&self) -> MutexGuard<'_, Lanes> {
        self.lanes.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Receive for MqttFastStops {
    fn receive(self: &Arc<Self>, message: Publish, outgoing: &OutgoingPackets) {
        match (message.retain, message.payload.is_empty()) {
            (false, _) => self.begin(&message, outgoing),
            (true, false) => self.refuse_retained(&message, outgoing),
            // A retained message was deleted.
            (true, true) => {}
        }
    }
}

impl Lanes {
    /// Whether a request repeats an earlier one: it has its gripper and its correlation data, and the FAST STOP of that
    /// one is still there. If it was acknowledged meanwhile, the request stops again, since that is the safer mistake.
    fn repetition(&mut self, request: &FastStopRequest, grippers: &Grippers) -> Repetition {
        let Some(correlation) = &request.reply_to.correlation else { return Repetition::New };
        let found = self.remembered.iter().position(|known| known.is(&request.target, correlation));
        let Some(known) = found.and_then(|index| self.remembered.get(index)) else { return Repetition::New };
        match &known.done {
            None => Repetition::UnderWay,
            Some((id, reply)) if is_latched(grippers, request.target.gripper(), *id) => {
                Repetition::Latched(reply.clone())
            }
            Some(_) => {
                self.remembered.retain(|known| !known.is(&request.target, correlation));
                Repetition::New
            }
        }
    }

    fn remember(&mut self, request: &FastStopRequest) {
        let Some(correlation) = request.reply_to.correlation.clone() else { return };
        if self.remembered.len() >= MAX_REMEMBERED {
            self.remembered.pop_front();
        }
        self.remembered.push_back(Remembered { target: request.target.clone(), correlation, done: None });
    }

    fn note(&mut self, target: &StopTarget, correlation: &Bytes, reply: &MqttReply) {
        #[derive(Deserialize)]
        struct Parts {
            fast_stop_id: FastStopId,
        }
        let Some(index) = self.remembered.iter().position(|known| known.is(target, correlation)) else { return };
        match serde_json::from_str::<Parts>(&reply.body) {
            Ok(Parts { fast_stop_id }) => {
                if let Some(known) = self.remembered.get_mut(index) {
                    known.done = Some((fast_stop_id, reply.clone()));
                }
            }
            // It was refused, so a repetition is a new attempt.
            Err(_) => drop(self.remembered.remove(index)),
        }
    }
}

impl StopTarget {
    fn gripper(&self) -> Option<&Name> {
        match self {
            Self::All => None,
            Self::Gripper(name) => Some(name),
        }
    }
}

impl Remembered {
    fn is(&self, target: &StopTarget, correlation: &Bytes) -> bool {
        self.target == *target && self.correlation == *correlation
    }
}

/// Whether the FAST STOP with this id is latched at the gripper, or at all grippers.
fn is_latched(grippers: &Grippers, gripper: Option<&Name>, id: FastStopId) -> bool {
    let handles = grippers.all();
    let mut meant = handles.iter().filter(|handle| gripper.is_none_or(|name| name == handle.name()));
    meant.all(|handle| handle.state().latch.as_ref().is_some_and(|latch| latch.fast_stop_id == id))
}

/// Returns the reason in a payload: that of an object, or plain text.
fn reason(payload: &[u8]) -> Value {
    let payload = without_byte_order_mark(payload.get(..MAX_REASON_BYTES).unwrap_or(payload));
    match json::object(payload) {
        Ok(mut body) => body.remove("reason").unwrap_or_default(),
        Err(_) => String::from_utf8_lossy(payload).into(),
    }
}

/// Returns the problem of a retained request.
pub(super) fn retained() -> Problem {
    let detail = "a retained request is refused, because the broker would repeat it at each new connection: publish it \
                  without retain, and delete the retained one by an empty retained message";
    Problem::malformed("retain", detail)
}

#[cfg(test)]
mod tests {
    use prometheus::Registry;
    use rumqttc::v5::mqttbytes::QoS;
    use rumqttc::v5::mqttbytes::v5::{Packet, PublishProperties};
    use serde_json::json;
    use tokio::sync::mpsc;

    use super::super::mqtt_settings::{Broker, MqttRules};
    use super::*;
    use crate::gripper::fake::{self, FakeScript, Seen};

    fn stops(gateway: &Arc<Gateway>) -> Arc<MqttFastStops> {
        let settings = MqttSettings {
            broker: Broker { host: "localhost".to_owned(), port: 1, tls: None },
            client_id: "wsg".to_owned(),
            topics: "cell".parse().unwrap(),
            login: None,
            rules: MqttRules { role: Role::Stop, ..MqttRules::default() },
        };
        let metrics = InterfaceMetrics::register(&Registry::new(), "mqtt").unwrap();
        Arc::new(MqttFastStops::new(gateway.clone(), Handle::current(), metrics, &settings))
    }

    fn message(topic: &str, payload: &str, correlation: Option<&str>) -> Publish {
        let properties = PublishProperties {
            response_topic: Some("answers".to_owned()),
            correlation_data: correlation.map(|data| Bytes::copy_from_slice(data.as_bytes())),
            ..PublishProperties::default()
        };
        Publish::new(topic, QoS::AtLeastOnce, payload.to_owned(), Some(properties))
    }

    async fn answer(queue: &mut mpsc::Receiver<Packet>) -> Value {
        let Some(Packet::Publish(answer)) = queue.recv().await else { panic!("no answer") };
        serde_json::from_slice(&answer.payload).unwrap()
    }

    async fn next_reason(seen: &mut mpsc::UnboundedReceiver<Seen>) -> String {
        loop {
            if let Seen::FastStop(reason) = seen.recv().await.unwrap() {
                return reason.as_str().to_owned();
            }
        }
    }

    #[test]
    fn any_payload_gives_a_reason() {
        for (payload, expected) in [
            (&br#"{"reason": "light curtain"}"#[..], json!("light curtain")),
            (b"light curtain", json!("light curtain")),
            (b"", Value::Null),
            (br#"{"reason": 7}"#, json!(7)),
            (b"\xFF", json!("\u{FFFD}")),
        ] {
            assert_eq!(reason(payload), expected);
        }
        assert_eq!(reason(&[b'x'; 5000]).as_str().unwrap().len(), MAX_REASON_BYTES);
    }

    #[tokio::test]
    async fn unknown_gripper_stops_all_and_a_retained_message_none() {
        let (left, mut seen) = fake::gripper("left", FakeScript::default());
        let gateway = Gateway::of([left]);
        let stops = stops(&gateway);
        let (outgoing, mut queue) = OutgoingPackets::channel();
        let retained = Publish { retain: true, ..message("cell/fast-stop", "old", None) };
        stops.receive(retained, &outgoing);
        assert_eq!(answer(&mut queue).await["field"], "retain");
        stops.receive(message("cell/lefft/fast-stop", "light curtain", None), &outgoing);
        assert_eq!(next_reason(&mut seen).await, "light curtain");
    }

    #[tokio::test]
    async fn newest_fast_stop_beyond_the_limit_runs() {
        let (left, mut seen) = fake::gripper("left", FakeScript::default());
        let gateway = Gateway::of([left]);
        let stops = stops(&gateway);
        let (outgoing, _queue) = OutgoingPackets::channel();
        for index in 0..=2 * MAX_UNDER_WAY {
            stops.receive(message("cell/left/fast-stop", &format!("r{index}"), None), &outgoing);
        }
        let mut count = 1;
        while next_reason(&mut seen).await != format!("r{}", 2 * MAX_UNDER_WAY) {
            count += 1;
        }
        assert_eq!(count, MAX_UNDER_WAY + 1);
    }
}
