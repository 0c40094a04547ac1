//! Publications have the same bodies as HTTP, and late joiners can query them at once.

use std::collections::BTreeSet;

use serde_json::{Value, json};

use super::Rig;
use crate::harness::eventually;

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
    let fields = ["gripper", "seq", "at", "measured_at", "width_mm", "speed_mm_s", "force_n", "state", "flags_raw"];
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
