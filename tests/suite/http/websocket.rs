//! WebSocket: requests and answers, updates, and slow or lost clients.

use std::collections::BTreeSet;

use serde_json::{Value, json};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_tungstenite::tungstenite::Error;
use tokio_tungstenite::tungstenite::http::HeaderValue;

use crate::harness::{Gateway, Process, Proxy, Simulator, Socket, eventually, run, socket_request};

async fn connected() -> (Simulator, Gateway) {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    (device, gateway)
}

#[tokio::test]
async fn command_is_answered_on_admission_and_notified_at_its_end() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    let running = socket.call("home", json!({"gripper": "g"})).await;
    assert_eq!((&running["phase"], &running["kind"]), (&json!("running"), &json!("home")));
    assert_eq!(running["client"], "ws:127.0.0.1");
    let done = socket.notification("command", |_| true).await;
    assert_eq!((&done["id"], &done["outcome"]), (&running["id"], &json!("SUCCESS")), "{done}");
    let again = socket.call("command", json!({"gripper": "g", "command": running["id"]})).await;
    assert_eq!(again, done);
    let recorded = gateway.events("kind=command", 2).await;
    assert!(recorded.iter().all(|event| event["door"] == "ws"), "{recorded:?}");
}

/// A state without its age, which differs between two messages with the same state.
fn without_age(state: &Value) -> Value {
    let mut state = state.clone();
    state.as_object_mut().unwrap().remove("age_ms");
    state.as_object_mut().unwrap().remove("measured_at");
    state
}

#[tokio::test]
async fn subscription_starts_with_states_and_continues_with_changes() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    let subscription =
        socket.call("subscribe", json!({"topics": ["state", "telemetry", "events"], "max_hz": 50})).await;
    assert_eq!(
        (&subscription["max_hz"], &subscription["states"][0]["gripper"]),
        (&json!(50), &json!("g")),
        "{subscription}"
    );
    let mut last = without_age(&subscription["states"][0]);
    let (mut repeats, begun) = (0, std::time::Instant::now());
    let mut event_seq = subscription["event_seq"].as_i64().unwrap();
    socket.call("home", json!({"gripper": "g"})).await;
    let (mut has_moved, mut telemetry, mut has_ended, mut has_notification) = (false, 0, false, false);
    while !(has_moved && telemetry > 3 && has_ended && has_notification) {
        let message = socket.next().await.expect("an update");
        let body = &message["params"];
        match message["method"].as_str().unwrap() {
            "state" => {
                let state = without_age(body);
                if state["seq"] == last["seq"] {
                    // The same number stands for the same state, which is repeated every second.
                    assert_eq!(state, last);
                    repeats += 1;
                } else {
                    assert!(state["seq"].as_u64() > last["seq"].as_u64(), "{state} after {last}");
                }
                last = state;
                has_moved |= body["moving"] == true;
            }
            "telemetry" => telemetry += 1,
            "event" => {
                assert_eq!(body["seq"].as_i64(), Some(event_seq + 1), "{body}");
                event_seq += 1;
                has_ended |= body["kind"] == "command" && body["phase"] == "done";
            }
            "command" => has_notification = true,
            other => panic!("{other}"),
        }
    }
    assert!(repeats <= begun.elapsed().as_secs() + 1, "{repeats} repeated states");
    socket.call("subscribe", json!({"topics": []})).await;
    socket.drop_queued();
    assert!(socket.is_silent_for(std::time::Duration::from_millis(300)).await);
}

#[tokio::test]
async fn events_continue_when_a_socket_subscribes_again() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    let subscribe = json!({"topics": ["events"]});
    let first = socket.call("subscribe", subscribe.clone()).await["event_seq"].as_i64().unwrap();
    let mut last = first;
    for _ in 0..30 {
        let mut open = BTreeSet::new();
        for _ in 0..8 {
            open.insert(socket.begin("lease.take", json!({"gripper": "g", "force": true})).await);
            open.insert(socket.begin("subscribe", subscribe.clone()).await);
        }
        while !open.is_empty() {
            let message = socket.next().await.expect("a message");
            let update = &message["params"];
            if message["method"] == "event" {
                assert_eq!(update["seq"].as_i64(), Some(last + 1), "{message}");
                last += 1;
            } else if message["method"] == "gap" {
                // An event becomes durable a moment before it is sent.
                assert_eq!(update["seq"].as_i64(), Some(last), "{message}");
                last += update["missed"].as_i64().unwrap();
            } else {
                open.remove(&message["id"].as_u64().unwrap());
                let event_seq = message["result"]["event_seq"].as_i64();
                assert!(event_seq.is_none_or(|seq| seq <= last), "{message} after event {last}");
            }
        }
    }
    assert!(last > first + 100, "{last} after {first}");
}

#[tokio::test]
async fn wrong_request_is_a_json_rpc_error_with_the_problem() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    let grip = |width: Value| json!({"gripper": "g", "width_mm": width, "speed_mm_s": 50});
    for (method, params, code, problem, field) in [
        ("leap", json!({}), -32601, "not_found", None),
        ("grip", json!({"gripper": "g", "width_mm": 20}), -32602, "malformed", Some("speed_mm_s")),
        ("grip", json!({"gripper": "g", "widht_mm": 20}), -32602, "malformed", Some("widht_mm")),
        ("grip", json!(["g", 20, 50]), -32602, "malformed", Some("params")),
        ("subscribe", json!({"topics": ["states"]}), -32602, "malformed", Some("topics[0]")),
        ("subscribe", json!({"topics": [], "max_hz": 1.5}), -32602, "malformed", Some("max_hz")),
        ("subscribe", json!({"topics": [], "grippers": ["h"]}), -32602, "not_found", Some("grippers")),
        ("state", json!({"gripper": "h"}), -32602, "not_found", Some("gripper")),
        ("grip", grip(json!(5000)), -32602, "out_of_range", Some("width_mm")),
        ("grip", grip(json!(20)), -32000, "not_referenced", None),
    ] {
        let error = socket.refused(method, params.clone()).await;
        assert_eq!((&error["code"], &error["data"]["code"]), (&json!(code), &json!(problem)), "{method} {params}");
        assert_eq!(error["data"]["field"].as_str(), field, "{method} {params}: {error}");
        assert_eq!(error["message"], error["data"]["detail"]);
    }
    for (text, code) in [("{\"jsonrpc\":", -32700), ("[]", -32600), ("{\"id\": 1}", -32600)] {
        socket.send(text).await;
        assert_eq!(socket.next().await.unwrap()["error"]["code"], code, "{text}");
    }
}

#[tokio::test]
async fn batch_gets_one_answer_and_a_notification_none() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    let batch = json!([
        {"jsonrpc": "2.0", "id": "a", "method": "state", "params": {"gripper": "g"}},
        {"jsonrpc": "2.0", "method": "home", "params": {"gripper": "g"}},
        {"jsonrpc": "2.0", "id": 2, "method": "leap"},
        7,
    ]);
    socket.send(batch.to_string()).await;
    let answer = socket.next().await.unwrap();
    let ids: Vec<_> = answer.as_array().unwrap().iter().map(|answer| answer["id"].clone()).collect();
    assert_eq!(ids, [json!("a"), json!(2), Value::Null]);
    assert_eq!(answer[2]["error"]["code"], -32600);
    gateway.until("the gripper is homed", |state| state["referenced"] == true).await;
    socket.send(json!([{"jsonrpc": "2.0", "method": "stop", "params": {"gripper": "g"}}]).to_string()).await;
    let id = socket.begin("grippers", json!({})).await;
    assert_eq!(socket.next().await.unwrap()["id"], id, "a JSON-RPC notification gets no answer");
}

#[tokio::test]
async fn fast_stop_accepts_malformed_requests() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    let stopped = socket.call("fast-stop", json!({"gripper": "g", "reason": "test"})).await;
    assert_eq!(stopped["fast_stop_confirmed"], true);
    let acknowledge = json!({"gripper": "g", "fast_stop_id": stopped["fast_stop_id"]});
    assert_eq!(socket.call("acknowledge", acknowledge).await["fast_stop"], false);
    let nested = format!(r#"{}{{"method": "fast-stop"}}"#, "[".repeat(200));
    for text in [
        r#"{"id": {}, "method": "fast-stop", "params": "now"}"#,
        r#"{"jsonrpc": "2.0", "method": "fast-stop", "params": {"gripper": "G", "reason": "hand"}}"#,
        r#"{"jsonrpc": "2.0", "method": "fast-stop", "params": {"gripper": null}}"#,
        r#"{"jsonrpc": "2.0", "method": "fast-stop", "params": {"gripper": "g"}}}"#,
        &nested,
    ] {
        socket.send(text).await;
        let stopped = |state: &Value| state["fast_stop_confirmed"] == true;
        let state = gateway.until("the gripper is stopped", stopped).await;
        assert_eq!(state["fast_stop_by"], "ws:127.0.0.1");
        assert_eq!(state["fast_stop_reason"] == "hand", text.contains("hand"), "{state}");
        let acknowledge = json!({"gripper": "g", "fast_stop_id": state["fast_stop_id"]});
        assert_eq!(socket.call("acknowledge", acknowledge).await["fast_stop"], false, "{text}");
    }
}

#[tokio::test]
async fn fast_stop_passes_unread_answers() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    for _ in 0..400 {
        socket.begin("info", json!({"gripper": "g"})).await;
    }
    socket.begin("fast-stop", json!({"gripper": "g"})).await;
    gateway.until("the gripper is stopped", |state| state["fast_stop_confirmed"] == true).await;
}

#[tokio::test]
async fn slow_reader_that_answers_pings_stays_open() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let mut socket = Socket::open(&gateway).await;
    // The width changes with each update, for longer than this test takes.
    gateway.post("move?wait_ms=0", &json!({"width_mm": 5, "speed_mm_s": 5})).await;
    let topics = json!({"topics": ["state", "telemetry", "frames"], "max_hz": 100});
    socket.call("subscribe", topics).await;
    // The client reads less than a tenth of the frames, for longer than the ping time-out.
    let begun = std::time::Instant::now();
    let mut between = tokio::time::interval(std::time::Duration::from_millis(30));
    while begun.elapsed() < std::time::Duration::from_millis(4500) {
        between.tick().await;
        socket.read().await.expect("the socket stays open");
    }
}

#[tokio::test]
async fn duplicate_field_is_refused() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    let params = r#"{"gripper": "g", "width_mm": 50, "width_mm": 60, "speed_mm_s": 50}"#;
    socket.send(format!(r#"{{"jsonrpc": "2.0", "id": 1, "method": "move", "params": {params}}}"#)).await;
    let error = socket.next().await.unwrap()["error"].take();
    assert!(error["message"].as_str().unwrap().contains("width_mm is given more than once"), "{error}");
}

#[tokio::test]
async fn lease_taken_by_a_notification_is_ignored() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    socket.send(r#"{"jsonrpc": "2.0", "method": "lease.take", "params": {"gripper": "g"}}"#).await;
    socket.call("lease.take", json!({"gripper": "g", "holder": "a"})).await;
    assert_eq!(gateway.state().await["lease_epoch"], 1);
}

#[tokio::test]
async fn foreign_origin_or_other_subprotocol_is_refused() {
    let (_device, gateway) = connected().await;
    let with = |name: &'static str, value: &'static str| {
        let mut request = socket_request(&gateway);
        request.headers_mut().insert(name, HeaderValue::from_static(value));
        request
    };
    let cases = [
        (with("Sec-WebSocket-Protocol", "mqtt"), 400),
        (with("Origin", "http://evil.example"), 403),
        (with("Host", "evil.example"), 403),
    ];
    for (request, expected) in cases {
        let Err(Error::Http(response)) = Socket::with(request).await else { panic!("a socket") };
        assert_eq!(response.status(), expected);
    }
    gateway.get("/api/v1/ws").await.problem(400, "malformed");
    let mut both = socket_request(&gateway);
    both.headers_mut().insert("Sec-WebSocket-Protocol", HeaderValue::from_static("mqtt, wsg.v1"));
    let mut socket = Socket::with(both).await.unwrap();
    socket.call("grippers", json!({})).await;
}

#[tokio::test]
async fn unanswered_pings_close_the_socket() {
    let (_device, gateway) = connected().await;
    let mut lively = Socket::open(&gateway).await;
    let address = gateway.url("/").trim_start_matches("http://").trim_end_matches('/').to_owned();
    let mut dead = TcpStream::connect(&address).await.unwrap();
    let head = format!(
        "GET /api/v1/ws HTTP/1.1\r\nHost: {address}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\
         Sec-WebSocket-Protocol: wsg.v1\r\n\r\n"
    );
    dead.write_all(head.as_bytes()).await.unwrap();
    let mut bytes = Vec::new();
    let reading = dead.read_to_end(&mut bytes);
    tokio::select! {
        end = tokio::time::timeout(crate::harness::DEADLINE, reading) => drop(end.expect("a close").unwrap()),
        message = lively.next() => panic!("{message:?}"),
    }
    let text = String::from_utf8_lossy(&bytes);
    assert!(text.starts_with("HTTP/1.1 101 ") && text.contains("sec-websocket-protocol: wsg.v1"), "{text}");
    assert!(text.ends_with("pings were not answered"), "{text}");
    lively.call("grippers", json!({})).await;
}

#[tokio::test]
async fn observers_never_block() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let mut socket = Socket::open(&gateway).await;
    // The width changes with each update, for longer than this test takes.
    gateway.post("move?wait_ms=0", &json!({"width_mm": 5, "speed_mm_s": 5})).await;
    let topics = json!({"topics": ["state", "telemetry", "frames"], "max_hz": 100});
    let begun = socket.call("subscribe", topics).await["states"][0]["seq"].as_u64().unwrap();
    let reached = |seq: u64| move |state: &Value| state["seq"].as_u64().unwrap() >= seq;
    // About two seconds, with many more updates than fit into the buffers.
    let stalled = gateway.until("200 updates", reached(begun + 200)).await["seq"].as_u64().unwrap();
    let id = socket.begin("fast-stop", json!({})).await;
    eventually("the device is stopped", async || (proxy.frames.count(0x23) > 0).then_some(())).await;
    assert!(socket.answer(id).await["result"]["fast_stop_confirmed"] == true);
    let (mut last, mut jump) = (begun, 0);
    while last < stalled {
        let seq = socket.notification("state", |_| true).await["seq"].as_u64().unwrap();
        jump = jump.max(seq - last);
        last = seq;
    }
    // The device updates its state 100 times a second, which is also this client's limit.
    assert!(jump > 50, "no update was skipped: the largest step is {jump}");
}

#[tokio::test]
async fn wire_log_has_the_bytes_on_the_wire() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::connected_to(proxy.address).await;
    let mut socket = Socket::open(&gateway).await;
    socket.call("subscribe", json!({"topics": ["frames"], "grippers": ["g"]})).await;
    let before = proxy.frames.len();
    socket.call("home", json!({"gripper": "g"})).await;
    let pending = socket.notification("frame", |frame| frame["text"] == "Homing -> E_CMD_PENDING").await;
    let hex = |id: u8, payload: &[u8]| {
        let mut bytes = Vec::new();
        wsg_gateway::wsg::frame::encode(id, payload, &mut bytes);
        json!(hex::encode(bytes))
    };
    assert_eq!((&pending["direction"], &pending["hex"]), (&json!("received"), &hex(0x20, &[26, 0])));
    let ended = socket.notification("frame", |frame| frame["text"] == "Homing -> E_SUCCESS").await;
    assert!(ended["seq"].as_u64() > pending["seq"].as_u64());
    socket.call("stop", json!({"gripper": "g"})).await;
    let sent = socket.notification("frame", |frame| frame["direction"] == "sent" && frame["id"] == 0x22).await;
    assert_eq!((&sent["name"], &sent["text"], &sent["gripper"]), (&json!("Stop"), &json!("Stop"), &json!("g")));
    let stop = proxy.frames.since(before).into_iter().find(|frame| frame.id == 0x22).unwrap();
    assert_eq!(sent["hex"], hex(stop.id, &stop.payload));
}

#[tokio::test]
async fn wire_log_has_damaged_frames_and_skipped_bytes() {
    let (device, control) = Simulator::with_control().await;
    let gateway = Gateway::connected_to(device.address).await;
    let mut socket = Socket::open(&gateway).await;
    socket.call("subscribe", json!({"topics": ["frames"], "grippers": ["g"]})).await;
    for (fault, damage, id) in [("corrupt_checksum", "checksum", json!(0x43)), ("garbage", "skipped", Value::Null)] {
        let fault = json!({"fault": {"kind": fault, "id": 0x43, "times": 1}});
        let armed = reqwest::Client::new().post(&control).body(fault.to_string()).send().await.unwrap();
        assert!(armed.status().is_success(), "{armed:?}");
        let shown = socket.notification("damage", |shown| shown["damage"] == damage).await;
        assert_eq!((&shown["id"], &shown["direction"]), (&id, &json!("received")), "{shown}");
        assert!(!shown["hex"].as_str().unwrap().is_empty(), "{shown}");
    }
}

#[tokio::test]
async fn decode_follows_the_wire_until_the_gateway_ends() {
    let (_device, gateway) = connected().await;
    let mut following = Process::start(&["decode", "--follow", &gateway.url("/api/v1/grippers/g")]);
    eventually("decode prints frames", async || (following.lines() > 0).then_some(())).await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    following.word_after(" g < Homing -> E_CMD_").await;
    assert_eq!(following.word_after(" g > Homing ").await, "direction=default");
    gateway.terminate().await;
    let ended = following.ended().await;
    assert!(!ended.status.success() && ended.stderr.contains("the gateway closed the connection"), "{}", ended.stderr);
}

#[tokio::test]
async fn decode_names_an_unknown_gripper_or_gateway() {
    let (_device, gateway) = connected().await;
    let said = run(&["decode", "--follow", &gateway.url("/api/v1/grippers/h")]).await.stderr;
    assert!(said.contains("no gripper is named h: this gateway has g"), "{said}");
    let said = run(&["decode", "--follow", "http://127.0.0.1:1"]).await.stderr;
    assert!(said.contains("no gateway answers at http://127.0.0.1:1"), "{said}");
}

#[tokio::test]
async fn every_answer_matches_its_description() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    socket.call("subscribe", json!({"topics": ["state", "telemetry", "events", "frames"]})).await;
    let motion = json!({"gripper": "g", "width_mm": 50, "speed_mm_s": 400});
    let finger = json!({"gripper": "g", "finger": 1});
    for (method, more) in [
        ("grippers", json!(null)),
        ("info", json!({})),
        ("state", json!({})),
        ("home", json!({"direction": "inner"})),
        ("move", motion.clone()),
        ("stop", json!({})),
        ("settings.acceleration", json!({})),
        ("settings.acceleration.set", json!({"acceleration_mm_s2": 2000})),
        ("settings.force-limit", json!({})),
        ("settings.force-limit.set", json!({"force_n": 40})),
        ("settings.soft-limits.set", json!({"minus_mm": 10, "plus_mm": 60})),
        ("settings.soft-limits", json!({})),
        ("settings.soft-limits.clear", json!({})),
        ("settings.overdrive", json!({})),
        ("settings.overdrive.set", json!({"enabled": false})),
        ("settings.device-tag.set", json!({"tag": "cell 7"})),
        ("settings.device-tag", json!({})),
        ("statistics", json!({})),
        ("statistics.reset", json!({})),
        ("fingers", finger.clone()),
        ("loop", json!({"data": "0102"})),
        ("raw", json!({"id": 80})),
        ("fast-stop", json!({"reason": "a test"})),
    ] {
        let mut params = more;
        if params.is_object() {
            params["gripper"] = "g".into();
        } else {
            params = json!({});
        }
        let answer = socket.call(method, params).await;
        if answer["phase"] == "running" {
            socket.notification("command", |command| command["id"] == answer["id"]).await;
        }
    }
    let all = socket.call("fast-stop", json!({})).await;
    assert_eq!(all["confirmed"], json!(["g"]));
    let mut state = json!({"jsonrpc": "2.0", "method": "state", "params": gateway.state().await});
    assert!(Socket::is_described("state.notification", &state));
    state["params"]["seq"] = "newest".into();
    assert!(!Socket::is_described("state.notification", &state));
    let served = gateway.get("/api/v1/asyncapi.yaml").await;
    assert_eq!(served.body.as_str(), Some(wsg_gateway::interfaces::http::ASYNCAPI));
}

/// Opens a socket that holds the lease of a homed gripper and has started a slow motion.
async fn moving_holder(gateway: &Gateway, terms: Value) -> Socket {
    gateway.post("home", &json!({"direction": "outer"})).await.outcome("SUCCESS");
    let mut socket = Socket::open(gateway).await;
    let lease = socket.call("lease.take", terms).await;
    assert_eq!(lease["held"], true);
    let slowly = json!({"gripper": "g", "width_mm": 5, "speed_mm_s": 10, "lease": lease["token"]});
    socket.call("move", slowly).await;
    gateway.until_moving().await;
    socket
}

#[tokio::test]
async fn lease_without_a_ttl_lives_as_long_as_its_socket() {
    let (_device, gateway) = connected().await;
    let mut socket = moving_holder(&gateway, json!({"gripper": "g", "holder": "robot"})).await;
    let lease = socket.call("lease", json!({"gripper": "g"})).await;
    assert_eq!(
        (&lease["holder"], &lease["expires_in_ms"]),
        (&json!("robot"), &lease["ttl_ms"]),
        "the socket keeps the lease"
    );
    gateway.post("move", &json!({"width_mm": 50, "speed_mm_s": 50})).await.problem(409, "lease_held");
    drop(socket);
    let state = gateway.until("the loss is a FAST STOP", |state| state["fast_stop"] == true).await;
    assert_eq!((&state["fast_stop_cause"], &state["lease_holder"]), (&json!("client_lost"), &Value::Null), "{state}");
}

#[tokio::test]
async fn lease_retaken_on_another_socket_survives_the_first() {
    let (_device, gateway) = connected().await;
    let mut before = Socket::open(&gateway).await;
    let mut socket = Socket::open(&gateway).await;
    let lease = before.call("lease.take", json!({"gripper": "g", "holder": "robot"})).await;
    let again = socket.call("lease.take", json!({"gripper": "g", "holder": "robot", "lease": lease["token"]})).await;
    assert_eq!((&again["token"], &again["epoch"]), (&lease["token"], &lease["epoch"]));
    let homed = socket.call("home", json!({"gripper": "g", "lease": lease["token"]})).await;
    drop(before);
    let done = socket.notification("command", |_| true).await;
    assert_eq!((&done["id"], &done["outcome"]), (&homed["id"], &json!("SUCCESS")), "{done}");
    assert_eq!(gateway.state().await["lease_holder"], "robot");
    drop(socket);
    gateway.until("the lease is free", |state| state["lease_holder"].is_null()).await;
}

#[tokio::test]
async fn released_lease_is_not_lost_with_its_socket() {
    let (_device, gateway) = connected().await;
    let mut socket = Socket::open(&gateway).await;
    let lease = socket.call("lease.take", json!({"gripper": "g"})).await;
    let renewed = socket.call("lease.renew", json!({"gripper": "g", "lease": lease["token"]})).await;
    assert_eq!(renewed["held"], true);
    let released = socket.call("lease.release", json!({"gripper": "g", "lease": lease["token"]})).await;
    assert_eq!(released["held"], false);
    let moving = gateway.begin("home", &json!({})).await;
    drop(socket);
    gateway.command(&moving).await.outcome("SUCCESS");
    assert_eq!(gateway.state().await["fast_stop"], false);
}
