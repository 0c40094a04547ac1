//! Stops and FAST STOPs on a WebSocket: after a motion, with mistakes, and just before or after the socket's end.

use serde_json::{Value, json};

use crate::harness::{Gateway, Simulator, Socket};

/// Waits for the end of a motion that was answered.
async fn ended(socket: &mut Socket, motion: Value) -> Value {
    // A motion that was stopped before the gripper accepted it has ended already.
    match &motion["outcome"] {
        Value::Null => socket.notification("command", |command| command["id"] == motion["id"]).await,
        _ => motion,
    }
}

#[tokio::test]
async fn stop_does_not_overtake_the_motion_before_it() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let mut socket = Socket::open(&gateway).await;
    for round in 0..20 {
        let width_mm = if round % 2 == 0 { 5 } else { 100 };
        let motion = json!({"gripper": "g", "width_mm": width_mm, "speed_mm_s": 50});
        let motion = socket.begin("move", motion).await;
        let stop = socket.begin("stop", json!({"gripper": "g"})).await;
        let motion = socket.answer(motion).await["result"].clone();
        socket.answer(stop).await;
        let moved = ended(&mut socket, motion).await;
        assert_eq!(moved["outcome"], "ABORTED", "round {round}: {moved}");
    }
}

#[tokio::test]
async fn motion_does_not_overtake_the_stop_before_it() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let mut socket = Socket::open(&gateway).await;
    for round in 0..20 {
        let width_mm = if round % 2 == 0 { 50 } else { 52 };
        let stop = socket.begin("stop", json!({"gripper": "g"})).await;
        let motion = json!({"gripper": "g", "width_mm": width_mm, "speed_mm_s": 400});
        let motion = socket.begin("move", motion).await;
        socket.answer(stop).await;
        let motion = socket.answer(motion).await["result"].clone();
        let moved = ended(&mut socket, motion).await;
        assert_eq!(moved["outcome"], "SUCCESS", "round {round}: {moved}");
    }
}

#[tokio::test]
async fn fast_stop_in_another_encoding_or_after_a_mistake_counts() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    // "Tür" in ISO 8859-1.
    let latin_1 =
        b"{\"jsonrpc\": \"2.0\", \"id\": 1, \"method\": \"fast-stop\", \"params\": {\"reason\": \"T\xFCr\"}}".to_vec();
    let well_formed = br#"{"jsonrpc": "2.0", "id": 1, "method": "fast-stop"}"#.to_vec();
    // The first message of the second case ends the socket.
    for messages in [vec![latin_1], vec![vec![0xFF], well_formed]] {
        let mut socket = Socket::open(&gateway).await;
        for message in messages {
            socket.send_binary(message).await;
        }
        let state = gateway.until("a FAST STOP", |state| state["fast_stop_confirmed"] == true).await;
        gateway.post("acknowledge", &json!({"fast_stop_id": state["fast_stop_id"]})).await.ok();
    }
}

#[tokio::test]
async fn fast_stop_with_a_long_reason_counts() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    for bytes in [70_000, 2_000_000] {
        let mut socket = Socket::open(&gateway).await;
        socket.begin("fast-stop", json!({"gripper": "g", "reason": "x".repeat(bytes)})).await;
        let state = gateway.until("a FAST STOP", |state| state["fast_stop_confirmed"] == true).await;
        gateway.post("acknowledge", &json!({"fast_stop_id": state["fast_stop_id"]})).await.ok();
        while socket.next().await.is_some() {}
    }
}

#[tokio::test]
async fn stop_after_the_end_of_its_socket_counts() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let mut owner = Socket::open(&gateway).await;
    let motion = owner.begin("move", json!({"gripper": "g", "width_mm": 5, "speed_mm_s": 5})).await;
    let motion = owner.answer(motion).await["result"].clone();
    assert_eq!(motion["outcome"], Value::Null, "{motion}");
    let mut socket = Socket::open(&gateway).await;
    // The first message ends the socket.
    socket.send_binary(vec![0xFF]).await;
    socket.begin("stop", json!({"gripper": "g"})).await;
    let moved = owner.notification("command", |command| command["id"] == motion["id"]).await;
    assert_eq!(moved["outcome"], "ABORTED", "{moved}");
}
