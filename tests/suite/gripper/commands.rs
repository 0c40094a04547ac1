//! Commands: waited for, polled, repeated, stopped and cancelled; and the device's effect on outcomes.

use std::time::Instant;

use serde_json::{Value, json};

use crate::harness::{Gateway, Proxy, Scripted, Simulator, Table, eventually};

const PENDING: [u8; 2] = [0x1A, 0];

fn slow() -> Value {
    json!({"width_mm": 10, "speed_mm_s": 5})
}

fn quick() -> Value {
    json!({"width_mm": 90, "speed_mm_s": 400})
}

#[tokio::test]
async fn command_without_waiting_returns_its_location() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let accepted = gateway.post("move?wait_ms=0", &quick()).await;
    assert_eq!(accepted.status, 202, "{accepted:?}");
    assert_eq!((accepted.text("phase"), accepted.field("outcome")), ("running".to_owned(), &Value::Null));
    let location = accepted.location.clone().expect("a Location");
    assert_eq!(location, format!("/api/v1/grippers/g/commands/{}", accepted.text("id")));
    let ended = gateway.get(&format!("{location}?wait_ms=20000")).await.outcome("SUCCESS");
    assert_eq!(gateway.get(&location).await.ok(), ended, "the command is kept");
    assert!(ended["duration_ms"].as_u64() > Some(0), "{ended}");
}

#[tokio::test]
async fn repeated_request_id_returns_the_same_command() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let motions = proxy.frames.motions();
    let body = json!({"width_mm": 90, "speed_mm_s": 400, "request_id": "job-1"});
    let first = gateway.post("move", &body).await.outcome("SUCCESS");
    let again = gateway.post("move", &body).await.outcome("SUCCESS");
    assert_eq!((&first["replayed"], &again["replayed"]), (&json!(false), &json!(true)));
    assert_eq!(first["id"], again["id"]);
    let by_header = gateway.request("POST", "move").header("Idempotency-Key", "job-1").json(&quick());
    let again = gateway.send(by_header).await.outcome("SUCCESS");
    assert_eq!((&again["replayed"], &again["id"]), (&json!(true), &first["id"]), "the header is an alias");
    let other = json!({"width_mm": 80, "speed_mm_s": 400, "request_id": "job-1"});
    gateway.post("move", &other).await.problem(409, "request_id_reused");
    assert_eq!(proxy.frames.motions(), motions + 1);
}

#[tokio::test]
async fn repeated_request_joins_the_running_command() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let motions = proxy.frames.motions();
    let body = json!({"width_mm": 60, "speed_mm_s": 50, "request_id": "job-1"});
    let id = gateway.begin("move", &body).await;
    let joined = gateway.post("move?wait_ms=20000", &body).await.outcome("SUCCESS");
    assert_eq!((&joined["id"], &joined["replayed"]), (&json!(id), &json!(true)));
    assert_eq!(proxy.frames.motions(), motions + 1);
}

#[tokio::test]
async fn refused_request_does_not_bind_its_request_id() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    let body = json!({"width_mm": 90, "speed_mm_s": 400, "request_id": "job-1"});
    gateway.post("move", &body).await.problem(409, "not_referenced");
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let moved = gateway.post("move", &body).await.outcome("SUCCESS");
    assert_eq!(moved["replayed"], false);
}

#[tokio::test]
async fn second_motion_is_refused_with_the_running_command() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let running = gateway.begin("move", &slow()).await;
    let refused = gateway.post("move", &quick()).await.problem(409, "already_running");
    assert_eq!(refused["command"], json!(running));
    let state = gateway.state().await;
    assert_eq!((&state["command_id"], &state["command"]), (&json!(running), &json!(running)), "{state}");
}

#[tokio::test]
async fn stop_ends_the_motion_without_a_latch() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let running = gateway.begin("move", &slow()).await;
    gateway.until_moving().await;
    let stopped = gateway.post("stop", &json!({})).await.outcome("SUCCESS");
    assert_eq!(stopped["kind"], "stop", "{stopped}");
    let ended = gateway.command(&running).await.outcome("ABORTED");
    assert_eq!((&ended["status"], ended.get("fast_stop_id")), (&json!("E_CMD_ABORTED"), None), "{ended}");
    gateway.post("move", &quick()).await.outcome("SUCCESS");
}

#[tokio::test]
async fn cancel_aborts_a_running_command_and_keeps_a_finished_one() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let running = gateway.begin("move", &slow()).await;
    gateway.until_moving().await;
    let cancelled = gateway.post(&format!("commands/{running}/cancel"), &json!({})).await.outcome("ABORTED");
    assert_eq!(cancelled["id"], json!(running));
    let moved = gateway.post("move", &quick()).await.outcome("SUCCESS");
    let cancel = format!("commands/{}/cancel", moved["id"].as_str().unwrap());
    assert_eq!(gateway.post(&cancel, &json!({})).await.outcome("SUCCESS"), moved);
    let unknown = "commands/019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f/cancel";
    gateway.post(unknown, &json!({})).await.problem(404, "not_found");
}

#[tokio::test]
async fn relative_move_is_checked_at_its_target() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    gateway.post("move", &quick()).await.outcome("SUCCESS");
    let by = |mm| json!({"width_mm": mm, "speed_mm_s": 400, "relative": true});
    let moved = gateway.post("move", &by(-30)).await.outcome("SUCCESS");
    assert!((moved["width_mm"].as_f64().unwrap() - 60.0).abs() < 0.1, "{moved}");
    let problem = gateway.post("move", &by(60)).await.problem(422, "out_of_range");
    assert!((problem["max"].as_f64().unwrap() - 50.0).abs() < 0.1, "{problem}");
}

#[tokio::test]
async fn device_refusal_is_a_problem_with_its_status() {
    let device = Scripted::start(Table::new()).await;
    let gateway = Gateway::connected_to(device.address).await;
    let refusals = [(10, "E_INSUFFICIENT_RESOURCES", "device_refused"), (3, "E_NOT_INITIALIZED", "not_referenced")];
    for (status, name, code) in refusals {
        device.answer(0x21, vec![vec![status, 0]]);
        let http_status = if code == "device_refused" { 422 } else { 409 };
        let problem = gateway.post("move", &quick()).await.problem(http_status, code);
        assert_eq!((&problem["device_status"], &problem["device_status_code"]), (&json!(name), &json!(status)));
    }
    device.answer(0x21, vec![vec![0x34, 0x12]]);
    let problem = gateway.post("move", &quick()).await.problem(422, "device_refused");
    assert_eq!(problem["device_status_code"], 0x1234, "an unknown status survives as its number: {problem}");
}

#[tokio::test]
async fn final_device_status_is_the_outcome_with_200() {
    let ends = [
        ("move", 0x21, 0, "SUCCESS"),
        ("move", 0x21, 29, "BLOCKED"),
        ("move", 0x21, 19, "ABORTED"),
        ("move", 0x21, 28, "RANGE"),
        ("move", 0x21, 7, "TIMEOUT"),
        ("move", 0x21, 10, "FAILED"),
        ("grip", 0x25, 0, "PART_HELD"),
        ("grip", 0x25, 18, "NO_PART"),
    ];
    let device = Scripted::start(Table::new()).await;
    let gateway = Gateway::connected_to(device.address).await;
    for (kind, id, status, outcome) in ends {
        device.answer(id, vec![PENDING.to_vec(), vec![status, 0]]);
        device.answer(0x41, vec![vec![0, 0, if outcome == "PART_HELD" { 4 } else { 0 }]]);
        let ended = gateway.post(kind, &quick()).await.outcome(outcome);
        assert_eq!(ended["status_code"], status, "{ended}");
    }
}

#[tokio::test]
async fn unanswered_motion_is_unknown_and_not_repeated() {
    let device = Scripted::start(Table::from([(0x21, Vec::new())])).await;
    let gateway = Gateway::connected_to(device.address).await;
    gateway.post("move?wait_ms=20000", &quick()).await.outcome("UNKNOWN");
    assert_eq!(device.frames.motions(), 1);
}

#[tokio::test]
async fn flood_of_stops_leaves_the_holder_its_motion_and_its_stop() {
    // The device answers no Stop, so each takes a second and they pile up.
    let device = Scripted::start(Table::from([(0x21, vec![PENDING.to_vec()]), (0x22, Vec::new())])).await;
    let gateway = Gateway::connected_to(device.address).await;
    let lease = gateway.post("lease", &json!({"holder": "robot", "ttl_ms": 20_000})).await.text("token");
    let flood = async |name: &str| {
        let bodies: Vec<_> = (0..200).map(|number| json!({"request_id": format!("{name} {number}")})).collect();
        let stops = bodies.iter().map(|body| gateway.post("stop?wait_ms=0", body));
        futures_util::future::join_all(stops).await
    };
    assert!(flood("first").await.iter().all(|stop| stop.status < 300), "no Stop is refused");
    let body = json!({"width_mm": 10, "speed_mm_s": 5, "request_id": "move"});
    let motion = gateway.request("POST", "move?wait_ms=0").header("Wsg-Lease", &lease).json(&body);
    let motion = gateway.send(motion).await;
    assert_eq!(motion.status, 202, "{motion:?}");
    let began = Instant::now();
    assert!(flood("second").await.iter().all(|stop| stop.status < 300), "no Stop is refused");
    let stop = gateway.request("POST", "stop?wait_ms=0").header("Wsg-Lease", &lease);
    let stop = gateway.send(stop.json(&json!({"request_id": "stop"}))).await;
    assert!(stop.status < 300, "{stop:?}");
    eventually("22h", async || device.frames.first_since(0x22, began)).await;
}
