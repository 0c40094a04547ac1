//! Servo sessions: targets over WebSocket, Zenoh and HTTP, and what ends a session.

use serde_json::{Value, json};

use crate::harness::{Gateway, Simulator, Socket, ZenohClient, eventually};

async fn homed() -> (Simulator, Gateway) {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    (device, gateway)
}

/// A notification, which gets no answer.
fn target(width_mm: f64) -> String {
    let params = json!({"gripper": "g", "width_mm": width_mm});
    json!({"jsonrpc": "2.0", "method": "servo.target", "params": params}).to_string()
}

async fn ended(gateway: &Gateway) -> Value {
    let session = async || {
        let session = gateway.get("servo").await.ok();
        (session["open"] == false).then_some(session)
    };
    eventually("the session has ended", session).await
}

#[tokio::test]
async fn silent_client_on_an_open_websocket_stops_the_fingers() {
    let (_device, gateway) = homed().await;
    let mut socket = Socket::open(&gateway).await;
    let session = socket.call("servo.start", json!({"gripper": "g", "max_speed_mm_s": 10})).await;
    assert_eq!((&session["open"], &session["adapter"]), (&json!(true), &json!("moves")));
    socket.send(target(5.0)).await;
    gateway.until_moving().await;
    let session = ended(&gateway).await;
    assert_eq!((&session["ended"], &session["accepted"]), (&json!("silence"), &json!(1)), "{session}");
    let state = gateway.until_standing().await;
    assert!(state["width_mm"].as_f64().unwrap() > 50.0, "{state}");
    let refused = socket.refused("servo.target", json!({"gripper": "g", "width_mm": 5})).await;
    assert_eq!(refused["data"]["code"], "no_servo", "{refused}");
    let events = gateway.events("kind=device", 2).await;
    let events: Vec<_> = events.iter().filter(|event| event["event"] == "servo_ended").collect();
    assert_eq!((events.len(), &events[0]["reason"]), (1, &json!("silence")));
}

#[tokio::test]
async fn telemetry_tells_which_target_the_device_has() {
    let (_device, gateway) = homed().await;
    let mut socket = Socket::open(&gateway).await;
    socket.call("subscribe", json!({"topics": ["telemetry"]})).await;
    socket.call("servo.start", json!({"gripper": "g"})).await;
    for width_mm in [90.0, 80.0] {
        socket.send(target(width_mm)).await;
    }
    let told = socket.notification("telemetry", |values| values["servo"]["target_mm"] == 80.0).await;
    assert_eq!(told["servo"]["refused"], 0);
    let session = socket.call("servo.stop", json!({"gripper": "g"})).await;
    assert_eq!((&session["ended"], &session["open"]), (&json!("ended"), &json!(false)));
    socket.notification("telemetry", |values| values.get("servo").is_none()).await;
}

#[tokio::test]
async fn stop_of_another_client_ends_the_session() {
    let (_device, gateway) = homed().await;
    let mut socket = Socket::open(&gateway).await;
    socket.call("servo.start", json!({"gripper": "g", "timeout_ms": 10_000, "max_speed_mm_s": 10})).await;
    socket.send(target(5.0)).await;
    gateway.until_moving().await;
    gateway.post("move", &json!({"width_mm": 50, "speed_mm_s": 50})).await.problem(409, "already_running");
    gateway.post("stop", &json!({})).await.outcome("SUCCESS");
    let refused = socket.refused("servo.target", json!({"gripper": "g", "width_mm": 5})).await;
    assert!(refused["message"].as_str().unwrap().contains("`stop`"), "{refused}");
    gateway.until_standing().await;
}

#[tokio::test]
async fn refused_targets_are_counted() {
    let (_device, gateway) = homed().await;
    gateway.post("servo/start", &json!({"timeout_ms": 10_000})).await.ok();
    gateway.post("servo/target", &json!({"width_mm": 500})).await.problem(422, "out_of_range");
    let series = json!({"widths_mm": [50, 60], "dt_ms": 20});
    let problem = gateway.post("servo/follow", &series).await.problem(422, "out_of_range");
    assert_eq!(problem["field"], "widths_mm", "faster than max_speed_mm_s");
    gateway.post("servo/follow", &json!({"widths_mm": [], "dt_ms": 20})).await.problem(400, "malformed");
    let long = json!({"widths_mm": vec![50; 256], "dt_ms": 50});
    assert_eq!(gateway.post("servo/follow", &long).await.problem(422, "out_of_range")["max"], 39.0);
    let old = json!({"width_mm": 50, "at": "2020-01-01T00:00:00Z"});
    gateway.post("servo/target", &old).await.problem(409, "stale_target");
    let session = gateway.post("servo/stop", &json!({})).await.ok();
    assert_eq!((&session["accepted"], &session["refused"]), (&json!(0), &json!(3)));
}

#[tokio::test(flavor = "multi_thread")]
async fn put_over_zenoh_is_a_target() {
    let (_device, gateway) = homed().await;
    let client = ZenohClient::of(&gateway).await;
    client.command("servo.start?client=arm", &json!({"timeout_ms": 2000})).await.unwrap();
    let key = "wsg/v1/gateway/g/command/servo.target";
    client.put(key, json!({"width_mm": 60, "client": "another"}).to_string()).await;
    client.put(key, json!({"width_mm": 70, "client": "arm"}).to_string()).await;
    gateway
        .until("the fingers are at 70 mm", |state| {
            state["width_mm"].as_f64().is_some_and(|width_mm| (width_mm - 70.0).abs() < 0.5)
        })
        .await;
    assert_eq!(ended(&gateway).await["accepted"], 1, "only the target of the client that steers");
}
