//! Wear of the fingers: finger sets, drift of contact widths, and grips on gauges.

use serde_json::{Value, json};

use crate::harness::{Gateway, JournalFile, Simulator, Socket, ZenohClient, eventually};

const FINGER_SET: &str = "finger-set";

/// Limit of drift in these tests, in mm. The default would need twice as many grips.
const LIMIT_MM: f64 = 0.02;

const LEARNED_FROM: usize = 30;

async fn alarms(gateway: &Gateway) -> Vec<Value> {
    gateway.get("/api/v1/alarms").await.ok()["alarms"].as_array().unwrap().clone()
}

/// Waits until an alarm of this kind is listed.
async fn raised(gateway: &Gateway, kind: &str) -> Value {
    let find = async || alarms(gateway).await.into_iter().find(|alarm| alarm["alarm"] == kind);
    eventually(&format!("the alarm {kind}"), find).await
}

fn drift_section() -> String {
    format!("[drift]\nmin_mm = {LIMIT_MM}\n")
}

#[tokio::test]
async fn planted_drift_raises_a_warning_at_the_limit() {
    let (device, url) = Simulator::with_control().await;
    let gripper = format!("g=tcp://{}", device.address);
    let gateway = Gateway::with_file(&["--gripper", &gripper], &drift_section()).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let http = reqwest::Client::new();
    // The grip hardly compresses a stiff part, so that the contact widths spread by less than the limit.
    let mut part_mm = 20.0;
    http.post(&url).json(&json!({"place_part": {"width_mm": part_mm, "stiffness_n_mm": 2000}})).send().await.unwrap();
    gateway.post("move", &json!({"width_mm": 22, "speed_mm_s": 400})).await.outcome("SUCCESS");
    let is_raised = async || alarms(&gateway).await.iter().any(|alarm| alarm["alarm"] == "drift_warning");
    let mut grips = 0;
    while !is_raised().await {
        assert!(grips < 100, "100 grips without a warning");
        http.post(&url).json(&json!({"resize_part": {"width_mm": part_mm}})).send().await.unwrap();
        let grip = json!({"part_id": "A", "width_mm": 20, "speed_mm_s": 200, "force_n": 20});
        gateway.post("grip", &grip).await.outcome("PART_HELD");
        gateway.post("release", &json!({"width_mm": 22, "speed_mm_s": 400})).await.outcome("SUCCESS");
        grips += 1;
        part_mm += if grips > LEARNED_FROM { 0.001 } else { 0.0 };
    }

    // Computed again from the records.
    let list = gateway.get("/api/v1/grips?part_id=A&order=oldest&limit=1000").await.ok();
    let records = list["grips"].as_array().unwrap();
    let widths: Vec<f64> = records.iter().map(|record| record["contact_width_mm"].as_f64().unwrap()).collect();
    let mean = widths[..LEARNED_FROM].iter().sum::<f64>() / LEARNED_FROM as f64;
    let mut average = mean;
    let averages: Vec<f64> = widths[LEARNED_FROM..]
        .iter()
        .map(|width| {
            average += 0.2 * (width - average);
            average
        })
        .collect();
    let crossing = averages.iter().position(|average| average - mean > LIMIT_MM).unwrap();
    let alarm = raised(&gateway, "drift_warning").await;
    assert_eq!((&alarm["gripper"], &alarm["part_id"], &alarm["priority"]), (&json!("g"), &json!("A"), &json!("low")));
    // Conditions are checked every 100 ms, in which the next record can appear.
    let causes = averages[crossing..].iter().map(|average| {
        format!("part A: contact width {average:.3} mm on average, {:+.3} mm from the first 30 grips", average - mean)
    });
    let causes: Vec<_> = causes.take(3).collect();
    assert!(causes.iter().any(|cause| alarm["cause"] == *cause), "{alarm}; expected: {causes:?}");
    assert!(crossing > 15, "{averages:?}");
    let event = &gateway.events("kind=alarm&part_id=A", 1).await[0];
    assert_eq!((&event["event"], &event["alarm"]), (&json!("raised"), &json!("drift_warning")));
}

#[tokio::test]
async fn finger_set_counts_grips_until_its_maintenance() {
    let device = Simulator::with_part().await;
    let journal = JournalFile::new();
    let gripper = format!("g=tcp://{}", device.address);
    let arguments = ["--gripper", &gripper, "--journal", &journal.path()];
    let gateway = Gateway::start(&arguments).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    gateway.post("move", &json!({"width_mm": 30, "speed_mm_s": 400})).await.outcome("SUCCESS");
    let records = async || gateway.get("/api/v1/grips?kind=move").await.ok()["grips"].as_array().unwrap().len();
    eventually("the move is recorded", async || (records().await == 1).then_some(())).await;
    let none = gateway.get(FINGER_SET).await.ok();
    assert_eq!((&none["gripper"], &none["id"], &none["cycles"]), (&json!("g"), &Value::Null, &Value::Null));
    let set = gateway.put(FINGER_SET, &json!({"id": 12, "maintenance_cycles": 2})).await.ok();
    assert_eq!((&set["id"], &set["cycles"], &set["maintenance_due"]), (&json!("12"), &json!(0), &json!(false)));
    for _ in 0..2 {
        gateway.post("grip", &json!({"width_mm": 20, "speed_mm_s": 200})).await.outcome("PART_HELD");
        gateway.post("release", &json!({"width_mm": 30, "speed_mm_s": 400})).await.outcome("SUCCESS");
    }
    let due = raised(&gateway, "maintenance_due").await;
    assert!(due["cause"].as_str().unwrap().starts_with("finger set 12, grips: 2"), "{due}");
    let worn = eventually("all motions are counted", async || {
        let set = gateway.get(FINGER_SET).await.ok();
        // From 30 mm to 20 mm and back, twice. The last samples of a motion can be missing.
        (set["travel_m"].as_f64().unwrap() > 0.038).then_some(set)
    });
    let worn = worn.await;
    assert!(worn["travel_m"].as_f64().unwrap() < 0.042, "{worn}");
    assert_eq!((&worn["cycles"], &worn["maintenance_due"]), (&json!(2), &json!(true)));

    // The record of this grip is written while the gateway ends.
    gateway.post("grip", &json!({"width_mm": 20, "speed_mm_s": 200})).await.outcome("PART_HELD");
    gateway.terminate().await;
    let gateway = Gateway::start(&arguments).await;
    gateway.until_link("connected").await;
    let counted = async || Some(gateway.get(FINGER_SET).await.ok()).filter(|set| set["cycles"] == 3);
    let counted = eventually("the last grip is counted", counted).await;
    assert_eq!((&counted["id"], &counted["mounted_at"]), (&worn["id"], &worn["mounted_at"]));
    assert_eq!(raised(&gateway, "maintenance_due").await["id"], due["id"]);

    let mut socket = Socket::open(&gateway).await;
    let ground = json!({"gripper": "g", "id": "12", "maintenance_cycles": 2, "reset": true});
    assert_eq!(socket.call("finger-set.set", ground).await["cycles"], 0);
    // On a busy machine, the start can leave alarms as well.
    let ended =
        async || Some(alarms(&gateway).await).filter(|all| all.iter().all(|alarm| !alarm["ended_at"].is_null()));
    let ids: Vec<_> = eventually("the alarms end", ended).await.iter().map(|alarm| alarm["id"].clone()).collect();
    assert!(ids.contains(&due["id"]), "{ids:?}");
    gateway.post("/api/v1/alarms/acknowledge", &json!({"ids": ids})).await.ok();
    assert_eq!(alarms(&gateway).await, Vec::<Value>::new());
    let events = gateway.events("kind=settings", 2).await;
    let newest = (&events[0]["setting"], &events[0]["finger_set"], &events[0]["gripper"]);
    assert_eq!(newest, (&json!("finger_set"), &json!("12"), &json!("g")));
}

#[tokio::test]
async fn refused_finger_set_names_the_wrong_field() {
    let gateway = Gateway::start(&[]).await;
    for (body, status, field) in [
        (json!({"id": ""}), 400, "id"),
        (json!({"id": "F".repeat(49)}), 422, "id"),
        (json!({"id": "F", "maintenance_cycles": 0}), 422, "maintenance_cycles"),
        (json!({"id": "F", "maintenance_cycles": 1.5}), 400, "maintenance_cycles"),
        (json!({"id": "F", "maintenance_travel_m": -1}), 422, "maintenance_travel_m"),
        (json!({"id": "F", "cycles": 3}), 400, "cycles"),
        (json!({}), 400, "id"),
    ] {
        let refused = gateway.put("/api/v1/grippers/left/finger-set", &body).await;
        assert_eq!((refused.status, &refused.body["field"]), (status, &json!(field)), "{body}: {}", refused.body);
    }
    assert_eq!(gateway.put("/api/v1/grippers/third/finger-set", &json!({"id": "F"})).await.status, 404);
}

#[tokio::test(flavor = "multi_thread")]
async fn reference_grip_is_recorded_apart_from_parts() {
    let device = Simulator::with_part().await;
    let gateway = Gateway::homed_at(device.address).await;
    let values = json!({"width_mm": 20, "speed_mm_s": 200, "force_n": 20, "reference": true});
    let refused = gateway.post("grip", &values).await;
    assert_eq!((refused.status, &refused.body["field"]), (400, &json!("part_id")));
    let mut of_gauge = values.clone();
    of_gauge["part_id"] = "GAUGE".into();
    let held = gateway.post("grip", &of_gauge).await.outcome("PART_HELD");
    assert_eq!(held["kind"], "reference");
    gateway.post("release", &json!({"width_mm": 30, "speed_mm_s": 400})).await.outcome("SUCCESS");
    let mut of_part = of_gauge.clone();
    of_part["reference"] = false.into();
    gateway.post("grip", &of_part).await.outcome("PART_HELD");
    gateway.post("release", &json!({"width_mm": 30, "speed_mm_s": 400})).await.outcome("SUCCESS");
    let count = async |query: &str| {
        gateway.get(&format!("/api/v1/grips/statistics?part_id=GAUGE{query}")).await.ok()["count"].clone()
    };
    eventually("both records", async || (count("").await == 1).then_some(())).await;
    assert_eq!(count("&kind=reference").await, 1);
    let list = gateway.get("/api/v1/grips?kind=reference").await.ok();
    assert_eq!(list["grips"].as_array().unwrap().len(), 1);
    assert_eq!((&list["grips"][0]["id"], &list["grips"][0]["kind"]), (&held["id"], &json!("reference")));
    let zenoh = ZenohClient::of(&gateway).await;
    let key = "wsg/v1/gateway/command/grips.statistics";
    let asked = zenoh.ask(key, &json!({"part_id": "GAUGE", "kind": "reference"})).await.unwrap();
    assert_eq!(asked["count"], 1, "{asked}");
}
