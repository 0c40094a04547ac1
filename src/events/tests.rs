//! Updates that subscribers get, and those that they don't.

use serde_json::Value;

use super::*;
use crate::gripper::fake::{self, FakeScript};
use crate::gripper::recorder::{Record, Recorder as _};
use crate::journal::tests::grip;
use crate::journal::{JournalLocation, Retention};
use crate::model::{Client, Detail, Door, Event, FastStopId, Reason, RefusedEvent};

fn updates() -> (Arc<LiveUpdates>, Journal) {
    let (journal, _) = Journal::open(JournalLocation::Memory, Retention::default()).unwrap();
    let fleet = Grippers::new([
        fake::gripper("left", FakeScript::default()).0,
        fake::gripper("right", FakeScript::default()).0,
    ]);
    let network = Arc::new(Peers::new("wsg".parse().unwrap(), fleet.clone(), None));
    let alarms = Arc::new(Alarms::new("wsg".parse().unwrap(), journal.clone(), &[]));
    (Arc::new(LiveUpdates::new(fleet, journal.clone(), network, alarms)), journal)
}

fn record(journal: &Journal, gripper: Option<&str>) {
    let refused = RefusedEvent { command: "grip".into(), code: "malformed".into(), cause: "a test".into(), count: 1 };
    let gripper = gripper.map(|name| name.parse().unwrap());
    // An event without a client, because repetitions of a client would be merged.
    let event = Event::new(Now::read().wall, gripper, Detail::Refused(refused));
    journal.record(Record::Event(event, None));
}

/// Waits until the event with this number is durable.
async fn until(journal: &Journal, seq: i64) {
    while journal.last_seq() < seq {
        tokio::task::yield_now().await;
    }
}

fn body(notification: &Notification) -> Value {
    serde_json::from_str(notification.body()).unwrap()
}

#[tokio::test]
async fn slow_subscriber_gets_a_gap_with_the_number_of_missed_events() {
    let (updates, journal) = updates();
    let mut subscription = updates.subscribe(None, [Topic::Events]);
    let (count, first) = (3000, journal.last_seq());
    for recorded in 1..=count {
        record(&journal, None);
        // Slow enough for the journal's queue.
        until(&journal, first + recorded).await;
    }
    let gap = subscription.next().await;
    let (seq, missed) = (body(&gap)["seq"].as_i64().unwrap(), body(&gap)["missed"].as_i64().unwrap());
    assert_eq!((gap.method(), seq, body(&gap)["topic"].as_str()), ("gap", first, Some("events")));
    assert!(missed > 0);
    for expected in first + missed + 1..=first + count {
        assert_eq!(body(&subscription.next().await)["seq"], expected);
    }
    assert!(subscription.next().now_or_never().is_none());
}

#[tokio::test]
async fn new_subscription_loses_no_event() {
    let (updates, journal) = updates();
    let only = BTreeSet::from(["left".parse().unwrap()]);
    let mut replaced = updates.subscribe(Some(&only), [Topic::Events]);
    let first = replaced.event_seq();
    for gripper in ["left", "right", "left", "right"] {
        record(&journal, Some(gripper));
    }
    until(&journal, first + 4).await;
    let mut successor = updates.subscribe(None, [Topic::Events]);
    assert_eq!(successor.event_seq(), first + 4);
    record(&journal, Some("left"));
    until(&journal, first + 5).await;
    let seqs = |updates: &[Notification]| -> Vec<_> {
        updates.iter().map(|update| (update.method(), body(update)["seq"].as_i64().unwrap() - first)).collect()
    };
    assert_eq!(seqs(&replaced.rest(&successor)), [("event", 1), ("event", 3)]);
    assert_eq!(seqs(&[successor.next().await]), [("event", 5)]);

    let mut replaced = updates.subscribe(None, [Topic::Events]);
    for recorded in 6..=305 {
        record(&journal, None);
        until(&journal, first + recorded).await;
    }
    let successor = updates.subscribe(None, [Topic::Events]);
    assert_eq!(seqs(&replaced.rest(&successor)), (6..=305).map(|seq| ("event", seq)).collect::<Vec<_>>());

    // The replaced subscription goes on until the new one begins.
    let mut replaced = updates.subscribe(None, [Topic::Events]);
    let mut successor = updates.subscribe(None, [Topic::Events]);
    for recorded in 306..=308 {
        record(&journal, None);
        until(&journal, first + recorded).await;
    }
    assert_eq!(seqs(&[replaced.next().await]), [("event", 306)]);
    assert_eq!(seqs(&replaced.rest(&successor)), []);
    assert_eq!(seqs(&[successor.next().await, successor.next().await]), [("event", 307), ("event", 308)]);

    // A new subscription to fewer grippers sends none again.
    let mut replaced = updates.subscribe(None, [Topic::Events]);
    let mut successor = updates.subscribe(Some(&only), [Topic::Events]);
    for (recorded, gripper) in [(309, "left"), (310, "left")] {
        record(&journal, Some(gripper));
        until(&journal, first + recorded).await;
    }
    assert_eq!(seqs(&[replaced.next().await]), [("event", 309)]);
    assert_eq!(seqs(&replaced.rest(&successor)), []);
    assert_eq!(seqs(&[successor.next().await]), [("event", 310)]);

    // Without its receiver, the events can no longer be sent.
    let mut replaced = updates.subscribe(None, [Topic::Events]);
    for recorded in 311..=313 {
        record(&journal, None);
        until(&journal, first + recorded).await;
    }
    replaced.queued.clear();
    let gaps = replaced.rest(&updates.subscribe(None, [Topic::Events]));
    assert_eq!((seqs(&gaps), &body(&gaps[0])["missed"]), (vec![("gap", 310)], &3.into()));
}

#[tokio::test]
async fn new_subscription_loses_no_grip_record() {
    let (updates, journal) = updates();
    let [mut replaced, mut other] = [(); 2].map(|()| updates.subscribe(None, [Topic::Grips]));
    for number in 1..=2 {
        journal.record(Record::Grip(Box::new(grip(1000, "left", number, None))));
        assert_eq!(other.next().await.method(), "grip");
    }
    assert_eq!(other.rest(&updates.subscribe(None, [Topic::Events])).len(), 0);
    let rest = replaced.rest(&updates.subscribe(None, [Topic::Grips]));
    assert_eq!(rest.iter().map(Notification::method).collect::<Vec<_>>(), ["grip", "grip"]);
}

#[tokio::test]
async fn event_is_serialised_once_for_all_subscribers() {
    let (updates, journal) = updates();
    let mut both = [updates.subscribe(None, [Topic::Events]), updates.subscribe(None, [Topic::Events])];
    record(&journal, None);
    let [first, second] = &mut both;
    let (first, second) = (first.next().await, second.next().await);
    assert_eq!(first.frame().as_ptr(), second.frame().as_ptr());
    assert_eq!(body(&first)["kind"], "refused");
}

#[tokio::test]
async fn subscription_to_one_gripper_gets_no_other() {
    let (updates, journal) = updates();
    let only = BTreeSet::from(["left".parse().unwrap()]);
    let mut subscription = updates.subscribe(Some(&only), [Topic::Events, Topic::State]);
    let names: Vec<_> = subscription.snapshot().iter().map(|state| state.gripper.to_string()).collect();
    assert_eq!(names, ["left"]);
    for gripper in [Some("right"), None, Some("left")] {
        record(&journal, gripper);
    }
    assert_eq!(body(&subscription.next().await)["gripper"], "left");
    assert!(subscription.newest(0).0.is_empty(), "nothing has changed since the snapshot");
}

#[tokio::test(start_paused = true)]
async fn unchanged_state_is_repeated_as_a_heartbeat() {
    let (updates, _) = updates();
    let only = BTreeSet::from(["left".parse().unwrap()]);
    let mut subscription = updates.subscribe(Some(&only), [Topic::State, Topic::Telemetry]);
    let seq = subscription.snapshot()[0].seq;
    let mut sent = Vec::new();
    for _ in 0..40 {
        tokio::time::advance(Duration::from_millis(100)).await;
        sent.extend(subscription.newest(0).0.iter().map(|update| (update.method(), body(update)["seq"].as_u64())));
    }
    assert_eq!(sent, [("state", Some(seq)), ("telemetry", Some(seq))].repeat(4));
}

#[tokio::test]
async fn fleet_is_sent_whole_and_then_by_its_changes() {
    let (updates, _) = updates();
    let (mut one, mut other) = (updates.subscribe(None, [Topic::Fleet]), updates.subscribe(None, [Topic::State]));
    assert!(one.has_states());
    let sent = |subscription: &mut Subscription| {
        let (updates, _) = subscription.newest(0);
        let body = |update: Notification| -> Value { serde_json::from_str(update.body()).unwrap() };
        updates.into_iter().filter(|update| update.method() == "fleet").map(body).collect::<Vec<_>>()
    };
    let names: Vec<_> = sent(&mut one).iter().map(|body| format!("{}/{}", body["gateway"], body["gripper"])).collect();
    assert_eq!(names, [r#""wsg"/"left""#, r#""wsg"/"right""#]);
    assert_eq!((sent(&mut one).len(), sent(&mut other).len()), (0, 0));
    let right = updates.sources()[1].handle.clone();
    let client = Client::new("test", Door::Http);
    right.fast_stop(FastStopId::generate(), client, Reason::truncated("")).await;
    let changed = async {
        loop {
            let changed = sent(&mut one);
            if !changed.is_empty() {
                return changed;
            }
            tokio::task::yield_now().await;
        }
    };
    let changed = tokio::time::timeout(std::time::Duration::from_secs(20), changed).await.expect("the change is sent");
    assert_eq!((changed.len(), &changed[0]["gripper"]), (1, &"right".into()));
    assert_eq!(sent(&mut updates.subscribe(None, [Topic::Fleet])).len(), 2, "a later subscriber gets all");
}

#[tokio::test]
async fn alarms_are_sent_at_first_and_after_each_change() {
    let (updates, _) = updates();
    let mut subscription = updates.subscribe(None, [Topic::Alarms]);
    assert!(subscription.has_states());
    let sent = subscription.newest(0).0;
    assert_eq!(sent.iter().map(Notification::method).collect::<Vec<_>>(), ["alarms"]);
    assert_eq!(body(&sent[0]), serde_json::json!({"alarms": []}));
    assert!(subscription.newest(0).0.is_empty());
}
