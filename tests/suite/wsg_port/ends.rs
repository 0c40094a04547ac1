//! How a client ends, and what becomes of what it moves or holds.

use std::time::{Duration, Instant};

use serde_json::json;

use super::{ABORTED, ACCESS_DENIED, Cell, GRIP, MOVE, SUCCESS};
use crate::harness::eventually;
use crate::harness::wsg::{PENDING, floats, move_to};

/// How long after its connection has ended a holder's motion may go on, where the machine is not busy.
const STOPPED_WITHIN: Duration = Duration::from_millis(50);

#[tokio::test]
async fn a_holder_that_is_killed_while_it_moves_is_a_fast_stop_at_once() {
    let cell = Cell::homed().await;
    let mut fastest = Duration::MAX;
    for round in 1..=3 {
        let mut driver = cell.driver().await;
        assert_eq!(driver.status(MOVE, &move_to(10.0, 5.0)).await, PENDING);
        cell.gateway.until_moving().await;
        let lost = Instant::now();
        driver.reset();
        eventually("a FAST STOP", async || (cell.proxy.frames.count(0x23) == round).then_some(())).await;
        fastest = fastest.min(lost.elapsed());
        let state = cell.gateway.until("confirmed", |state| state["fast_stop_confirmed"] == true).await;
        assert_eq!((&state["fast_stop_cause"], &state["lease_holder"]), (&json!("client_lost"), &json!(null)));
        let body = json!({"fast_stop_id": state["fast_stop_id"]});
        cell.gateway.post("acknowledge", &body).await.ok();
    }
    assert!(fastest <= STOPPED_WITHIN, "{fastest:?}");
}

#[tokio::test]
async fn a_holder_that_announces_its_end_while_it_moves_is_a_stop_and_nothing_is_latched() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.status(MOVE, &move_to(10.0, 5.0)).await, PENDING);
    cell.gateway.until_moving().await;
    driver.send(0x07, &[]).await;
    let mut replies = [driver.next().await, driver.next().await];
    replies.sort_by_key(|reply| reply.id);
    assert_eq!(replies.map(|reply| (reply.id, reply.status)), [(0x07, SUCCESS), (MOVE, ABORTED)]);
    assert_eq!(driver.status(0x31, &[]).await, ACCESS_DENIED, "nothing more is taken");
    drop(driver);
    let state = cell.gateway.until_standing().await;
    assert!(state["fast_stop"] == false && state["lease_holder"].is_null(), "{state}");
    assert_eq!((cell.proxy.frames.count(0x22), cell.proxy.frames.count(0x23)), (1, 0));
    assert_eq!(cell.proxy.frames.count(0x07), 0, "the gripper's own session goes on");
}

#[tokio::test]
async fn a_holder_that_is_killed_while_it_holds_a_part_drops_nothing_and_may_come_back() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.run(GRIP, &floats(&[20.0, 100.0])).await, SUCCESS);
    let sent = cell.proxy.frames.all().into_iter().filter(|frame| !frame.is_upkeep()).count();
    driver.reset();
    cell.gateway.until("nobody holds it", |state| state["lease_holder"].is_null()).await;
    let others = cell.gateway.post("release", &json!({"width_mm": 60, "speed_mm_s": 100})).await;
    assert_eq!(others.problem(409, "lease_held")["holder"], "wsg:127.0.0.1", "it is reserved");
    let state = cell.gateway.state().await;
    assert_eq!((&state["state"], &state["fast_stop"]), (&json!("HOLDING"), &json!(false)), "{state}");
    assert_eq!(cell.proxy.frames.all().into_iter().filter(|frame| !frame.is_upkeep()).count(), sent);

    let mut again = cell.driver().await;
    assert_eq!(again.run(0x26, &floats(&[60.0, 100.0])).await, SUCCESS);
    again.leave().await;
    cell.gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.outcome("SUCCESS");
}

#[tokio::test]
async fn who_only_reads_takes_no_lease_and_its_end_stops_nobody() {
    let cell = Cell::homed().await;
    let mut reader = cell.driver().await;
    assert_eq!(reader.status(0x31, &[]).await, SUCCESS);
    let id = cell.gateway.begin("move", &json!({"width_mm": 60, "speed_mm_s": 50})).await;
    cell.gateway.until_moving().await;
    reader.reset();
    cell.gateway.command(&id).await.outcome("SUCCESS");
    assert_eq!((cell.proxy.frames.count(0x22), cell.proxy.frames.count(0x23)), (0, 0));
}

#[tokio::test]
async fn a_client_keeps_the_lease_for_as_long_as_it_is_connected() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.run(MOVE, &move_to(50.0, 200.0)).await, SUCCESS);
    // Longer than a lease lives without use.
    let lease = cell.gateway.get("lease").await.ok();
    let until = Instant::now() + Duration::from_millis(lease["ttl_ms"].as_u64().unwrap() + 500);
    eventually("longer than its time to live", async || (Instant::now() > until).then_some(())).await;
    let lease = cell.gateway.get("lease").await.ok();
    assert_eq!((&lease["held"], &lease["holder"]), (&json!(true), &json!("wsg:127.0.0.1")), "{lease}");
    cell.gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.problem(409, "lease_held");
    driver.leave().await;
    cell.gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.outcome("SUCCESS");
}

#[tokio::test]
async fn a_lease_that_was_forced_away_is_not_taken_back_by_moving() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.run(MOVE, &move_to(50.0, 200.0)).await, SUCCESS);
    let lease = cell.gateway.post("lease", &json!({"force": true, "ttl_ms": 60000})).await.ok();
    assert_eq!(driver.status(MOVE, &move_to(60.0, 200.0)).await, ACCESS_DENIED);
    let release = cell.gateway.request("DELETE", "lease").header("Wsg-Lease", lease["token"].as_str().unwrap());
    cell.gateway.send(release).await.ok();
    assert_eq!(driver.run(MOVE, &move_to(60.0, 200.0)).await, SUCCESS, "it is free again");
    driver.reset();
    let state = cell.gateway.until("nobody holds it", |state| state["lease_holder"].is_null()).await;
    assert_eq!(state["fast_stop"], false, "nothing moved");
}

#[tokio::test]
async fn the_gateways_end_is_told_and_announced() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.status(MOVE, &move_to(5.0, 5.0)).await, PENDING);
    cell.gateway.until_moving().await;
    let ended = cell.gateway.terminate();
    let (ended, status) = tokio::join!(ended, driver.end_of(MOVE));
    assert!(ended.status.success(), "{ended:?}");
    assert_eq!(status, ABORTED, "it was stopped");
    assert_eq!(cell.proxy.frames.all().last().map(|frame| frame.id), Some(0x07));
    assert_eq!(cell.proxy.frames.count(0x23), 0, "no client was lost");
}
