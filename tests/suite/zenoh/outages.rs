//! FAST STOPs of a fleet reach gateways that were out of reach.

use std::time::Instant;

use serde_json::json;

use super::fleet::{FAST_STOP, Pair, far, gateway, until_gone, until_whole};
use super::router::Router;
use crate::harness::eventually;

#[tokio::test(flavor = "multi_thread")]
async fn fleet_fast_stop_without_a_network_is_sent_to_gateways_that_appear() {
    let endpoint = Router::start().kill().await;
    let g = ["g=sim://wsg50".to_owned()];
    let (near, far) = tokio::join!(gateway("near", &endpoint, 1, &[]), gateway("far", &endpoint, 0, &g));
    let stopped = near.post("/api/v1/fleet/fast-stop", &json!({"reason": "light curtain"})).await.ok();
    assert_eq!((&stopped["fast_stop_confirmed"], &stopped["unconfirmed"]), (&json!(false), &json!([])), "{stopped}");
    let _router = Router::at(endpoint);
    let state = far.until("the gripper is stopped", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!(state["fast_stop_reason"], "light curtain");
    until_whole(&near, 2).await;
    let stopped = near.post("/api/v1/fleet/fast-stop", &json!({})).await.ok();
    assert_eq!(stopped["unconfirmed"], json!([]), "{stopped}");
}

#[tokio::test(flavor = "multi_thread")]
async fn fleet_fast_stop_is_repeated_after_a_router_outage() {
    let pair = Pair::start().await;
    pair.near.post(&far("/home"), &json!({"direction": "outer"})).await.outcome("SUCCESS");
    let Pair { router, device: _device, proxy, near, far: there } = pair;
    let endpoint = router.kill().await;
    until_gone(&near, "far").await;
    let stopped = near.post("/api/v1/fleet/fast-stop", &json!({"reason": "light curtain"})).await.ok();
    assert_eq!(stopped["fast_stop_confirmed"], false, "the gripper may still move: {stopped}");
    assert!(stopped["unconfirmed"].as_array().unwrap().contains(&json!("far/g")), "{stopped}");
    assert_eq!(proxy.frames.count(FAST_STOP), 0);
    there.begin("move", &json!({"width_mm": 5, "speed_mm_s": 5})).await;
    let back = Instant::now();
    let _router = Router::at(endpoint);
    eventually("23h", async || proxy.frames.first_since(FAST_STOP, back)).await;
    let state = there.until("the gripper is stopped", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!(state["fast_stop_reason"], "light curtain");
}

#[tokio::test(flavor = "multi_thread")]
async fn fleet_fast_stop_is_repeated_to_a_returning_gateway() {
    let pair = Pair::start().await;
    pair.far.freeze();
    until_gone(&pair.near, "far").await;
    let stopped = pair.near.post("/api/v1/fleet/fast-stop", &json!({"reason": "light curtain"})).await.ok();
    assert_eq!(stopped["fast_stop_confirmed"], false, "the gripper may still move: {stopped}");
    assert!(stopped["unconfirmed"].as_array().unwrap().contains(&json!("far/g")), "{stopped}");
    pair.far.thaw();
    let state = pair.far.until("the gripper is stopped", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!(
        (&state["fast_stop_reason"], &state["fast_stop_by"]),
        (&json!("light curtain"), &json!("zenoh:http:127.0.0.1"))
    );
}
