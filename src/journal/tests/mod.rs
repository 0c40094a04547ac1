//! Tests of the journal as a gateway uses it, and their helpers.

mod damage;
mod disk;
mod following;
mod identity;
mod keeping;
mod losing;
mod pages;
mod pruning;
mod recovering;
mod restoring;
mod statistics;
mod versions;

use std::path::PathBuf;
use std::sync::Arc;

use jiff::Timestamp;
use tokio::sync::oneshot;

use super::*;
use crate::model::{
    Admitted, CommandEvent, CommandId, Detail, Done, Door, Event, GatewayEvent, GripRecord, IdSource, Kind, Link,
    LinkEvent, Name, Outcome, Parameters, PartId, PersistedKey, PersistedState, RequestId, RequestedValues, Sample,
};

/// Temporary directory of one test.
pub(super) struct Directory(PathBuf);

impl Directory {
    pub(super) fn new() -> Self {
        let path = std::env::temp_dir().join(format!("wsg-journal-{}", uuid::Uuid::now_v7()));
        std::fs::create_dir(&path).unwrap();
        Self(path)
    }

    pub(super) fn journal(&self) -> PathBuf {
        self.0.join("journal.db")
    }

    pub(super) fn place(&self) -> JournalLocation {
        JournalLocation::File(self.journal())
    }

    pub(super) fn open(&self) -> (Journal, Recovered) {
        Journal::open(self.place(), Retention::default()).unwrap()
    }
}

impl Drop for Directory {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap();
    }
}

pub(super) fn at(milliseconds: i64) -> Timestamp {
    Timestamp::from_millisecond(milliseconds).unwrap()
}

pub(super) fn name(text: &str) -> Name {
    text.parse().unwrap()
}

/// Returns the id of the command with this number.
pub(super) fn id(number: u32) -> CommandId {
    IdSource::new(number.into()).command_id(at(number.into()))
}

/// Makes a client's event of a command.
fn asked(time: i64, gripper: &str, number: u32, event: CommandEvent) -> Event {
    Event {
        subject: Some("http:127.0.0.1".into()),
        door: Some(Door::Http),
        ..Event::new(at(time), Some(name(gripper)), Detail::Command(event))
    }
    .of(id(number))
}

pub(super) fn admitted(time: i64, gripper: &str, number: u32, part_id: Option<&str>) -> Event {
    let parameters =
        Parameters { width_mm: Some(20.5), part_id: part_id.and_then(PartId::new), ..Parameters::default() };
    let request_id = RequestId::new(&format!("request-{number}"));
    asked(
        time,
        gripper,
        number,
        CommandEvent::Admitted(Box::new(Admitted { command: Kind::Grip, holder: None, request_id, parameters })),
    )
}

pub(super) fn done(time: i64, gripper: &str, number: u32, part_id: Option<&str>, outcome: Outcome) -> Event {
    let done = Done {
        command: Kind::Grip,
        outcome,
        status: Some("E_SUCCESS".to_owned()),
        status_code: Some(0),
        reached_goal: Some(true),
        stalled: Some(true),
        width_mm: Some(20.1),
        force_n: Some(40.0),
        contact_width_mm: None,
        started_at: at(time),
        duration_ms: Some(412),
        fast_stop_id: None,
        cancelled_by: None,
        part_id: part_id.and_then(PartId::new),
        code: None,
        cause: None,
        requested: RequestedValues::default(),
    };
    asked(time, gripper, number, CommandEvent::Done(Box::new(done)))
}

pub(super) fn link(time: i64, gripper: &str) -> Event {
    let event = LinkEvent { link: Link::Connected, link_cause: None };
    Event::new(at(time), Some(name(gripper)), Detail::Link(event))
}

pub(super) fn started(time: i64) -> Event {
    let event = GatewayEvent::Started { version: "1.0.0", gateway: "gateway".to_owned() };
    Event::new(at(time), None, Detail::Gateway(event))
}

pub(crate) fn grip(time: i64, gripper: &str, number: u32, part_id: Option<&str>) -> GripRecord {
    let sample =
        |i: u32| Sample { t_ms: i * 10, width_mm: 60.0 - i as f32 * 0.4, speed_mm_s: -40.0, force_n: 0.25 * i as f32 };
    let curve: Vec<_> = (0..20).map(sample).collect();
    GripRecord {
        id: id(number),
        gateway: name("gateway"),
        gripper: name(gripper),
        serial_number: Some(4711),
        kind: Kind::Grip,
        part_id: part_id.and_then(PartId::new),
        outcome: Outcome::PartHeld,
        code: None,
        detail: None,
        subject: "http:127.0.0.1".into(),
        requested: RequestedValues::default(),
        started_at: at(time),
        duration_ms: Some(412),
        width_mm: Some(20.1),
        force_n: Some(40.0),
        peak_force_n: Some(41.5),
        travel_mm: 7.6,
        contact_width_mm: Some(20.2),
        time_to_contact_ms: Some(300),
        measured_at: None,
        samples: curve.len(),
        curve,
    }
}

pub(super) fn memory(gripper: &str, key: PersistedKey, value: Option<&str>) -> PersistedState {
    PersistedState { gripper: name(gripper), key, value: value.map(str::to_owned) }
}

pub(super) fn record(journal: &Journal, event: Event) {
    journal.record(Record::Event(event, None));
}

/// Returns the next event of a stream.
async fn next_event(follow: &mut EventStream) -> Arc<Stored> {
    match follow.next().await.unwrap() {
        Some(StreamItem::Event(event)) => event,
        other => panic!("{other:?}"),
    }
}

/// Records an event and waits until it is durable; returns false if that fails.
pub(super) async fn kept(journal: &Journal, event: Event) -> bool {
    let (waiter, durable) = oneshot::channel();
    journal.record(Record::Event(event, Some(waiter)));
    durable.await.is_ok()
}

/// Records an event and waits until it is durable. While the disk is too slow for the records before, a waiter would be
/// dropped at once.
pub(super) async fn keep(journal: &Journal, event: Event) {
    journal.health().wait_for(|health| health.failure.is_none()).await.unwrap();
    assert!(kept(journal, event).await, "{:?}", journal.health().borrow().failure);
}

/// Reads all events, oldest first.
pub(super) async fn all(journal: &Journal) -> Vec<serde_json::Value> {
    let query = EventQuery { order: Order::Oldest, limit: Limit::new(1000).unwrap(), ..EventQuery::default() };
    journal.events(query).await.unwrap().bodies.iter().map(|body| serde_json::from_str(body).unwrap()).collect()
}

/// Returns the values of some fields of each event.
pub(super) fn fields(events: &[serde_json::Value], names: &[&str]) -> Vec<String> {
    let field = |event: &serde_json::Value, name: &str| {
        event.get(name).map(|value| value.as_str().map_or(value.to_string(), str::to_owned))
    };
    events
        .iter()
        .map(|event| names.iter().filter_map(|name| field(event, name)).collect::<Vec<_>>().join(" "))
        .collect()
}

#[tokio::test]
async fn records_are_served_as_they_were_written() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    keep(&journal, admitted(1_700_000_000_123, "left", 1, Some("P-1"))).await;
    journal.record(Record::Grip(Box::new(grip(1_700_000_000_123, "left", 1, Some("P-1")))));
    keep(&journal, done(1_700_000_000_500, "left", 1, Some("P-1"), Outcome::PartHeld)).await;
    assert_eq!(journal.last_seq(), 2);
    let page = journal.events(EventQuery::default()).await.unwrap();
    assert_eq!(
        &*page.bodies[1],
        format!(
            r#"{{"seq":1,"at":"2023-11-14T22:13:20.123Z","gripper":"left","subject":"http:127.0.0.1","door":"http","command_id":"{}","kind":"command","phase":"admitted","command":"grip","request_id":"request-1","width_mm":20.5,"part_id":"P-1"}}"#,
            id(1)
        )
    );
    let grip: serde_json::Value = serde_json::from_str(&journal.grip(id(1)).await.unwrap().unwrap()).unwrap();
    assert_eq!(
        (&grip["seq"], &grip["samples"], &grip["part_lost_at"]),
        (&1.into(), &20.into(), &serde_json::Value::Null)
    );
    assert_eq!(journal.curve(id(1)).await.unwrap().unwrap().len(), 20);
    assert_eq!(journal.curve(id(2)).await.unwrap(), None);
    let command = journal.command(name("left"), id(1)).await.unwrap().unwrap();
    assert_eq!(
        (command.outcome, command.width_mm, &*command.client),
        (Some(Outcome::PartHeld), Some(20.1), "http:127.0.0.1")
    );
    assert!(journal.command(name("right"), id(1)).await.unwrap().is_none());
    journal.close().await.unwrap();
}

#[tokio::test]
async fn part_lost_later_shows_in_its_grip() {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    journal.record(Record::Grip(Box::new(grip(1000, "left", 1, None))));
    let lost = crate::model::DeviceEvent::PartLost { width_mm: Some(3.0) };
    keep(&journal, Event::new(at(61_000), Some(name("left")), Detail::Device(lost)).of(id(1))).await;
    let page = journal.grips(GripQuery::default()).await.unwrap();
    assert!(page.bodies[0].ends_with(r#","part_lost_at":"1970-01-01T00:01:01.000Z"}"#), "{}", page.bodies[0]);
}

#[tokio::test]
async fn concurrent_records_are_numbered_without_a_gap() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let recording = (0..20).map(|client| {
        let journal = journal.clone();
        tokio::spawn(async move {
            for number in 0..10 {
                keep(&journal, link(number, &format!("g{client}"))).await;
            }
        })
    });
    for recording in recording.collect::<Vec<_>>() {
        recording.await.unwrap();
    }
    let seqs: Vec<_> = all(&journal).await.iter().map(|event| event["seq"].as_i64().unwrap()).collect();
    assert_eq!(seqs, (1..=200).collect::<Vec<_>>());
}

#[tokio::test]
async fn every_kind_of_event_can_be_written_and_read() {
    use crate::model::{
        AcknowledgeEvent, Client, DeviceEvent, FastStopCause, FastStopEvent, FastStopStep, RefusedEvent, SettingChange,
        SettingsEvent,
    };
    let fast_stop_id = IdSource::new(1).fast_stop_id(at(1));
    let (reason, cause) = ("a \"quote\"\u{2028}".to_owned(), FastStopCause::Requested);
    let details = [
        Detail::FastStop(FastStopEvent { event: FastStopStep::Latched, fast_stop_id, cause, reason, count: 1 }),
        Detail::Acknowledge(AcknowledgeEvent { fast_stop_id: Some(fast_stop_id), cleared: true, cause: None }),
        Detail::Device(DeviceEvent::Restarted),
        Detail::Device(DeviceEvent::Fault { flags: vec!["TEMP_FAULT"] }),
        Detail::Settings(SettingsEvent { restored: true, setting: SettingChange::Tare }),
        Detail::Settings(SettingsEvent { restored: false, setting: SettingChange::ForceLimit { force_n: f32::NAN } }),
        Detail::Refused(RefusedEvent {
            command: "grip".into(),
            code: "fast_stop".into(),
            cause: String::new(),
            count: 2,
        }),
        Detail::Gateway(GatewayEvent::Ended),
    ];
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    let client = Client::new("http:\u{1F980}", Door::Http);
    for detail in details.clone() {
        keep(&journal, Event::new(at(1), None, detail).by(&client)).await;
    }
    let kinds = fields(&all(&journal).await, &["kind"]);
    assert_eq!(kinds, ["fast_stop", "acknowledge", "device", "device", "settings", "settings", "refused", "gateway"]);
    let mut follow = journal.follow(Some(0), Filter::default());
    for _ in details {
        assert_eq!(next_event(&mut follow).await.command_id, None);
    }
}
