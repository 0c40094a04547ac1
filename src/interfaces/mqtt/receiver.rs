//! A connection that receives messages. Reading never waits for writing: answers that a broker does not take are
//! bounded, and then end the connection.

use std::sync::Arc;
use std::time::Instant;

use futures_util::StreamExt as _;
use futures_util::stream::{SplitSink, SplitStream};
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{
    Filter, Packet, PingReq, PubAck, Publish, RetainForwardRule, Subscribe, SubscribeReasonCode,
};
use tokio::sync::mpsc;
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;

use super::connection::{BrokerConnection, BrokerStream, ConnectionPurpose, LOST_AFTER, PINGED_EVERY, received, send};
use super::failure::MqttFailure;
use super::status::MqttStatus;
use super::supervision::Serve;
use crate::connections::metrics::InterfaceMetrics;
use crate::gripper::Now;

/// Messages that wait to be written.
const MAX_OUTGOING: usize = 2048;

/// Places among them that answers leave to acknowledgements, of which a broker waits for fewer.
const ACKNOWLEDGEMENTS: usize = 1024;

/// Messages that are taken before acknowledgements and answers are written. The packets of a read do not end a turn.
const TAKEN_IN_A_ROW: usize = 64;

/// Packet id of the subscription, which is the first message of its connection.
const SUBSCRIPTION_ID: u16 = 1;

/// Takes the messages of a connection. It must not wait.
pub(super) trait Receive: Send + Sync + 'static {
    fn receive(self: &Arc<Self>, message: Publish, outgoing: &OutgoingPackets);
}

/// Topics that a receiver subscribes to.
#[derive(Debug, Clone)]
pub(super) struct TopicSubscription {
    pub(super) topics: Vec<String>,
    /// Whether a message that was published as a retained one says so, also if it is not an old one.
    pub(super) shows_retained: bool,
}

/// Messages that are sent over a receiver's connection.
#[derive(Debug, Clone)]
pub(super) struct OutgoingPackets(mpsc::Sender<Packet>);

impl OutgoingPackets {
    /// Sends a message, unless too many wait.
    fn send(&self, packet: Packet) -> Result<(), MqttFailure> {
        self.0.try_send(packet).map_err(|_| MqttFailure::Flooded)
    }

    /// Sends an answer, unless it would take the place of an acknowledgement. Returns whether it is sent.
    pub(super) fn answer(&self, answer: Publish) -> bool {
        self.0.capacity() > ACKNOWLEDGEMENTS && self.0.try_send(Packet::Publish(answer)).is_ok()
    }

    #[cfg(test)]
    pub(super) fn channel() -> (Self, mpsc::Receiver<Packet>) {
        let (outgoing, queue) = mpsc::channel(MAX_OUTGOING);
        (Self(outgoing), queue)
    }
}

pub(super) struct MqttReceiver<R> {
    pub(super) purpose: ConnectionPurpose,
    pub(super) subscription: TopicSubscription,
    pub(super) receive: Arc<R>,
    pub(super) status: Arc<MqttStatus>,
    pub(super) metrics: InterfaceMetrics,
    pub(super) ending: CancellationToken,
}

impl<R: Receive> Serve for MqttReceiver<R> {
    fn purpose(&self) -> ConnectionPurpose {
        self.purpose
    }

    async fn serve(&mut self, connection: BrokerConnection) -> Result<(), MqttFailure> {
        let _connected = self.metrics.connected();
        let (sink, stream) = connection.stream.split();
        let (outgoing, queue) = mpsc::channel(MAX_OUTGOING);
        let outgoing = OutgoingPackets(outgoing);
        outgoing.send(self.subscribe())?;
        tokio::select! {
            result = self.read(stream, &outgoing) => result,
            result = write(sink, queue) => result,
            // A connection that ends needs no farewell: it has neither a session nor a last will.
            () = self.ending.cancelled() => Ok(()),
        }
    }
}

impl<R: Receive> MqttReceiver<R> {
    fn subscribe(&self) -> Packet {
        let mut filters = Vec::new();
        for topic in &self.subscription.topics {
            filters.push(Filter {
                preserve_retain: self.subscription.shows_retained,
                retain_forward_rule: RetainForwardRule::OnEverySubscribe,
                ..Filter::new(topic, QoS::AtLeastOnce)
            });
        }
        Packet::Subscribe(Subscribe { pkid: SUBSCRIPTION_ID, filters, properties: None })
    }

    async fn read(&self, mut stream: SplitStream<BrokerStream>, outgoing: &OutgoingPackets) -> Result<(), MqttFailure> {
        let mut heard_at = Now::read().instant;
        let mut in_a_row = 0;
        let mut pings = interval(PINGED_EVERY);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            tokio::select! {
                biased;
                packet = stream.next() => {
                    heard_at = Now::read().instant;
                    self.take(received(packet)?, outgoing)?;
                    in_a_row += 1;
                    if in_a_row == TAKEN_IN_A_ROW {
                        in_a_row = 0;
                        tokio::task::yield_now().await;
                    }
                }
                _ = pings.tick() => {
                    check(heard_at)?;
                    outgoing.send(Packet::PingReq(PingReq))?;
                }
            }
        }
    }

    fn take(&self, packet: Packet, outgoing: &OutgoingPackets) -> Result<(), MqttFailure> {
        match packet {
            Packet::Publish(message) => {
                let packet_id = (message.qos == QoS::AtLeastOnce).then_some(message.pkid);
                // The message is taken before it is acknowledged, so that the broker repeats one that was not.
                self.receive.receive(message, outgoing);
                packet_id.map_or(Ok(()), |id| outgoing.send(Packet::PubAck(PubAck::new(id, None))))
            }
            Packet::SubAck(answer) => {
                for (topic, reason) in self.subscription.topics.iter().zip(answer.return_codes) {
                    if !matches!(reason, SubscribeReasonCode::Success(_)) {
                        return Err(MqttFailure::SubscriptionRefused { topic: topic.clone(), reason });
                    }
                }
                self.status.connected(self.purpose);
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

fn check(heard_at: Instant) -> Result<(), MqttFailure> {
    let is_silent = Now::read().instant.saturating_duration_since(heard_at) > LOST_AFTER;
    if is_silent { Err(MqttFailure::Silent(LOST_AFTER)) } else { Ok(()) }
}

async fn write(
    mut sink: SplitSink<BrokerStream, Packet>,
    mut queue: mpsc::Receiver<Packet>,
) -> Result<(), MqttFailure> {
    while let Some(packet) = queue.recv().await {
        send(&mut sink, packet).await?;
    }
    Ok(())
}
