//! FAST STOP: it overtakes motions, latches, and ends only with an acknowledge of its id.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::{SignedDuration, Timestamp};
use prometheus::Registry;
use serde_json::{Value, json};
use wsg_gateway::gripper::actor::ActorConfig;
use wsg_gateway::gripper::recorder::RestoredState;
use wsg_gateway::gripper::{self, GripperMetrics, Handle, NullRecorder};
use wsg_gateway::model::{Client, Door, FastStopId, GripperRules, IdSource, Link, Name, Reason, State};
use wsg_gateway::transport::Address;

use crate::harness::{Gateway, Proxy, Scripted, Simulator, Table, shortest, success};

const REFERENCED: u32 = 1;
const FAST_STOP: u32 = 1 << 12;
const TEMP_FAULT: u32 = 1 << 14;

fn a_move() -> Value {
    json!({"width_mm": 40, "speed_mm_s": 200})
}

#[tokio::test]
async fn fast_stop_aborts_a_motion_and_latches_until_acknowledged() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let command = gateway.begin("move", &json!({"width_mm": 10, "speed_mm_s": 5})).await;
    gateway.until_moving().await;
    let stopped = gateway.post("fast-stop", &json!({"reason": "light curtain"})).await.ok();
    assert_eq!(stopped["fast_stop_confirmed"], true, "{stopped}");
    let id = &stopped["fast_stop_id"];
    let ended = gateway.command(command.as_str()).await.outcome("ABORTED");
    assert_eq!(&ended["fast_stop_id"], id, "{ended}");

    let state = gateway.state().await;
    assert_eq!((&state["fast_stop"], &state["fast_stop_id"]), (&json!(true), id), "{state}");
    assert_eq!((&state["fast_stop_by"], &state["fast_stop_cause"]), (&json!("http:127.0.0.1"), &json!("requested")));
    assert_eq!(state["fast_stop_reason"], "light curtain", "{state}");
    let motions = proxy.frames.motions();
    let refused = gateway.post("move", &a_move()).await.problem(409, "fast_stop");
    assert_eq!(&refused["fast_stop_id"], id);
    gateway.post("home", &json!({})).await.problem(409, "fast_stop");

    let other = json!({"fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f"});
    let refused = gateway.post("acknowledge", &other).await.problem(409, "stale_fast_stop");
    assert_eq!(&refused["fast_stop_id"], id, "the problem names the current latch");
    assert_eq!((proxy.frames.motions(), proxy.frames.count(0x24)), (motions, 0));

    let acknowledged = gateway.post("acknowledge", &json!({"fast_stop_id": id})).await.ok();
    assert_eq!(acknowledged["fast_stop"], false);
    let state = gateway.state().await;
    assert_eq!((&state["fast_stop"], state.get("fast_stop_id")), (&json!(false), None), "{state}");
    gateway.post("move", &a_move()).await.outcome("SUCCESS");
    gateway.post("acknowledge", &json!({"fast_stop_id": id})).await.problem(409, "stale_fast_stop");
}

#[tokio::test]
async fn second_fast_stop_needs_its_own_acknowledge() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let first = gateway.post("fast-stop", &json!({})).await.ok();
    let second = gateway.post("fast-stop", &json!({})).await.ok();
    assert_ne!(first["fast_stop_id"], second["fast_stop_id"]);
    let acknowledge = |stop: &Value| json!({"fast_stop_id": stop["fast_stop_id"]});
    gateway.post("acknowledge", &acknowledge(&first)).await.problem(409, "stale_fast_stop");
    gateway.post("acknowledge", &acknowledge(&second)).await.ok();
}

#[tokio::test]
async fn fast_stop_accepts_any_body() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    for body in ["", "{", "[]", "null", "{\"reason\": 7}", "{\"nonsense\": true}", &"x".repeat(100_000)] {
        let answer = gateway.send(gateway.request("POST", "fast-stop").body(body.to_owned())).await.ok();
        assert_eq!(answer["fast_stop_confirmed"], true, "{answer}");
        gateway.post("acknowledge", &json!({"fast_stop_id": answer["fast_stop_id"]})).await.ok();
    }
}

#[tokio::test]
async fn device_fast_stop_latches_while_its_cause_persists() {
    let device = Scripted::start(Table::new()).await;
    let gateway = Gateway::connected_to(device.address).await;
    let state = gateway.state().await;
    assert_eq!(state["fast_stop"], false, "{state}");
    device.flags(REFERENCED | FAST_STOP | TEMP_FAULT);
    let state = gateway.until("the FAST STOP is reported", |state| state["fast_stop"] == true).await;
    assert_eq!((&state["fast_stop_by"], &state["fast_stop_cause"]), (&json!("device"), &json!("temperature_fault")));
    assert_eq!(state["fast_stop_confirmed"], true, "{state}");
    let acknowledge = json!({"fast_stop_id": state["fast_stop_id"]});
    gateway.post("move", &a_move()).await.problem(409, "fast_stop");
    let persists = gateway.post("acknowledge", &acknowledge).await.problem(409, "fast_stop");
    assert!(persists["detail"].as_str().unwrap().contains("TEMP_FAULT"), "{persists}");

    device.flags(REFERENCED);
    gateway.until("the device forgot", |state| state["flags_raw"] == REFERENCED).await;
    gateway.post("move", &a_move()).await.problem(409, "fast_stop");
    gateway.post("acknowledge", &acknowledge).await.ok();
    assert_eq!(device.frames.motions(), 0);
}

#[tokio::test]
async fn fast_stop_on_a_lost_link_is_sent_first_after_reconnect() {
    let device = Simulator::start(&[]).await;
    let mut proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    proxy.go_away().await;
    gateway.until_link("reconnecting").await;
    let before = proxy.frames.len();
    let (limit, mut stopped) = (Duration::from_millis(750), Value::Null);
    let answered_after = shortest(limit, async || {
        let asked_at = Instant::now();
        stopped = gateway.post("fast-stop", &json!({"reason": "gone"})).await.ok();
        asked_at.elapsed()
    })
    .await;
    assert_eq!(stopped["fast_stop_confirmed"], false, "{stopped}");
    assert!(answered_after <= limit, "{answered_after:?}");
    let state = gateway.state().await;
    assert_eq!((&state["fast_stop"], &state["fast_stop_confirmed"]), (&json!(true), &json!(false)), "{state}");
    let id = &stopped["fast_stop_id"];
    let acknowledge = json!({"fast_stop_id": id});
    gateway.post("acknowledge", &acknowledge).await.problem(409, "fast_stop_unconfirmed");

    proxy.accept();
    let state = gateway.until("the FAST STOP is confirmed", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!((&state["fast_stop_id"], &state["fast_stop_cause"]), (id, &json!("requested")), "{state}");
    assert_eq!(proxy.frames.since(before)[0].id, 0x23, "{:?}", proxy.frames.since(before));
    gateway.until_link("connected").await;
    gateway.post("acknowledge", &acknowledge).await.ok();
}

#[tokio::test]
async fn unanswered_fast_stop_is_repeated() {
    let device = Scripted::start(Table::from([(0x23, Vec::new())])).await;
    let gateway = Gateway::connected_to(device.address).await;
    let stopped = gateway.post("fast-stop", &json!({})).await.ok();
    assert_eq!(stopped["fast_stop_confirmed"], false, "{stopped}");
    crate::harness::eventually("the FAST STOP is repeated", async || (device.frames.count(0x23) >= 3).then_some(()))
        .await;
    device.flags(REFERENCED | FAST_STOP);
    device.answer(0x23, vec![crate::harness::success(&[])]);
    gateway.until("the FAST STOP is confirmed", |state| state["fast_stop_confirmed"] == true).await;
}

/// Starts a gripper for this device, with state from an earlier run of the gateway.
fn spawned(device: SocketAddr, restored: RestoredState) -> Handle {
    let address: Address = format!("tcp://{device}").parse().unwrap();
    let name: Name = "g".parse().unwrap();
    let config = ActorConfig {
        gateway: "gateway".parse().unwrap(),
        name: name.clone(),
        url: address.to_string(),
        properties: address.properties(),
        rules: GripperRules::default(),
        seed: 1,
        metrics: GripperMetrics::register(&Registry::new(), &name).unwrap(),
    };
    gripper::spawn(config, Arc::new(address), Arc::new(NullRecorder), restored)
}

#[tokio::test]
async fn clock_set_back_does_not_confirm_a_fast_stop() {
    const UPDATES: [u8; 5] = [0x40, 0x41, 0x43, 0x44, 0x45];
    let device = Scripted::start(Table::from([(0x40, vec![success(&(REFERENCED | FAST_STOP).to_le_bytes())])])).await;
    // A latch from an earlier version without epochs, from a clock that was a day ahead.
    let ahead = Timestamp::now() + SignedDuration::from_hours(24);
    let id = IdSource::new(1).fast_stop_id(ahead);
    let latch = json!({"id": id, "by": "test", "cause": "requested", "reason": "", "at": ahead, "confirmed": true});
    let handle = spawned(device.address, RestoredState { latch: Some(latch.to_string()), ..RestoredState::default() });
    let confirmed = |state: &Arc<State>| state.latch.as_ref().is_some_and(|latch| latch.fast_stop_confirmed);
    let restored = handle.states().wait_for(confirmed).await.unwrap().latch.clone().unwrap();
    assert_eq!(restored.fast_stop_id, id);
    let stop = async || {
        let client = Client::new("test", Door::Http);
        handle.fast_stop(FastStopId::generate(), client, Reason::truncated("")).await
    };
    for id in UPDATES.into_iter().chain([0x06, 0x23]) {
        device.answer(id, Vec::new());
    }
    handle.states().wait_for(|state| state.link == Link::Unresponsive).await.unwrap();
    let unheard = stop().await;
    assert!(!unheard.confirmed, "the device is frozen");
    assert_eq!(handle.state().latch.as_ref().unwrap().fast_stop_id, unheard.id);
    device.flags(REFERENCED | FAST_STOP);
    let heard = stop().await;
    assert!(heard.confirmed, "confirmed by the flags");
    assert!(handle.state().latch.as_ref().unwrap().epoch > restored.epoch);
}
