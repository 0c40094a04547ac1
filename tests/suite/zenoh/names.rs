//! Sessions that use the names of a holder, a gateway or a gripper of others.

use std::time::{Duration, Instant};

use serde_json::{Value, json};
use zenoh::Wait as _;
use zenoh::query::Query;

use super::Rig;
use super::fleet::{Pair, until_whole};
use crate::harness::{ZenohClient, eventually};

const FAST_STOP: u8 = 0x23;
const TOKEN: &str = "wsg/v1/gateway/client/robot-1";

/// Maximum number of client tokens that a gateway keeps.
const MAX_TOKENS: usize = 1024;

/// Maximum number of simultaneous queries of one kind in a gateway.
const MAX_QUERIES: usize = 64;

async fn homed() -> Rig {
    let rig = Rig::start(&[]).await;
    rig.gateway.post("home", &json!({"direction": "outer"})).await.outcome("SUCCESS");
    rig
}

fn take(client: &ZenohClient) -> String {
    format!("lease.take?client=robot-1;zid={}", client.session.zid())
}

fn slowly(lease: &Value) -> Value {
    json!({"width_mm": 5, "speed_mm_s": 5, "lease": lease["token"]})
}

#[tokio::test(flavor = "multi_thread")]
async fn foreign_token_does_not_keep_a_lost_holders_lease() {
    let rig = homed().await;
    let (robot, stranger) = (ZenohClient::of(&rig.gateway).await, ZenohClient::of(&rig.gateway).await);
    let _token = robot.live(&rig.client, TOKEN).await;
    let _foreign = stranger.live(&rig.client, TOKEN).await;
    let _same_id = stranger.live(&rig.client, &format!("{TOKEN}/{}", robot.session.zid())).await;
    let lease = robot.command(&take(&robot), &json!({"holder": "robot-1"})).await.unwrap();
    let held = rig.client.command("lease", &json!({})).await.unwrap();
    assert_eq!(held["expires_in_ms"], held["ttl_ms"], "the session keeps the lease");
    robot.command("move?wait_ms=0", &slowly(&lease)).await.unwrap();
    rig.gateway.until_moving().await;
    let gone = Instant::now();
    robot.close().await;
    eventually("23h", async || rig.proxy.frames.first_since(FAST_STOP, gone)).await;
    let lost = rig.gateway.events("kind=lease", 2).await;
    assert_eq!((&lost[0]["event"], &lost[0]["cause"]), (&json!("lost"), &json!("disconnected")));
    assert_eq!(lease["bound_to"], "session");
}

#[tokio::test(flavor = "multi_thread")]
async fn end_of_a_foreign_token_does_not_end_a_lease() {
    let rig = homed().await;
    let (robot, stranger) = (ZenohClient::of(&rig.gateway).await, ZenohClient::of(&rig.gateway).await);
    let foreign = stranger.live(&rig.client, TOKEN).await;
    robot.command(&take(&robot), &json!({"holder": "robot-1"})).await.unwrap();
    let seen = rig.client.tokens(TOKEN).await;
    foreign.undeclare().await.unwrap();
    seen.until(TOKEN, Value::is_null).await;
    stranger.close().await;
    let held = rig.client.command("lease", &json!({})).await.unwrap();
    assert_eq!((&held["holder"], &held["expires_in_ms"]), (&json!("robot-1"), &held["ttl_ms"]));
}

#[tokio::test(flavor = "multi_thread")]
async fn foreign_tokens_leave_room_for_a_holders_token() {
    let rig = homed().await;
    let stranger = ZenohClient::of(&rig.gateway).await;
    let mut foreign = Vec::new();
    for index in 0..MAX_TOKENS {
        let token = stranger.session.liveliness().declare_token(format!("wsg/v1/gateway/client/x{index}"));
        foreign.push(token.await.unwrap());
    }
    eventually("all are kept", async || {
        let connected = rig.gateway.figures().await.get("wsg_clients_connected{door=\"zenoh\"}").copied();
        (connected == Some(MAX_TOKENS as f64)).then_some(())
    })
    .await;
    let robot = ZenohClient::of(&rig.gateway).await;
    let _token = robot.live(&rig.client, TOKEN).await;
    let lease = robot.command("lease.take", &json!({"holder": "robot-1"})).await.unwrap();
    let held = rig.client.command("lease", &json!({})).await.unwrap();
    assert_eq!(held["expires_in_ms"], held["ttl_ms"], "the token keeps the lease");
    assert_eq!(lease["bound_to"], "token");
    robot.command("lease.release", &json!({"lease": lease["token"]})).await.unwrap();
    let unbound = robot.command("lease.take", &json!({"holder": "robot-2"})).await.unwrap();
    assert_eq!(
        (&unbound["bound_to"], unbound.get("bound_to").is_some()),
        (&Value::Null, true),
        "the answer reports the missing binding"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn malformed_session_id_is_refused() {
    let rig = Rig::start(&[]).await;
    for zid in ["robot-1", "0", "123456789012345678901234567890123"] {
        let refused = rig.client.command(&format!("lease.take?zid={zid}"), &json!({})).await.unwrap_err();
        assert_eq!((&refused["code"], &refused["field"]), (&json!("malformed"), &json!("zid")), "{zid}");
    }
    let unknown = rig.client.command("lease.take?zid=1234", &json!({"holder": "robot-1"})).await.unwrap();
    assert_eq!(unknown["bound_to"], Value::Null, "no connected session has this id");
}

#[tokio::test(flavor = "multi_thread")]
async fn strangers_leave_query_slots_for_the_holder() {
    let rig = homed().await;
    let (robot, stranger) = (ZenohClient::of(&rig.gateway).await, ZenohClient::of(&rig.gateway).await);
    let lease = robot.command(&take(&robot), &json!({"holder": "robot-1"})).await.unwrap();
    let moving = robot.command("move?wait_ms=0", &slowly(&lease)).await.unwrap();
    let key = "wsg/v1/gateway/g/command/command?wait_ms=60000";
    let (refused, mut refusals) = tokio::sync::mpsc::unbounded_channel();
    for _ in 0..=MAX_QUERIES {
        let refused = refused.clone();
        let waiting = stranger.session.get(key).payload(json!({"command": moving["id"]}).to_string());
        let waiting = waiting.callback(move |reply| refused.send(reply.result().is_err()).unwrap_or_default());
        waiting.timeout(Duration::from_mins(1)).await.unwrap();
    }
    assert_eq!(refusals.recv().await, Some(true), "all slots for strangers are taken");
    let body = json!({"command": moving["id"]});
    let waited = format!("command?wait_ms=100;lease={}", lease["token"].as_str().unwrap());
    assert_eq!(robot.command(&waited, &body).await.unwrap()["phase"], "running");
    rig.client.command("command?wait_ms=100", &body).await.unwrap_err();
}

#[tokio::test(flavor = "multi_thread")]
async fn foreign_instance_token_does_not_block_motion() {
    let rig = homed().await;
    let stranger = ZenohClient::of(&rig.gateway).await;
    let key = "wsg/v1/gateway/instance/1234";
    let answer = move |query: Query| query.reply(key, "").wait().unwrap();
    stranger.session.declare_queryable(key).callback(answer).background().await.unwrap();
    let _token = stranger.live(&rig.client, key).await;
    rig.gateway.until_logged("a session that is not a gateway").await;
    let moved = rig.client.command("move", &json!({"width_mm": 50, "speed_mm_s": 400})).await.unwrap();
    assert_eq!(moved["outcome"], "SUCCESS");
    rig.client.command("lease.take", &json!({"holder": "robot-1"})).await.unwrap();
    assert_eq!(rig.gateway.get("/readyz").await.ok()["zenoh_cause"], Value::Null);
}

#[tokio::test(flavor = "multi_thread")]
async fn spoofed_state_does_not_confirm_a_fast_stop() {
    let pair = Pair::start().await;
    let stranger = ZenohClient::at(pair.router.endpoint()).await;
    let key = "wsg/v1/far/g/state";
    let stopped = json!({"link": "connected", "age_ms": 1, "fast_stop": true, "fast_stop_confirmed": true}).to_string();
    let answered = stopped.clone();
    let answer = move |query: Query| query.reply(key, answered.clone()).wait().unwrap();
    stranger.session.declare_queryable(key).complete(true).callback(answer).background().await.unwrap();
    eventually("the stranger answers", async || (answering(&stranger, key).await >= 2).then_some(())).await;
    pair.far.freeze();
    let spoof = async {
        loop {
            stranger.put(key, stopped.clone()).await;
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    };
    let stop = pair.near.request("POST", "/api/v1/fleet/fast-stop").json(&json!({}));
    let stopped = tokio::select! {
        answer = pair.near.send(stop) => answer.ok(),
        () = spoof => unreachable!("spoofing continues until the answer"),
    };
    assert_eq!((&stopped["confirmed"], &stopped["unconfirmed"]), (&json!(["near/g0"]), &json!(["far/g"])), "{stopped}");
    pair.far.thaw();
    let state = pair.far.until("the gripper is stopped", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!(state["fast_stop"], true);
}

#[tokio::test(flavor = "multi_thread")]
async fn strangers_answer_for_a_gateway_is_ignored() {
    let pair = Pair::start().await;
    let stranger = ZenohClient::at(pair.router.endpoint()).await;
    let key = "wsg/v1/far/g/command/fast-stop";
    let answer = move |query: Query| query.reply(key, r#"{"fast_stop_confirmed": true}"#).wait().unwrap();
    stranger.session.declare_queryable(key).complete(true).callback(answer).background().await.unwrap();
    eventually("the stranger answers", async || (answering(&stranger, key).await >= 2).then_some(())).await;
    pair.far.freeze();
    let stopped = pair.near.post("/api/v1/fleet/far/grippers/g/fast-stop", &json!({})).await;
    stopped.problem(504, "gateway_timeout");
    pair.far.thaw();
}

#[tokio::test(flavor = "multi_thread")]
async fn owner_confirms_a_fast_stop_despite_spoofed_states() {
    let pair = Pair::start().await;
    let stranger = ZenohClient::at(pair.router.endpoint()).await;
    let running = json!({"link": "connected", "age_ms": 1, "fast_stop": false}).to_string();
    let spoof = async {
        loop {
            stranger.put("wsg/v1/far/g/state", running.clone()).await;
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    until_whole(&pair.near, 2).await;
    let stop = pair.near.request("POST", "/api/v1/fleet/fast-stop").json(&json!({}));
    let stopped = tokio::select! {
        answer = pair.near.send(stop) => answer.ok(),
        () = spoof => unreachable!("spoofing continues until the answer"),
    };
    assert_eq!(stopped["fast_stop_confirmed"], true, "{stopped}");
}

/// Returns the number of sessions that answer at this key.
async fn answering(client: &ZenohClient, key: &str) -> usize {
    let get = client.session.get(key).target(zenoh::query::QueryTarget::All);
    let replies = get.consolidation(zenoh::query::ConsolidationMode::None).await.unwrap();
    let mut count = 0;
    while replies.recv_async().await.is_ok() {
        count += 1;
    }
    count
}
