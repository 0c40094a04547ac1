//! A user's first steps: home, move, grip, release.

use serde_json::json;

use crate::harness::{Gateway, Simulator};

#[tokio::test]
async fn part_is_gripped_held_and_released() {
    let device = Simulator::with_part().await;
    let gateway = Gateway::homed_at(device.address).await;
    let moved = gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.outcome("SUCCESS");
    assert!((moved["width_mm"].as_f64().unwrap() - 40.0).abs() < 0.1, "{moved}");
    assert_eq!((&moved["reached_goal"], &moved["stalled"]), (&json!(true), &json!(false)), "{moved}");

    let grip = json!({"width_mm": 20, "speed_mm_s": 50, "force_n": 30, "part_id": "A-1047"});
    let held = gateway.post("grip", &grip).await.outcome("PART_HELD");
    let state = gateway.state().await;
    assert_eq!((&held["status"], &held["status_code"]), (&json!("E_SUCCESS"), &json!(0)), "{held}");
    assert_eq!((&held["reached_goal"], &held["stalled"]), (&json!(true), &json!(true)), "{held}");
    assert!((held["width_mm"].as_f64().unwrap() - 20.0).abs() < 0.5, "{held}");
    assert!((held["force_n"].as_f64().unwrap() - 30.0).abs() < 3.0, "{held}");
    assert_eq!((&state["state"], &state["state_code"]), (&json!("HOLDING"), &json!(4)), "{state}");
    assert_eq!((&state["moving"], &state["command"]), (&json!(false), &json!(null)), "{state}");

    let released = gateway.post("release", &json!({"width_mm": 60, "speed_mm_s": 200})).await.outcome("SUCCESS");
    let state = gateway.state().await;
    assert!((released["width_mm"].as_f64().unwrap() - 60.0).abs() < 0.1, "{released}");
    assert_eq!(state["state"], "IDLE", "{state}");
    assert!((state["width_mm"].as_f64().unwrap() - 60.0).abs() < 0.1, "{state}");
}

#[tokio::test]
async fn grip_without_a_part_is_an_outcome_not_an_error() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::homed_at(device.address).await;
    let nothing = gateway.post("grip", &json!({"width_mm": 20, "speed_mm_s": 200})).await.outcome("NO_PART");
    assert_eq!(nothing["reached_goal"], false, "{nothing}");
    assert_eq!((&nothing["status"], &nothing["status_code"]), (&json!("E_CMD_FAILED"), &json!(18)), "{nothing}");
    let state = gateway.state().await;
    assert_eq!(state["state"], "NO_PART", "{state}");
    let opposite = json!({"width_mm": 60, "speed_mm_s": 200});
    let refused = gateway.post("grip", &opposite).await.problem(409, "release_first");
    assert_eq!((&refused["device_status"], &refused["command"]), (&json!("E_ALREADY_RUNNING"), &json!(null)));
    gateway.post("release", &json!({"width_mm": 40, "speed_mm_s": 200})).await.outcome("SUCCESS");
    gateway.post("grip", &opposite).await.outcome("NO_PART");
}

#[tokio::test]
async fn unreferenced_gripper_only_homes_and_has_no_width() {
    let device = Simulator::start(&[]).await;
    let gateway = Gateway::connected_to(device.address).await;
    let state = gateway.state().await;
    assert_eq!((&state["referenced"], &state["width_mm"]), (&json!(false), &json!(null)), "{state}");
    gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 100})).await.problem(409, "not_referenced");
    gateway.post("home", &json!({"direction": "inner"})).await.outcome("SUCCESS");
    let state = gateway.until("the gripper is referenced", |state| state["referenced"] == true).await;
    assert!(state["width_mm"].as_f64().unwrap() < 5.0, "{state}");
}

#[tokio::test]
async fn every_model_reports_its_properties() {
    for (model, firmware, stroke_mm) in
        [("wsg25", "fw4", 64), ("wsg32", "fw4", 68), ("wsg50", "fw2", 110), ("wsg70", "fw4", 210)]
    {
        let device = Simulator::start(&["--model", model, "--firmware", firmware]).await;
        let gateway = Gateway::connected_to(device.address).await;
        let info = gateway.get("").await.ok();
        assert_eq!(info["stroke_mm"].as_f64(), Some(f64::from(stroke_mm)), "{info}");
        assert_eq!(info["stops_on_gateway_loss"], true, "{info}");
        let has_fingers = info["capabilities"].as_array().unwrap().contains(&json!("fingers"));
        assert_eq!(has_fingers, firmware == "fw4", "{info}");
        gateway.post("home", &json!({})).await.outcome("SUCCESS");
    }
}

#[tokio::test]
async fn gripper_without_fast_stop_on_disconnect_does_not_stop_by_itself() {
    let device = Simulator::start(&[]).await;
    let url = format!("tcp://{}", device.address);
    let gateway =
        Gateway::with_file(&[], &format!("[grippers.g]\nurl = \"{url}\"\nfast_stop_on_disconnect = false\n")).await;
    gateway.until_link("connected").await;
    assert_eq!(gateway.get("").await.ok()["stops_on_gateway_loss"], false);
}
