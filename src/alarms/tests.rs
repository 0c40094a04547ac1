//! Alarms of invented conditions, and of a journal.

use std::time::Instant;

use jiff::{SignedDuration, Timestamp};

use super::*;
use crate::access::CredentialKind;
use crate::journal::{JournalLocation, Retention};
use crate::model::clock;
use crate::model::{Door, Fault, Link, Missing, PartId, State, Values};
use crate::webhooks::{Authorities, WebhookContext, WebhookRunner, WebhookSettings};
use crate::wsg::{GripperState, SystemState};

/// A list, and a time that passes.
struct Scene {
    list: AlarmList,
    now: Now,
}

impl Scene {
    fn new() -> Self {
        let wall = Timestamp::from_millisecond(1_795_258_800_000).unwrap();
        Self { list: AlarmList::default(), now: Now { instant: Instant::now(), wall, exact: wall } }
    }

    fn after(&mut self, seconds: u64) -> &mut Self {
        self.now.instant += Duration::from_secs(seconds);
        self.now.wall += SignedDuration::from_secs(seconds.cast_signed());
        self
    }

    /// Shows these conditions, and returns the steps.
    fn see(&mut self, conditions: &[(AlarmKey, Option<AlarmCause>)]) -> Vec<AlarmStep> {
        let changes = self.list.look(self.now, &conditions.iter().cloned().collect());
        changes.into_iter().map(|(step, _)| step).collect()
    }

    fn only(&self) -> Alarm {
        let alarms = self.list.alarms();
        assert_eq!(alarms.len(), 1, "{alarms:?}");
        alarms[0].clone()
    }

    fn acknowledge(&mut self, id: AlarmId) -> usize {
        self.list.acknowledge(&[id].into(), &Client::new("Anna", Door::Http), self.now.wall).0.len()
    }
}

fn key(alarm: AlarmKind) -> AlarmKey {
    AlarmKey::of_gripper(alarm, &"left".parse().unwrap())
}

fn down() -> (AlarmKey, Option<AlarmCause>) {
    (key(AlarmKind::LinkDown), Some(text("refused")))
}

fn stopped(id: FastStopId) -> (AlarmKey, Option<AlarmCause>) {
    (key(AlarmKind::FastStop), Some(AlarmCause { fast_stop_id: Some(id), ..AlarmCause::default() }))
}

#[test]
fn ended_alarm_stays_until_acknowledged() {
    let mut scene = Scene::new();
    assert_eq!(scene.see(&[down()]), [AlarmStep::Raised]);
    assert_eq!(scene.see(&[down()]), []);
    let began_at = scene.only().began_at;
    assert_eq!(scene.after(5).see(&[]), [], "a condition can flicker");
    let absent_at = scene.now.wall;
    assert_eq!(scene.after(1).see(&[]), [AlarmStep::Ended]);
    let alarm = scene.only();
    assert_eq!((alarm.began_at, alarm.ended_at, alarm.acknowledged_at), (began_at, Some(absent_at), None));
    assert_eq!(scene.acknowledge(alarm.id), 1);
    assert_eq!(scene.list.alarms(), []);
    assert_eq!(scene.acknowledge(alarm.id), 0);
}

#[test]
fn alarm_of_a_higher_priority_takes_the_place_of_a_lower_one() {
    let mut scene = Scene::new();
    let drift = |number: u32| {
        let part_id = PartId::new(&number.to_string());
        (AlarmKey { part_id, ..key(AlarmKind::DriftWarning) }, Some(AlarmCause::default()))
    };
    let mut conditions: Vec<_> = (0..2000).map(drift).collect();
    scene.see(&conditions);
    let listed = scene.list.alarms().len();
    conditions.push(down());
    assert_eq!(scene.see(&conditions), [AlarmStep::Raised]);
    assert_eq!(scene.see(&conditions), [], "the other one does not come back");
    let alarms = scene.list.alarms();
    assert!(alarms.len() == listed && alarms.iter().any(|alarm| alarm.alarm == AlarmKind::LinkDown));
}

#[test]
fn acknowledged_alarm_stays_while_active() {
    let mut scene = Scene::new();
    scene.see(&[down()]);
    let id = scene.only().id;
    assert_eq!([scene.acknowledge(id), scene.after(9).acknowledge(id)], [1, 1]);
    let alarm = scene.only();
    assert_eq!((alarm.acknowledged_by.as_deref(), alarm.ended_at), (Some("Anna"), None));
    assert_eq!(alarm.acknowledged_at, Some(alarm.began_at), "the first acknowledgement counts");
    scene.see(&[]);
    assert_eq!(scene.after(1).see(&[]), [AlarmStep::Ended]);
    assert_eq!(scene.list.alarms(), []);
}

#[test]
fn recurrence_counts_and_needs_its_own_acknowledgement() {
    let mut scene = Scene::new();
    scene.see(&[down()]);
    let first = scene.only();
    scene.see(&[]);
    scene.after(1).see(&[]);
    assert_eq!(scene.after(1).see(&[down()]), [AlarmStep::Raised]);
    let second = scene.only();
    assert_eq!((second.count, second.ended_at, second.began_at), (2, None, scene.now.wall));
    assert_eq!(scene.acknowledge(first.id), 0, "what nobody has seen is not acknowledged");
}

#[test]
fn flickering_condition_is_one_alarm() {
    let mut scene = Scene::new();
    let steps: Vec<_> = (0..100)
        .flat_map(|round| {
            scene.now.instant += Duration::from_millis(400);
            scene.see(&[down()][..round % 2])
        })
        .collect();
    assert_eq!(steps, [AlarmStep::Raised]);
}

#[test]
fn unknown_condition_changes_nothing() {
    let mut scene = Scene::new();
    let warm = (key(AlarmKind::TemperatureWarning), Some(AlarmCause::default()));
    let unknown = (key(AlarmKind::TemperatureWarning), None);
    assert_eq!(scene.see(std::slice::from_ref(&unknown)), []);
    scene.see(&[warm]);
    assert_eq!(scene.after(60).see(&[unknown]), []);
    assert_eq!(scene.only().ended_at, None);
}

#[test]
fn fast_stop_alarm_ends_with_its_latch() {
    let (mut scene, gripper) = (Scene::new(), "left".parse().unwrap());
    let [first, second] = [FastStopId::generate(), FastStopId::generate()];
    scene.see(&[stopped(first)]);
    let at = scene.now.wall;
    assert_eq!(scene.list.end_fast_stop(&gripper, second, (None, None), at), []);
    let changes = scene.list.end_fast_stop(&gripper, first, (Some("ws:10.0.0.5".into()), ClientLabel::new("Anna")), at);
    assert_eq!(changes.iter().map(|(step, _)| *step).collect::<Vec<_>>(), [AlarmStep::Acknowledged, AlarmStep::Ended]);
    assert_eq!(changes[1].1.acknowledged_by.as_deref(), Some("ws:10.0.0.5"));
    assert_eq!(scene.list.alarms(), []);
    // A FAST STOP that follows at once is another alarm.
    scene.see(&[stopped(first)]);
    assert_eq!(scene.see(&[stopped(second)]), [AlarmStep::Ended, AlarmStep::Raised]);
    assert_eq!(scene.only().cause.fast_stop_id, Some(second));
    scene.see(&[]);
    assert_eq!(scene.after(1).see(&[]), [AlarmStep::Ended]);
    assert_eq!(scene.list.alarms(), []);
}

#[test]
fn list_is_bounded() {
    let mut scene = Scene::new();
    let gone = |number: usize| {
        let gateway = Some(format!("cell-{number}").parse().unwrap());
        (AlarmKey { gateway, ..AlarmKey::of_gateway(AlarmKind::GatewayGone) }, Some(AlarmCause::default()))
    };
    scene.see(&(0..1500).map(gone).collect::<Vec<_>>());
    assert_eq!(scene.list.alarms().len(), 1024);
    scene.see(&[]);
    scene.after(1).see(&[]);
    scene.see(&[down()]);
    let alarms = scene.list.alarms();
    assert_eq!((alarms.len(), alarms[0].alarm), (1024, AlarmKind::LinkDown), "a new alarm replaces an ended one");
}

fn raised_by(state: &State) -> Vec<AlarmKind> {
    let mut conditions = Conditions::new();
    of_gripper(state, clock::instant(), false, &mut conditions);
    conditions.into_iter().filter_map(|(key, cause)| cause.map(|_| key.alarm)).collect()
}

fn values(flags: SystemState, state: GripperState) -> Values {
    Values::fixed(flags, state, [20.0, 0.0, 0.0])
}

#[test]
fn state_shows_its_conditions() {
    let unknown = State::unknown("left".parse().unwrap());
    assert_eq!(raised_by(&unknown), [AlarmKind::NotReached]);
    let idle = values(SystemState::REFERENCED, GripperState::Idle);
    let fine = State { link: Link::Connected, values: idle, fault_code: 0, fast_stop: Some(false), ..unknown };
    assert_eq!(raised_by(&fine), []);
    let reserved = State { reserved_for: Some("Anna".into()), ..fine.clone() };
    assert_eq!(raised_by(&reserved), [AlarmKind::HolderLost]);
    assert_eq!(raised_by(&State { lease_holder: Some("Ben".into()), ..reserved }), []);
    let flags = SystemState::MOVING | SystemState::TEMP_WARNING | SystemState::FINGER_FAULT;
    let hot = State { values: values(flags, GripperState::Idle), ..fine.clone() };
    assert_eq!(raised_by(&hot), [AlarmKind::FingerFault, AlarmKind::TemperatureWarning]);
    let mut gone = State { link: Link::Reconnecting, ..hot };
    gone.values.forget();
    assert_eq!(raised_by(&gone), [AlarmKind::LinkDown]);
    let lost = State { values: values(SystemState::REFERENCED, GripperState::PartLost), ..fine.clone() };
    assert_eq!(raised_by(&lost), [AlarmKind::PartLost]);
    let mut unheard = fine.clone();
    unheard.values.width.lose(Missing::Silent);
    assert_eq!(raised_by(&unheard), [AlarmKind::ValueUnknown]);
    unheard.values.flags.lose(Missing::Silent);
    assert_eq!(raised_by(&State { link: Link::Unresponsive, ..unheard }), [AlarmKind::LinkDown]);
    let failed = State { fault_code: Fault::DeviceError.code(), ..fine };
    assert_eq!(raised_by(&failed), [AlarmKind::DeviceError]);
}

#[tokio::test]
async fn alarms_survive_a_restart() {
    let folder = std::env::temp_dir().join(format!("wsg-alarms-{}", uuid::Uuid::now_v7()));
    std::fs::create_dir(&folder).unwrap();
    let place = || JournalLocation::File(folder.join("journal.db"));
    let gateway = || "wsg".parse().unwrap();
    let (journal, _) = Journal::open(place(), Retention::default()).unwrap();
    let alarms = Alarms::new(gateway(), journal.clone(), &[]);
    alarms.look(Now::read(), &[down()].into());
    let before = alarms.read().1.alarms;
    journal.close().await.unwrap();
    let (journal, recovered) = Journal::open(place(), Retention::default()).unwrap();
    let alarms = Alarms::new(gateway(), journal.clone(), &recovered.memory);
    assert_eq!(alarms.read().1.alarms, before);
    let client = Client { label: ClientLabel::new("Anna"), ..Client::new("http:10.0.0.5", Door::Http) };
    alarms.acknowledge(&[before[0].id].into(), &client);
    journal.close().await.unwrap();
    // The gateway's name can change.
    let (journal, recovered) = Journal::open(place(), Retention::default()).unwrap();
    let renamed = || "cell-7".parse().unwrap();
    let alarms = Alarms::new(renamed(), journal.clone(), &recovered.memory).read().1.alarms;
    assert_eq!(alarms[0].acknowledged_by.as_deref(), Some("http:10.0.0.5"));
    assert_eq!(alarms[0].acknowledged_label, ClientLabel::new("Anna"));
    journal.close().await.unwrap();
    let (journal, recovered) = Journal::open(place(), Retention::default()).unwrap();
    assert_eq!(Alarms::new(renamed(), journal, &recovered.memory).read().1.alarms, alarms);
    std::fs::remove_dir_all(folder).unwrap();
}

#[tokio::test]
async fn gateway_that_was_gone_before_a_restart_stays_gone() {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    let alarms = Alarms::new("wsg".parse().unwrap(), journal, &[]);
    let gateway = Some("cell-7".parse().unwrap());
    let gone = AlarmKey { gateway, ..AlarmKey::of_gateway(AlarmKind::GatewayGone) };
    alarms.look(Now::read(), &[(gone.clone(), Some(AlarmCause::default()))].into());
    let peers = Peers::new("wsg".parse().unwrap(), Grippers::new([]), None);
    let after = |running_for| {
        let mut conditions = Conditions::new();
        alarms.add_of_gateway(&peers, running_for, &mut conditions);
        conditions.get(&gone).cloned()
    };
    assert_eq!((after(Duration::ZERO), after(KEPT_FOR)), (Some(None), None));
}

fn named(conditions: &Conditions) -> Vec<(AlarmKind, &str)> {
    conditions.keys().map(|key| (key.alarm, key.name.as_deref().unwrap_or_default())).collect()
}

#[test]
fn credentials_near_their_end_are_conditions() {
    let now = Scene::new().now.wall;
    let ends = [
        (CredentialKind::Token, "plc7", 3),
        (CredentialKind::Token, "mes", 15),
        (CredentialKind::Token, "old", -1),
        (CredentialKind::Certificate, "certificate.pem", 13),
    ];
    let credentials = ends.map(|(kind, name, days)| ExpiringCredential {
        kind,
        name: name.into(),
        valid_from: now - SignedDuration::from_hours(80 * 24),
        expires_at: now + SignedDuration::from_hours(days * 24),
    });
    let mut conditions = Conditions::new();
    of_credentials(&credentials, now, &mut conditions);
    let expected = [
        (AlarmKind::TokenExpiring, "old"),
        (AlarmKind::TokenExpiring, "plc7"),
        (AlarmKind::CertificateExpiring, "certificate.pem"),
    ];
    assert_eq!(named(&conditions), expected);
    // Each one is an alarm of its own, also after a restart.
    let mut scene = Scene::new();
    let conditions: Vec<_> = conditions.into_iter().collect();
    assert_eq!(scene.see(&conditions), [AlarmStep::Raised; 3]);
    scene.list = AlarmList::restored(scene.list.alarms());
    assert_eq!(scene.see(&conditions), []);
}

#[tokio::test]
async fn webhook_that_fails_for_a_minute_is_a_condition() {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    let runner = WebhookRunner::new(WebhookContext {
        gateway: "wsg".parse().unwrap(),
        journal: journal.clone(),
        registry: prometheus::Registry::new(),
        closing: CancellationToken::new(),
        runtime: tokio::runtime::Handle::current(),
    });
    let settings = WebhookSettings {
        name: "mes".parse().unwrap(),
        receiver: "http://127.0.0.1:1/".parse().unwrap(),
        kinds: None,
        secret: "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".parse().unwrap(),
        authorities: Authorities::default(),
    };
    runner.apply(runner.prepare(&[settings]).unwrap(), &[]).await.unwrap();
    let alarms = Alarms::new("wsg".parse().unwrap(), journal, &[]);
    alarms.look(Now::read(), &[down()].into());
    let since = loop {
        match runner.webhooks().all()[0].progress().failing_since {
            Some(since) => break since,
            None => tokio::task::yield_now().await,
        }
    };
    let mut conditions = Conditions::new();
    of_webhooks(runner.webhooks(), since + Duration::from_secs(59), &mut conditions);
    assert!(conditions.is_empty());
    of_webhooks(runner.webhooks(), since + Duration::from_mins(1), &mut conditions);
    assert_eq!(named(&conditions), [(AlarmKind::WebhookFailing, "mes")]);
    let cause = conditions.into_values().next().flatten().unwrap().cause.unwrap();
    assert!(cause.starts_with("cannot connect to http://127.0.0.1:1: "), "{cause}");
}

#[test]
fn broker_that_is_away_for_a_minute_is_a_condition() {
    let since = Instant::now();
    let broker: Arc<str> = "mqtt://broker".into();
    let outage =
        BrokerOutage { since, connected_at: None, relapses: 1, broker: broker.clone(), cause: "cannot connect".into() };
    let mut conditions = Conditions::new();
    of_broker(None, since + Duration::from_hours(1), &mut conditions);
    of_broker(Some(&outage), since + Duration::from_secs(59), &mut conditions);
    assert!(conditions.is_empty());
    of_broker(Some(&outage), since + Duration::from_mins(1), &mut conditions);
    assert_eq!(named(&conditions), [(AlarmKind::MqttFailing, "mqtt://broker")]);
}

#[test]
fn broker_that_is_lost_again_and_again_is_a_condition() {
    let since = Instant::now();
    let connected_at = since + Duration::from_secs(70);
    let restarted = BrokerOutage {
        since,
        connected_at: Some(connected_at),
        relapses: 1,
        broker: "mqtt://broker".into(),
        cause: "cannot connect".into(),
    };
    let is_condition = |outage: &BrokerOutage, now: Instant| {
        let mut conditions = Conditions::new();
        of_broker(Some(outage), now, &mut conditions);
        !conditions.is_empty()
    };
    assert!(!is_condition(&restarted, connected_at));
    let flapping = BrokerOutage { relapses: 2, ..restarted };
    assert!(!is_condition(&flapping, since + Duration::from_secs(59)));
    assert!(is_condition(&flapping, connected_at + Duration::from_secs(44)));
    assert!(!is_condition(&flapping, connected_at + Duration::from_secs(45)));
}
