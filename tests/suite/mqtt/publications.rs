//! What a gateway publishes over MQTT.

use std::collections::BTreeMap;
use std::time::Duration;

use rumqttc::v5::mqttbytes::QoS;
use serde_json::{Value, json};

use super::broker::{Broker, Got, Mood};
use super::{configuration, homed};
use crate::harness::{Gateway, JournalFile, Simulator, eventually};
use crate::installation::reload::Configured;

const EVENTS: &str = "plant/cell/g/events";
const GRIPS: &str = "plant/cell/g/grips";

/// Sequence numbers of records, without repetitions.
fn numbers(records: &[Got]) -> Vec<i64> {
    let mut numbers: Vec<i64> = Vec::new();
    for record in records {
        let seq = record.json()["seq"].as_i64().unwrap();
        if numbers.last().is_none_or(|last| seq > *last) {
            numbers.push(seq);
        }
    }
    numbers
}

/// Returns the journal's records, oldest first.
async fn journal(gateway: &Gateway, list: &str) -> Vec<Value> {
    let kinds = if list == "grips" { "&kind=all" } else { "" };
    let page = gateway.get(&format!("/api/v1/{list}?order=oldest&limit=1000{kinds}")).await.ok();
    page[list].as_array().unwrap().clone()
}

#[tokio::test]
async fn state_is_retained_and_null_while_the_link_is_lost() {
    let broker = Broker::start().await;
    let device = Simulator::start(&[]).await;
    let toml = configuration(&broker, "state_interval_ms = 20\ntelemetry_interval_ms = 50");
    let toml = toml.replace("sim://wsg50?part_mm=20", &format!("tcp://{}", device.address));
    let gateway = Gateway::with_file(&[], &toml).await;
    let state = broker.until("plant/cell/g/state", |state| state.text != "null").await;
    assert!(state.is_retained && state.qos == QoS::AtMostOnce);
    assert_eq!(state.property("schema"), Some("GripperState"));
    assert_eq!(state.json()["gripper"], "g");
    let telemetry = broker.until("plant/cell/g/telemetry", |_| true).await;
    assert!(!telemetry.is_retained && telemetry.json()["force_n"].is_number(), "{telemetry:?}");

    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    broker.until("plant/cell/g/state", |state| state.text != "null" && state.json()["referenced"] == true).await;
    let before = broker.all("plant/cell/g/state").len();
    device.terminate().await;
    eventually("an unknown state", async || {
        broker.all("plant/cell/g/state").get(before..)?.iter().find(|state| state.text == "null").map(drop)
    })
    .await;
}

#[tokio::test]
async fn availability_has_a_last_will() {
    let broker = Broker::start().await;
    let gateway = homed(&broker, &[], "").await;
    let online = broker.until("plant/cell/availability", |got| got.text == "online").await;
    assert!(online.is_retained && online.qos == QoS::AtLeastOnce);
    let description = broker.until("plant/cell/description", |_| true).await;
    assert_eq!(description.json()["grippers"], json!(["g"]));
    assert!(gateway.terminate().await.status.success());
    let states = broker.all("plant/cell/g/state");
    assert_eq!(states.last().unwrap().text, "null");
    let texts = |got: Vec<Got>| got.into_iter().map(|got| got.text).collect::<Vec<_>>();
    assert_eq!(
        texts(broker.all("plant/cell/availability")),
        ["online", "offline"],
        "no last will after an orderly end"
    );

    let gateway = homed(&broker, &[], "").await;
    eventually("a second greeting", async || (broker.all("plant/cell/availability").len() == 3).then_some(())).await;
    gateway.kill().await;
    eventually("the last will", async || (broker.all("plant/cell/availability").len() == 4).then_some(())).await;
    assert_eq!(texts(broker.all("plant/cell/availability"))[3], "offline");
}

#[tokio::test]
async fn records_are_those_of_the_journal() {
    let broker = Broker::start().await;
    let gateway = homed(&broker, &[], "").await;
    gateway.post("grip", &json!({"width_mm": 20, "speed_mm_s": 200, "part_id": "housing-7"})).await.ok();
    let grip = broker.until(GRIPS, |record| record.json()["kind"] == "grip").await;
    assert_eq!((grip.qos, grip.is_retained), (QoS::AtLeastOnce, false));
    let journal_id = gateway.get("/api/v1/grips").await.ok()["journal_id"].clone();
    assert_eq!(grip.json()["journal_id"], journal_id);
    assert_eq!(grip.property("journal_id"), journal_id.as_str());
    assert_eq!(grip.property("seq"), Some(&*grip.json()["seq"].to_string()));
    assert_eq!(grip.property("schema"), Some("StoredGripRecord"));
    let mut as_published = grip.json();
    as_published.as_object_mut().unwrap().remove("journal_id");
    let listed = journal(&gateway, "grips").await;
    assert!(listed.contains(&as_published), "{as_published} {listed:?}");
    assert!(broker.all("plant/cell/events").iter().all(|event| event.json()["gripper"].is_null()));
    let done =
        broker.until(EVENTS, |event| event.json()["part_id"] == "housing-7" && event.json()["phase"] == "done").await;
    assert_eq!(done.property("schema"), Some("StoredEvent"));
}

#[tokio::test]
async fn nothing_is_lost_over_outages_and_restarts() {
    let broker = Broker::start().await;
    let file = JournalFile::new();
    let path = file.path();
    let arguments = ["--journal", path.as_str()];
    let mut gateway = homed(&broker, &arguments, "").await;
    let first = broker.until(GRIPS, |_| true).await.json()["seq"].as_i64().unwrap();
    for round in 0..6 {
        match round % 3 {
            // The broker takes records, and is gone before it acknowledges them.
            0 => {
                broker.set(Mood::Unacknowledging);
                gateway.post("move", &json!({"width_mm": 60, "speed_mm_s": 200})).await.outcome("SUCCESS");
                broker.cut();
                broker.set(Mood::Normal);
            }
            // The broker is away.
            1 => {
                broker.set(Mood::Closed);
                broker.cut();
                gateway.post("move", &json!({"width_mm": 50, "speed_mm_s": 200})).await.outcome("SUCCESS");
                broker.set(Mood::Normal);
            }
            _ => {
                gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.outcome("SUCCESS");
                gateway.kill().await;
                gateway = homed(&broker, &arguments, "").await;
            }
        }
        gateway.post("move", &json!({"width_mm": 30 + round, "speed_mm_s": 200})).await.outcome("SUCCESS");
    }
    for (list, filter) in [("grips", "plant/cell/+/grips"), ("events", "plant/cell/#")] {
        let records: BTreeMap<i64, Value> = eventually(list, async || {
            let newest = journal(&gateway, list).await.last()?["seq"].as_i64()?;
            let got = broker.all(filter);
            let got = got.iter().filter(|got| got.topic.ends_with(&format!("/{list}")));
            let got: BTreeMap<i64, Value> = got.map(|got| (got.json()["seq"].as_i64().unwrap(), got.json())).collect();
            got.contains_key(&newest).then_some(got)
        })
        .await;
        let from = if list == "grips" { first } else { *records.keys().next().unwrap() };
        let last = *records.keys().last().unwrap();
        assert_eq!(records.keys().copied().collect::<Vec<_>>(), (from..=last).collect::<Vec<_>>(), "{list}");
    }
    // First appearances are in order.
    let seen = broker.all(GRIPS);
    let firsts = numbers(&seen);
    assert_eq!(firsts, (firsts[0]..=*firsts.last().unwrap()).collect::<Vec<_>>());
}

/// Changes something at the simulated device.
async fn changed(control: &str, change: &Value) {
    let answer = reqwest::Client::new().post(control).json(change).send().await.unwrap();
    assert_eq!(answer.status(), 200, "{}", answer.text().await.unwrap());
}

#[tokio::test]
async fn lost_part_repeats_its_grip_record() {
    let broker = Broker::start().await;
    let (device, control) = Simulator::with_control().await;
    let toml = configuration(&broker, "").replace("sim://wsg50?part_mm=20", &format!("tcp://{}", device.address));
    let gateway = Gateway::with_file(&[], &toml).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    changed(&control, &json!({"place_part": {"width_mm": 20}})).await;
    gateway.post("grip", &json!({"width_mm": 20, "speed_mm_s": 200})).await.outcome("PART_HELD");
    let before = broker.until(GRIPS, |grip| grip.json()["kind"] == "grip").await.json();
    assert_eq!(before["part_lost_at"], Value::Null);
    changed(&control, &json!("take_part")).await;
    let after = broker.until(GRIPS, |grip| grip.json()["part_lost_at"].is_string()).await.json();
    assert_eq!(after["seq"], before["seq"]);
}

#[tokio::test]
async fn long_outage_is_made_up_for_at_a_bounded_rate_while_states_stay_live() {
    let broker = Broker::start().await;
    broker.set(Mood::Closed);
    let gateway = homed(&broker, &[], "max_records_per_s = 20\nstate_interval_ms = 20").await;
    for width in [60, 50, 40, 30] {
        gateway.post("move", &json!({"width_mm": width, "speed_mm_s": 200})).await.outcome("SUCCESS");
    }
    let begin = tokio::time::Instant::now();
    broker.set(Mood::Normal);
    broker.until("plant/cell/g/state", |_| true).await;
    let at_first_state = broker.all("plant/cell/+/events").len();
    let newest = journal(&gateway, "events").await.last().unwrap()["seq"].clone();
    broker.until("plant/cell/+/events", |event| event.json()["seq"] == newest).await;
    let records = broker.all("plant/cell/g/events").len() + broker.all("plant/cell/g/grips").len();
    let earliest = Duration::from_secs(1).mul_f64((records as f64 - 5.0) / 20.0 - 0.3);
    assert!(at_first_state < records && begin.elapsed() >= earliest, "{records} records in {:?}", begin.elapsed());
}

#[tokio::test]
async fn reload_switches_mqtt_on_and_off() {
    let broker = Broker::start().await;
    let off = "[grippers.g]\nurl = \"sim://wsg50\"\n";
    let configured = Configured::start(off).await;
    let on = format!("{off}[mqtt]\nbroker = \"mqtt://{}\"\nprefix = \"plant/cell\"\n", broker.address);
    assert_eq!(configured.reload(&on).await, json!(["mqtt: changed"]));
    broker.until("plant/cell/availability", |got| got.text == "online").await;
    let two = format!("{on}[grippers.h]\nurl = \"sim://wsg50\"\n");
    configured.reload(&two).await;
    broker.until("plant/cell/h/state", |state| state.text != "null").await;
    configured.reload(&on).await;
    broker.until("plant/cell/h/state", |state| state.text.is_empty() && state.is_retained).await;
    configured.reload(off).await;
    broker.until("plant/cell/availability", |got| got.text == "offline").await;
}
