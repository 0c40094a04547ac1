use rand::rngs::SmallRng;
use rand::{RngExt as _, SeedableRng as _};
use serde_json::{Value, json};

use super::*;
use crate::journal::{JournalLocation, NEWEST_WEIGHS, Retention};
use crate::model::{DeviceEvent, Door, ServoAdapter, ServoEnd};

fn left() -> Name {
    "left".parse().unwrap()
}

fn by() -> Client {
    Client::new("http:127.0.0.1", Door::Http)
}

/// Wear that follows records of one gripper.
struct Worn {
    wear: Wear,
    seq: i64,
}

impl Worn {
    fn with(limits: DriftLimits) -> Self {
        let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
        Self { wear: Wear::new(journal, Some(limits), &[]), seq: 0 }
    }

    fn take(&mut self, record: &Value) {
        self.seq += 1;
        self.update(record);
    }

    /// Takes the newest record again, as it does when it has changed.
    fn update(&self, record: &Value) {
        let mut record = record.clone();
        let given = record.as_object_mut().unwrap();
        given.insert("seq".to_owned(), self.seq.into());
        given.insert("gripper".to_owned(), "left".into());
        given.entry("started_at").or_insert_with(|| Timestamp::now().to_string().into());
        self.wear.take(&record.to_string());
    }

    fn grip(&mut self, width_mm: f64) {
        self.take(&grip(width_mm));
    }

    fn alarms(&self) -> Vec<AlarmKind> {
        self.wear.conditions(&left()).into_iter().map(|condition| condition.alarm).collect()
    }

    fn is_drifting(&self) -> bool {
        self.alarms().contains(&AlarmKind::DriftWarning)
    }

    fn mount(&self, id: &str, reset: bool) -> FingerSet {
        let id = FingerSetId::new(id).unwrap();
        let mounted = MountRequest { id, maintenance_cycles: Some(3), maintenance_travel_m: Some(1.0), reset };
        self.wear.mount(&left(), mounted, &by()).0
    }
}

fn grip(width_mm: f64) -> Value {
    json!({"kind": "grip", "outcome": "PART_HELD", "part_id": "A", "contact_width_mm": width_mm, "travel_mm": 30.0})
}

/// Pseudorandom values with a mean of 0 and a standard deviation of 1.
fn noise() -> impl FnMut() -> f64 {
    let mut numbers = SmallRng::seed_from_u64(1);
    move || (0..12).map(|_| numbers.random::<f64>()).sum::<f64>() - 6.0
}

#[test]
fn warning_begins_exactly_at_the_limit() {
    let mut worn = Worn::with(DriftLimits::default());
    for _ in 0..200 {
        worn.grip(20.0);
    }
    let (mut average, mut width) = (20.0, 20.0);
    while !worn.is_drifting() {
        width += 0.001;
        worn.grip(width);
        average += NEWEST_WEIGHS * (width - average);
        assert_eq!(worn.is_drifting(), average - 20.0 > 0.05, "at {width}");
    }
    let grips = ((width - 20.0) * 1000.0).round();
    assert!((54.0..=55.0).contains(&grips), "{grips}");
    let [WearCondition { part_id, cause, .. }] = &worn.wear.conditions(&left())[..] else { panic!() };
    assert_eq!(part_id.as_ref().unwrap().as_str(), "A");
    assert_eq!(cause, "part A: contact width 20.050 mm on average, +0.050 mm from the first 30 grips");
}

#[test]
fn first_thirty_grips_are_learned_without_a_warning() {
    let mut worn = Worn::with(DriftLimits::default());
    for number in 0..30 {
        worn.grip(20.0 + f64::from(number));
        assert!(!worn.is_drifting());
    }
    worn.wear.set_limits(None);
    for _ in 0..100 {
        worn.grip(60.0);
        assert!(!worn.is_drifting(), "drift is not watched");
    }
    worn.wear.set_limits(Some(DriftLimits::default()));
    assert!(worn.is_drifting(), "without a further grip");
}

#[test]
fn spread_alone_raises_no_warning() {
    let mut worn = Worn::with(DriftLimits { min_mm: 0.001, ..DriftLimits::default() });
    let mut noise = noise();
    let mut warned = 0;
    for _ in 0..20_000 {
        worn.grip(20.0 + 0.05 * noise());
        warned += u32::from(worn.is_drifting());
    }
    assert_eq!(warned, 0);
    for _ in 0..20 {
        worn.grip(20.2 + 0.05 * noise());
    }
    assert!(worn.is_drifting());
}

#[test]
fn drift_ends_within_half_of_the_limit() {
    let mut worn = Worn::with(DriftLimits::default());
    (0..30).for_each(|_| worn.grip(20.0));
    (0..30).for_each(|_| worn.grip(20.06));
    assert!(worn.is_drifting());
    (0..30).for_each(|_| worn.grip(20.04));
    assert!(worn.is_drifting());
    (0..30).for_each(|_| worn.grip(20.02));
    assert!(!worn.is_drifting());
}

#[test]
fn parts_gauges_and_recipes_are_learned_separately() {
    let mut worn = Worn::with(DriftLimits::default());
    let other = |name: &str, value: Value| {
        let mut record = grip(25.0);
        record[name] = value;
        record
    };
    for _ in 0..100 {
        worn.grip(20.0);
        worn.take(&other("part_id", "B".into()));
        worn.take(&other("kind", "reference".into()));
        worn.take(&other("outcome", "WRONG_PART".into()));
        worn.take(&other("contact_width_mm", Value::Null));
    }
    assert!(!worn.is_drifting());
    let by_recipe = |width_mm: f64, version: u64| {
        let mut record = grip(width_mm);
        record["recipe_version"] = version.into();
        record
    };
    for _ in 0..100 {
        worn.take(&by_recipe(20.0, 3));
        worn.grip(20.0);
    }
    (0..100).for_each(|_| worn.take(&by_recipe(25.0, 4)));
    assert!(!worn.is_drifting(), "the new version is learned again");
    (0..100).for_each(|_| worn.grip(20.0));
    assert!(worn.is_drifting(), "a grip without a recipe learns nothing again");
}

#[test]
fn finger_set_counts_until_another_is_mounted() {
    let mut worn = Worn::with(DriftLimits::default());
    worn.grip(20.0);
    assert_eq!(worn.wear.finger_set(&left()), None);
    let first = worn.mount("F-1", false);
    for _ in 0..2 {
        worn.grip(20.0);
        worn.update(&grip(20.0));
        worn.take(&json!({"kind": "release", "outcome": "SUCCESS", "part_id": null, "travel_mm": 20.0}));
    }
    let counted = worn.wear.finger_set(&left()).unwrap();
    assert_eq!((counted.cycles, counted.travel_mm, counted.is_maintenance_due()), (2, 100.0, false));
    assert_eq!((worn.mount("F-1", false).cycles, first.mounted_at), (2, counted.mounted_at));
    worn.grip(20.0);
    assert_eq!(worn.alarms(), [AlarmKind::MaintenanceDue]);
    assert_eq!(worn.wear.conditions(&left())[0].cause, "finger set F-1, grips: 3, travel: 0 m");
    assert_eq!(worn.mount("F-1", true).cycles, 0);
    assert!(worn.alarms().is_empty());
    worn.take(&json!({"kind": "move", "outcome": "SUCCESS", "part_id": null, "travel_mm": 1000.0}));
    assert_eq!(worn.alarms(), [AlarmKind::MaintenanceDue], "by its travel");
    assert_eq!((worn.mount("F-2", false).cycles, worn.alarms()), (0, Vec::new()));
}

#[test]
fn grip_that_began_before_the_mount_is_not_counted() {
    let mut worn = Worn::with(DriftLimits::default());
    let mounted = worn.mount("F-2", false);
    let mut grip_before = |time: SignedDuration| {
        let mut record = grip(20.0);
        record["started_at"] = (mounted.mounted_at - time).to_string().into();
        worn.take(&record);
        let is_learned = !worn.wear.known().grippers[&left()].charts.is_empty();
        (worn.wear.finger_set(&left()).unwrap().cycles, is_learned)
    };
    assert_eq!(grip_before(SignedDuration::from_secs(20)), (0, false));
    // The clock was set back since.
    assert_eq!(grip_before(SignedDuration::from_hours(5)), (1, true));
}

/// The end of a servo session, as the journal serves it.
fn session(seq: i64, at: Timestamp, duration_ms: u32) -> String {
    let event = json!({"seq": seq, "at": at.to_string(), "gripper": "left", "kind": "device", "event": "servo_ended",
        "adapter": "moves", "reason": "ended", "duration_ms": duration_ms, "accepted": 3, "superseded": 0, "refused": 0,
        "longest_gap_ms": 20, "travel_mm": 400.0});
    event.to_string()
}

#[test]
fn way_of_a_servo_session_is_counted_once() {
    let worn = Worn::with(DriftLimits::default());
    let mounted_at = worn.mount("F-1", false).mounted_at;
    let at = mounted_at + SignedDuration::from_secs(60);
    worn.wear.take_session(&session(7, at, 50_000));
    worn.wear.take_session(&session(7, at, 50_000));
    worn.wear
        .take_session(&json!({"seq": 8, "at": at.to_string(), "gripper": "left", "event": "restarted"}).to_string());
    let counted = worn.wear.finger_set(&left()).unwrap();
    assert_eq!((counted.cycles, counted.travel_m()), (0, 0.4));
    // Began, or had even ended, with other fingers.
    worn.wear.take_session(&session(9, at, 61_000));
    worn.wear.take_session(&session(10, mounted_at - SignedDuration::from_secs(1), 20));
    assert_eq!(worn.wear.finger_set(&left()), Some(counted));
}

#[tokio::test]
async fn sessions_that_ended_before_a_restart_are_counted() {
    let worn = Worn::with(DriftLimits::default());
    worn.mount("F-1", false);
    let journal = worn.wear.journal.clone();
    let value = Some(serde_json::to_string(&worn.wear.known().grippers[&left()]).unwrap());
    let mut persisted: GripperWear = serde_json::from_str(value.as_deref().unwrap()).unwrap();
    persisted.session_seq = 1;
    let value = Some(serde_json::to_string(&persisted).unwrap());
    let persisted = [PersistedState { gripper: left(), key: PersistedKey::Wear, value }];
    let ended = DeviceEvent::ServoEnded {
        adapter: ServoAdapter::Moves,
        reason: ServoEnd::Ended,
        duration_ms: 0,
        accepted: 3,
        superseded: 0,
        refused: 0,
        longest_gap_ms: 20,
        travel_mm: 400.0,
    };
    let (waiter, durable) = oneshot::channel();
    let event = Event::new(Now::read().wall + SignedDuration::from_secs(1), Some(left()), Detail::Device(ended));
    journal.record(Record::Event(event, Some(waiter)));
    durable.await.unwrap();
    let wear = Arc::new(Wear::new(journal.clone(), None, &persisted));
    let closing = CancellationToken::new();
    let watching = tokio::spawn(wear.clone().watch(journal.subscribe_grips(), closing.clone()));
    let counted = async {
        while wear.finger_set(&left()).unwrap().travel_mm < 400.0 {
            tokio::task::yield_now().await;
        }
    };
    tokio::time::timeout(Duration::from_secs(20), counted).await.unwrap();
    closing.cancel();
    watching.await.unwrap();
}

#[test]
fn new_fingers_are_learned_again() {
    let mut worn = Worn::with(DriftLimits::default());
    (0..30).for_each(|_| worn.grip(20.0));
    (0..30).for_each(|_| worn.grip(20.1));
    assert!(worn.is_drifting());
    worn.mount("F-2", false);
    (0..60).for_each(|_| worn.grip(20.1));
    assert!(!worn.is_drifting());
}

#[test]
fn charts_are_bounded() {
    let mut worn = Worn::with(DriftLimits::default());
    (0..30).for_each(|_| worn.grip(20.0));
    for number in 0..MAX_CHARTS {
        let mut record = grip(20.0);
        record["part_id"] = number.to_string().into();
        worn.take(&record);
    }
    assert_eq!(worn.wear.known().grippers[&left()].charts.len(), MAX_CHARTS);
    (0..30).for_each(|_| worn.grip(20.1));
    assert!(worn.is_drifting(), "parts that are gripped once push out no learned one");
}

#[test]
fn wear_outlives_a_restart() {
    let mut worn = Worn::with(DriftLimits::default());
    worn.mount("F-1", false);
    (0..30).for_each(|_| worn.grip(20.0));
    (0..30).for_each(|_| worn.grip(20.1));
    let before = worn.wear.known().grippers.clone();
    let value = Some(serde_json::to_string(&before[&left()]).unwrap());
    let persisted = [PersistedState { gripper: left(), key: PersistedKey::Wear, value }];
    let restored = Wear::new(worn.wear.journal.clone(), Some(DriftLimits::default()), &persisted);
    assert_eq!(restored.known().grippers, before);
    assert_eq!(restored.conditions(&left()), worn.wear.conditions(&left()));
    assert_eq!(restored.conditions(&left()).len(), 2);
}
