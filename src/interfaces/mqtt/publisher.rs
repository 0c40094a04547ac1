//! The connection that publishes: states and alarms as they are now, and the journal's records in their order.

use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use futures_util::StreamExt as _;
use rumqttc::v5::mqttbytes::QoS;
use rumqttc::v5::mqttbytes::v5::{Packet, PingReq, Publish, PublishProperties};
use tokio::time::{Interval, MissedTickBehavior, interval, timeout};
use tokio_util::sync::CancellationToken;

use super::connection::{AVAILABILITY, BrokerConnection, ConnectionPurpose, LOST_AFTER, OFFLINE, ONLINE, PINGED_EVERY};
use super::connection::{received, send};
use super::failure::MqttFailure;
use super::live::{Live, LiveMessage};
use super::mqtt_settings::MqttSettings;
use super::position::{Position, PublishedList, PublishedProgress, StoredPosition};
use super::records::{JournalRecord, PublishedLists, RecordError, Records};
use super::status::MqttStatus;
use super::supervision::{Serve, keep_serving};
use super::window::Window;
use crate::gripper::Now;
use crate::gripper::recorder::{Record, Recorder as _};
use crate::model::clock::sleep_until;
use crate::model::{PersistedKey, PersistedState};
use crate::operations::Gateway;

/// Interval at which alarms and the description are compared, and the position is stored.
const CHECKED_EVERY: Duration = Duration::from_secs(1);

/// Pause after the journal could not be read.
const READ_RETRY_PAUSE: Duration = Duration::from_secs(1);

/// Time limit for the broker to acknowledge the last messages.
const FAREWELL_WITHIN: Duration = Duration::from_secs(1);

/// Time for which unused permission to publish records is kept, so that a burst of records has no delay.
const BURST: Duration = Duration::from_millis(200);

/// Version of the payloads' schemas: that of the HTTP API.
const SCHEMA_VERSION: &str = "v1";

/// Content type of the payloads (RFC 8259).
pub(super) const JSON: &str = "application/json";

pub(super) struct Publisher {
    gateway: Arc<Gateway>,
    settings: Arc<MqttSettings>,
    status: Arc<MqttStatus>,
    ending: CancellationToken,
    live: Live,
    progress: PublishedProgress,
    /// Position that was stored last; `None` if none was stored yet.
    stored: Option<StoredPosition>,
}

/// One connection with its messages under way.
struct Link {
    connection: BrokerConnection,
    window: Window,
    heard_at: Instant,
    is_confirmed: bool,
}

/// The rate of records.
struct RecordPace {
    step: Duration,
    ready_at: Instant,
}

impl RecordPace {
    fn new(per_second: u32, now: Instant) -> Self {
        Self { step: Duration::from_secs(1) / per_second.max(1), ready_at: now }
    }

    fn note(&mut self, now: Instant) {
        let earliest = now.checked_sub(BURST).unwrap_or(now);
        self.ready_at = self.ready_at.max(earliest) + self.step;
    }
}

impl Publisher {
    /// Continues after the stored position, or after `newest` if there is none.
    pub(super) fn new(
        gateway: Arc<Gateway>,
        settings: Arc<MqttSettings>,
        status: Arc<MqttStatus>,
        ending: CancellationToken,
        stored: Option<StoredPosition>,
        newest: Position,
    ) -> Self {
        let live = Live::new(settings.topics.clone(), gateway.clone());
        let position = stored.unwrap_or_default().or(newest);
        let progress = PublishedProgress::at(position);
        let mut publisher = Self { gateway, settings, status, ending, live, progress, stored };
        // Without a stored position, a restart before the first record would skip the records until then.
        publisher.store(position);
        publisher
    }

    /// Publishes until MQTT ends. Returns the position at which a successor continues.
    pub(super) async fn run(mut self) -> Option<StoredPosition> {
        let settings = self.settings.clone();
        let status = self.status.clone();
        let ending = self.ending.clone();
        keep_serving(&mut self, &settings, &status, &ending).await;
        self.stored
    }

    fn lists(&self) -> PublishedLists {
        PublishedLists { events: self.settings.rules.events, grips: self.settings.rules.grips }
    }

    async fn publish_all(&mut self, connection: BrokerConnection) -> Result<(), MqttFailure> {
        let begin = Now::read().instant;
        let mut link = Link::new(connection, begin);
        let position = self.progress.go_back();
        let mut records = Records::after(position, self.lists(), &self.gateway.journal, &self.gateway.name);
        self.live.begin();
        self.publish_availability(&mut link, ONLINE).await?;
        let rules = self.settings.rules.clone();
        let mut pace = RecordPace::new(rules.max_records_per_s, begin);
        let mut states = ticks(rules.state_interval);
        let mut telemetry = rules.telemetry_interval.map(ticks);
        let mut checks = ticks(CHECKED_EVERY);
        let mut pings = ticks(PINGED_EVERY);
        loop {
            let may_publish = link.window.has_room_for_record();
            tokio::select! {
                biased;
                () = self.ending.cancelled() => return self.say_farewell(link).await,
                packet = link.connection.stream.next() => self.take(&mut link, received(packet)?)?,
                _ = pings.tick() => link.ping().await?,
                _ = checks.tick() => self.check(&mut link).await?,
                _ = states.tick() => {
                    for state in self.live.states(Now::read().instant) {
                        self.publish(&mut link, state).await?;
                    }
                }
                () = tick(&mut telemetry) => {
                    for values in self.live.telemetry() {
                        self.publish(&mut link, values).await?;
                    }
                }
                record = next_record(&mut records, pace.ready_at), if may_publish => match record {
                    Ok(Some(record)) => {
                        pace.note(Now::read().instant);
                        self.publish_record(&mut link, record).await?;
                    }
                    Ok(None) => return self.say_farewell(link).await,
                    Err(error) => {
                        tracing::warn!(%error, "MQTT records could not be read; retrying");
                        pace.ready_at = Now::read().instant + READ_RETRY_PAUSE;
                    }
                },
            }
        }
    }

    /// Takes a packet of the broker.
    fn take(&mut self, link: &mut Link, packet: Packet) -> Result<(), MqttFailure> {
        link.heard_at = Now::read().instant;
        let Packet::PubAck(answer) = packet else { return Ok(()) };
        let before = self.progress.acknowledged;
        link.window.acknowledge(&answer, &mut self.progress.acknowledged)?;
        let after = self.progress.acknowledged;
        let records = (after.events - before.events).max(0) + (after.grips - before.grips).max(0);
        self.status.metrics.records.inc_by(records.unsigned_abs());
        if !link.is_confirmed {
            link.is_confirmed = true;
            self.status.connected(ConnectionPurpose::Publications);
        }
        Ok(())
    }

    async fn check(&mut self, link: &mut Link) -> Result<(), MqttFailure> {
        let now = Now::read().instant;
        link.window.check(now)?;
        let position = self.progress.settle(now);
        self.store(position);
        if link.window.has_room()
            && let Some(description) = self.live.description()
        {
            self.publish(link, description).await?;
        }
        if link.window.has_room()
            && let Some(alarms) = self.live.alarms()
        {
            self.publish(link, alarms).await?;
        }
        Ok(())
    }

    async fn publish_availability(&self, link: &mut Link, availability: &str) -> Result<(), MqttFailure> {
        let topic = self.settings.topics.own(AVAILABILITY);
        let mut message = Publish::new(&topic, QoS::AtLeastOnce, Bytes::copy_from_slice(availability.as_bytes()), None);
        message.retain = true;
        message.pkid = link.window.add(&topic, None, Now::read().instant);
        self.send(link, message).await
    }

    async fn publish(&self, link: &mut Link, message: LiveMessage) -> Result<(), MqttFailure> {
        let LiveMessage { topic, payload, qos, is_retained, schema } = message;
        // An empty payload deletes a retained message, and needs no properties.
        let properties = (!payload.is_empty()).then(|| properties(schema, Vec::new()));
        let mut publish = Publish::new(&topic, qos, payload, properties);
        publish.retain = is_retained;
        if qos != QoS::AtMostOnce {
            publish.pkid = link.window.add(&topic, None, Now::read().instant);
        }
        self.send(link, publish).await
    }

    async fn publish_record(&self, link: &mut Link, record: JournalRecord) -> Result<(), MqttFailure> {
        let JournalRecord { chain, gripper, seq, body, step } = record;
        let journal_id = self.gateway.journal.id().to_string();
        let (list, schema) = match chain {
            PublishedList::Events => ("events", "StoredEvent"),
            PublishedList::Grips => ("grips", "StoredGripRecord"),
        };
        let topic = self.settings.topics.of(gripper.as_ref(), list);
        let payload = with_journal_id(&body, &journal_id);
        let identity = vec![("journal_id".to_owned(), journal_id), ("seq".to_owned(), seq.to_string())];
        let mut publish = Publish::new(&topic, QoS::AtLeastOnce, payload, Some(properties(schema, identity)));
        publish.pkid = link.window.add(&topic, step, Now::read().instant);
        self.send(link, publish).await
    }

    async fn send(&self, link: &mut Link, publish: Publish) -> Result<(), MqttFailure> {
        self.status.metrics.messages.inc();
        send(&mut link.connection.stream, Packet::Publish(publish)).await
    }

    /// Publishes that the gateway ends, and waits for the broker's acknowledgements.
    async fn say_farewell(&mut self, mut link: Link) -> Result<(), MqttFailure> {
        let result = timeout(FAREWELL_WITHIN, self.end(&mut link)).await;
        let position = if matches!(result, Ok(Ok(()))) { self.progress.end() } else { self.progress.go_back() };
        self.store(position);
        // The broker is told as far as possible.
        let _ = timeout(FAREWELL_WITHIN, link.connection.close()).await;
        Ok(())
    }

    async fn end(&mut self, link: &mut Link) -> Result<(), MqttFailure> {
        for state in self.live.unknown_states() {
            self.publish(link, state).await?;
        }
        while !link.window.has_room() {
            let packet = link.connection.stream.next().await;
            self.take(link, received(packet)?)?;
        }
        self.publish_availability(link, OFFLINE).await?;
        while !link.window.is_empty() {
            let packet = link.connection.stream.next().await;
            self.take(link, received(packet)?)?;
        }
        Ok(())
    }

    /// Passes a new position to the journal. A list that is not published has none, so that it begins with its newest
    /// records when it is switched on.
    fn store(&mut self, position: Position) {
        let PublishedLists { events, grips } = self.lists();
        let journal = &self.gateway.journal;
        self.status.metrics.at(if events { self.progress.acknowledged.events } else { journal.last_seq() });
        let position =
            StoredPosition { events: events.then_some(position.events), grips: grips.then_some(position.grips) };
        if self.stored == Some(position) {
            return;
        }
        self.stored = Some(position);
        let value = serde_json::to_string(&position);
        let value = value.inspect_err(|error| tracing::error!(%error, "MQTT position cannot be encoded as JSON")).ok();
        let state = PersistedState { gripper: self.gateway.name.clone(), key: PersistedKey::Mqtt, value };
        journal.record(Record::Persisted(state));
    }
}

impl Serve for Publisher {
    fn purpose(&self) -> ConnectionPurpose {
        ConnectionPurpose::Publications
    }

    async fn serve(&mut self, connection: BrokerConnection) -> Result<(), MqttFailure> {
        let result = self.publish_all(connection).await;
        let position = self.progress.go_back();
        self.store(position);
        result
    }
}

impl Link {
    fn new(connection: BrokerConnection, now: Instant) -> Self {
        let window = Window::new(connection.receive_maximum);
        Self { connection, window, heard_at: now, is_confirmed: false }
    }

    /// Sends a ping, unless the broker is silent.
    async fn ping(&mut self) -> Result<(), MqttFailure> {
        if Now::read().instant.saturating_duration_since(self.heard_at) > LOST_AFTER {
            return Err(MqttFailure::Silent(LOST_AFTER));
        }
        send(&mut self.connection.stream, Packet::PingReq(PingReq)).await
    }
}

/// Waits for the next record, but not before it may be published. Cancel-safe.
async fn next_record(records: &mut Records, ready_at: Instant) -> Result<Option<JournalRecord>, RecordError> {
    sleep_until(Some(ready_at)).await;
    records.next().await
}

/// Waits for the next tick, if there are any. Cancel-safe.
async fn tick(ticks: &mut Option<Interval>) {
    match ticks {
        Some(ticks) => drop(ticks.tick().await),
        None => std::future::pending().await,
    }
}

fn ticks(period: Duration) -> Interval {
    let mut ticks = interval(period);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    ticks
}

fn properties(schema: &str, identity: Vec<(String, String)>) -> PublishProperties {
    let mut user_properties =
        vec![("schema".to_owned(), schema.to_owned()), ("version".to_owned(), SCHEMA_VERSION.to_owned())];
    user_properties.extend(identity);
    PublishProperties { user_properties, content_type: Some(JSON.to_owned()), ..PublishProperties::default() }
}

/// Adds the journal's id to a record, whose JSON is an object with at least one member.
fn with_journal_id(body: &str, journal_id: &str) -> String {
    let members = body.strip_prefix('{').unwrap_or(body);
    format!("{{\"journal_id\":\"{journal_id}\",{members}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn record_names_its_journal() {
        let made = with_journal_id(r#"{"seq":7}"#, "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f");
        let parsed: serde_json::Value = serde_json::from_str(&made).unwrap();
        assert_eq!(parsed, serde_json::json!({"journal_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "seq": 7}));
    }

    #[test]
    fn records_keep_their_rate_after_a_short_burst() {
        let first = Instant::now();
        let begin = first + Duration::from_secs(10);
        let mut pace = RecordPace::new(100, first);
        let mut count = 0;
        while pace.ready_at <= begin {
            pace.note(begin);
            count += 1;
        }
        assert_eq!(count, 21);
    }
}
