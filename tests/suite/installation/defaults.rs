//! A gateway without arguments, which has two simulated grippers.

use serde_json::{Value, json};

use crate::harness::Gateway;

fn path(gripper: &str, rest: &str) -> String {
    format!("/api/v1/grippers/{gripper}/{rest}")
}

async fn both(gateway: &Gateway, kind: &str, body: &Value) -> (Value, Value) {
    let (left, right) = (path("left", kind), path("right", kind));
    let (left, right) = tokio::join!(gateway.post(&left, body), gateway.post(&right, body));
    (left.ok(), right.ok())
}

#[tokio::test]
async fn two_grippers_move_at_once_and_one_has_a_part() {
    let gateway = Gateway::start(&["--journal", ":memory:"]).await;
    for gripper in ["left", "right"] {
        crate::harness::eventually(gripper, async || {
            let state = gateway.get(&path(gripper, "state")).await.ok();
            (state["link"] == "connected").then_some(())
        })
        .await;
    }
    let listed = gateway.get("/api/v1/grippers").await.ok();
    let names: Vec<_> = listed["grippers"].as_array().unwrap().iter().map(|info| info["gripper"].clone()).collect();
    assert_eq!(names, [json!("left"), json!("right")]);

    let (left, right) = both(&gateway, "home", &json!({})).await;
    assert_eq!((&left["outcome"], &right["outcome"]), (&json!("SUCCESS"), &json!("SUCCESS")));
    let (left, right) = both(&gateway, "grip", &json!({"width_mm": 20, "speed_mm_s": 400})).await;
    assert_eq!((&left["outcome"], &right["outcome"]), (&json!("PART_HELD"), &json!("NO_PART")));
    let (left, right) = both(&gateway, "release", &json!({"width_mm": 60, "speed_mm_s": 400})).await;
    assert_eq!((&left["outcome"], &right["outcome"]), (&json!("SUCCESS"), &json!("SUCCESS")));

    let stopped = gateway.post("/api/v1/fast-stop", &json!({"reason": "all"})).await.ok();
    assert_eq!((&stopped["fast_stop_confirmed"], &stopped["unconfirmed"]), (&json!(true), &json!([])), "{stopped}");
    for gripper in ["left", "right"] {
        let state = gateway.get(&path(gripper, "state")).await.ok();
        assert_eq!((&state["fast_stop"], &state["fast_stop_id"]), (&json!(true), &stopped["fast_stop_id"]));
    }
    let acknowledge = json!({"fast_stop_id": stopped["fast_stop_id"]});
    let (left, right) = both(&gateway, "acknowledge", &acknowledge).await;
    assert_eq!((&left["fast_stop"], &right["fast_stop"]), (&json!(false), &json!(false)));
}
