//! Leases bound to a client's liveliness token.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::{BUSY_MARGIN, Rig};
use crate::harness::{ZenohClient, eventually};

const FAST_STOP: u8 = 0x23;
const TOKEN: &str = "wsg/v1/gateway/client/robot-1";

fn slowly(lease: &Value) -> Value {
    json!({"width_mm": 5, "speed_mm_s": 5, "lease": lease["token"]})
}

async fn homed() -> Rig {
    let rig = Rig::start(&["--part-mm", "20"]).await;
    rig.gateway.post("home", &json!({"direction": "outer"})).await.outcome("SUCCESS");
    rig
}

/// Returns the cause of each loss of a holder.
async fn losses(rig: &Rig) -> Vec<Value> {
    let events = rig.gateway.get("/api/v1/events?kind=lease&order=oldest").await.ok();
    let events = events["events"].as_array().unwrap().clone();
    events.into_iter().filter(|event| event["event"] == "lost").map(|event| event["cause"].clone()).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn lease_lives_as_long_as_its_holders_token() {
    let rig = homed().await;
    let robot = ZenohClient::of(&rig.gateway).await;
    let _token = robot.live(&rig.client, TOKEN).await;
    let lease = robot.command("lease.take", &json!({"holder": "robot-1"})).await.unwrap();
    let held = rig.client.command("lease", &json!({})).await.unwrap();
    assert_eq!(
        (&held["holder"], &held["expires_in_ms"]),
        (&json!("robot-1"), &held["ttl_ms"]),
        "the token keeps the lease"
    );
    let refused = rig.client.command("move", &json!({"width_mm": 50, "speed_mm_s": 50})).await.unwrap_err();
    assert_eq!((&refused["code"], &refused["holder"]), (&json!("lease_held"), &json!("robot-1")));
    robot.command("move?wait_ms=0", &slowly(&lease)).await.unwrap();
    rig.gateway.until_moving().await;
    let gone = Instant::now();
    robot.close().await;
    eventually("23h", async || rig.proxy.frames.first_since(FAST_STOP, gone)).await;
    let state = rig.gateway.until("the loss is a FAST STOP", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!(state["fast_stop_reason"], "lease holder robot-1 lost");
    assert_eq!(losses(&rig).await, ["disconnected"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn part_of_a_lost_client_stays_reserved_for_it() {
    let rig = homed().await;
    let robot = ZenohClient::of(&rig.gateway).await;
    let token = robot.live(&rig.client, TOKEN).await;
    let lease = robot.command("lease.take?client=robot-1", &json!({"holder": "robot-1"})).await.unwrap();
    let grip = json!({"width_mm": 20, "speed_mm_s": 400, "lease": lease["token"]});
    let held = robot.command("grip?client=robot-1", &grip).await.unwrap();
    assert_eq!(held["outcome"], "PART_HELD");
    token.undeclare().await.unwrap();
    rig.gateway.until("the holder is lost", |state| state["lease_holder"] == Value::Null).await;
    let state = rig.gateway.state().await;
    assert_eq!((&state["state"], &state["fast_stop"]), (&json!("HOLDING"), &json!(false)));
    let open = json!({"width_mm": 60, "speed_mm_s": 400});
    assert_eq!(rig.client.command("release", &open).await.unwrap_err()["code"], "reserved");
    let again = robot.command("lease.take?client=robot-1", &json!({"holder": "robot-1"})).await.unwrap();
    assert_eq!(again["held"], true);
}

#[tokio::test(flavor = "multi_thread")]
async fn leases_without_a_token_or_with_a_ttl_expire() {
    let rig = homed().await;
    let unbound = rig.client.command("lease.take", &json!({"holder": "robot-2", "ttl_ms": 200})).await.unwrap();
    assert_eq!(unbound["held"], true);
    rig.gateway.until("the lease has expired", |state| state["lease_holder"] == Value::Null).await;
    let other = ZenohClient::of(&rig.gateway).await;
    let _token = rig.client.live(&other, TOKEN).await;
    rig.client.command("lease.take", &json!({"holder": "robot-1", "ttl_ms": 200})).await.unwrap();
    rig.gateway.until("the lease has expired", |state| state["lease_holder"] == Value::Null).await;
    // Without a token, taking a lease does not keep it.
    let unbound = rig.client.command("lease.take", &json!({"holder": "robot-2"})).await.unwrap();
    assert_eq!(unbound["held"], true);
    rig.gateway.until("the lease has expired", |state| state["lease_holder"] == Value::Null).await;
    // The journal is written shortly after the state changes.
    let written = eventually("three losses", async || Some(losses(&rig).await).filter(|losses| losses.len() >= 3));
    assert_eq!(written.await, ["expired", "expired", "expired"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn released_lease_is_not_lost_with_the_token() {
    let rig = homed().await;
    let robot = ZenohClient::of(&rig.gateway).await;
    let _token = robot.live(&rig.client, TOKEN).await;
    let lease = robot.command("lease.take", &json!({"holder": "robot-1"})).await.unwrap();
    let released = robot.command("lease.release", &json!({"lease": lease["token"]})).await.unwrap();
    assert_eq!(released["held"], false);
    let moving = rig.gateway.begin("move", &json!({"width_mm": 50, "speed_mm_s": 50})).await;
    robot.close().await;
    rig.gateway.command(&moving).await.outcome("SUCCESS");
    assert_eq!(losses(&rig).await, [] as [&str; 0]);
}

#[tokio::test(flavor = "multi_thread")]
async fn client_lost_during_a_query_is_noticed_after_its_ttl() {
    const TTL: Duration = Duration::from_secs(2);
    let rig = homed().await;
    let robot = ZenohClient::of(&rig.gateway).await;
    let lease = json!({"holder": "robot-2", "ttl_ms": TTL.as_millis() as u64});
    let lease = robot.command("lease.take", &lease).await.unwrap();
    let query = robot.session.get("wsg/v1/gateway/g/command/move?wait_ms=60000").payload(slowly(&lease).to_string());
    let _answers = query.timeout(Duration::from_mins(1)).await.unwrap();
    rig.gateway.until_moving().await;
    let gone = Instant::now();
    robot.close().await;
    let stopped = eventually("23h", async || rig.proxy.frames.first_since(FAST_STOP, gone)).await;
    let took = stopped - gone;
    println!("23h {} ms after the client's end, with a ttl_ms of {}", took.as_millis(), TTL.as_millis());
    assert!(took < TTL + 2 * BUSY_MARGIN, "{took:?}");
    // The journal is written shortly after the frame is sent.
    let written = eventually("the loss", async || Some(losses(&rig).await).filter(|losses| !losses.is_empty()));
    assert_eq!(written.await, ["expired"]);
}

#[tokio::test(flavor = "multi_thread")]
async fn open_query_keeps_the_lease_of_a_live_client() {
    let rig = homed().await;
    let robot = ZenohClient::of(&rig.gateway).await;
    let _token = robot.live(&rig.client, TOKEN).await;
    let lease = robot.command("lease.take", &json!({"holder": "robot-1", "ttl_ms": 500})).await.unwrap();
    let slow = json!({"width_mm": 70, "speed_mm_s": 15, "lease": lease["token"]});
    let moved = robot.command("move?wait_ms=60000", &slow).await.unwrap();
    assert_eq!(moved["outcome"], "SUCCESS", "{moved}");
    assert!(moved["duration_ms"].as_u64() > Some(1500), "longer than the time to live: {moved}");
    assert_eq!(losses(&rig).await, [] as [&str; 0]);
}
