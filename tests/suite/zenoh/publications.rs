//! Publications have the same bodies as HTTP, and late joiners can query them at once.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use zenoh::qos::{CongestionControl, Priority};

use super::Rig;
use crate::harness::{Gateway, Simulator, ZenohClient, eventually};

fn keys(body: &Value) -> BTreeSet<String> {
    body.as_object().unwrap_or_else(|| panic!("not an object: {body}")).keys().cloned().collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn states_telemetry_and_events_have_the_bodies_of_http() {
    let rig = Rig::start(&["--part-mm", "20"]).await;
    let received = rig.client.subscribe("wsg/v1/gateway/**").await;
    received.until("wsg/v1/gateway/g/state", |_| true).await;
    rig.gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let grip = json!({"width_mm": 20, "speed_mm_s": 400});
    rig.gateway.post("grip", &grip).await.outcome("PART_HELD");

    let state = received.until("wsg/v1/gateway/g/state", |state| state["state"] == "HOLDING").await;
    assert_eq!(keys(&state), keys(&rig.gateway.state().await));
    let telemetry = received.until("wsg/v1/gateway/g/telemetry", |received| received["state"] == "HOLDING").await;
    let fields = ["gripper", "seq", "at", "width_mm", "speed_mm_s", "force_n", "state", "flags_raw"];
    assert_eq!(keys(&telemetry), fields.map(str::to_owned).into());

    let is_done = |event: &Value| event["kind"] == "command" && event["outcome"] == "PART_HELD";
    let events = eventually("all events", async || {
        let events = received.of("wsg/v1/gateway/g/event");
        events.iter().any(is_done).then_some(events)
    })
    .await;
    let stored = rig.gateway.get("/api/v1/events?gripper=g&order=oldest&limit=500").await.ok();
    let stored = stored["events"].as_array().unwrap();
    let first = stored.iter().position(|event| *event == events[0]).expect("the event is stored");
    assert_eq!(stored[first..first + events.len()], events, "each event once and in order");
}

#[tokio::test(flavor = "multi_thread")]
async fn late_joiner_queries_everything() {
    let rig = Rig::start(&[]).await;
    let info = rig.client.ask("wsg/v1/gateway/g/info", &Value::Null).await.unwrap();
    assert_eq!(info, rig.gateway.get("/api/v1/grippers/g").await.ok());
    let state = rig.client.ask("wsg/v1/*/*/state", &Value::Null).await.unwrap();
    assert_eq!((&state["gripper"], &state["link"]), (&json!("g"), &json!("connected")));
    assert_eq!(keys(&state), keys(&rig.gateway.state().await));
}

#[tokio::test(flavor = "multi_thread")]
async fn liveliness_follows_the_link_and_the_gateway() {
    let rig = Rig::start(&[]).await;
    let tokens = rig.client.tokens("wsg/v1/**").await;
    tokens.until("wsg/v1/gateway/g/alive", |body| *body == "").await;
    tokens.until("wsg/v1/gateway/alive", |body| *body == "").await;
    drop(rig.proxy);
    tokens.until("wsg/v1/gateway/g/alive", Value::is_null).await;
    assert_eq!(tokens.of("wsg/v1/gateway/alive"), [""]);
    rig.gateway.terminate().await;
    tokens.until("wsg/v1/gateway/alive", Value::is_null).await;
}

/// A client that stops reading, with its buffers filled by a flood of other messages.
async fn stalled(endpoint: &str) -> (ZenohClient, std::sync::mpsc::Sender<()>) {
    let client = ZenohClient::at(&format!("{endpoint}#so_rcvbuf=4096")).await;
    let (resume, resumed) = std::sync::mpsc::channel();
    let (resumed, (stalls, mut has_stalled)) = (std::sync::Mutex::new(resumed), tokio::sync::mpsc::channel(1));
    let wait = move |_| {
        let _ = stalls.try_send(());
        // Zenoh's threads also serve the clients of other tests.
        let _ = tokio::task::block_in_place(|| resumed.lock().unwrap().recv());
    };
    client.session.declare_subscriber("wsg/v1/**").callback(wait).background().await.unwrap();
    has_stalled.recv().await.unwrap();
    let flood = ZenohClient::at(endpoint).await;
    for _ in 0..2000 {
        let put = flood.session.put("wsg/v1/flood", vec![0; 1000]).priority(Priority::DataHigh);
        put.congestion_control(CongestionControl::Drop).await.unwrap();
    }
    (client, resume)
}

#[tokio::test(flavor = "multi_thread")]
async fn stalled_client_delays_no_one() {
    let device = Simulator::start(&[]).await;
    let gripper = format!("g=tcp://{}", device.address);
    let gateway = Gateway::start(&["--gripper", &gripper, "--zenoh-listen", "tcp/127.0.0.1:0#so_sndbuf=4096"]).await;
    gateway.until_link("connected").await;
    let endpoint = gateway.word_after("Zenoh: ").await;
    let client = ZenohClient::at(&endpoint).await;
    let received = client.subscribe("wsg/v1/gateway/g/*").await;
    let (_stalled, _resume) = stalled(&endpoint).await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    for round in 0..5 {
        let width_mm = if round % 2 == 0 { 50 } else { 60 };
        let answer = client.command("move", &json!({"width_mm": width_mm, "speed_mm_s": 400})).await.unwrap();
        assert_eq!(answer["outcome"], "SUCCESS", "{answer}");
    }
    client.put("wsg/v1/fast-stop", "now").await;
    gateway.until("the gripper stops", |state| state["fast_stop_confirmed"] == true).await;
    let is_done = |event: &&Value| event["kind"] == "command" && event["phase"] == "done";
    eventually("the ends of all commands", async || {
        (received.of("wsg/v1/gateway/g/event").iter().filter(is_done).count() == 6).then_some(())
    })
    .await;
}
