//! Disconnects of a client, and the effect on its motion and held part.

use std::time::{Duration, Instant};

use serde_json::json;

use super::{ABORTED, ACCESS_DENIED, Cell, GRIP, MOVE, SUCCESS};
use crate::harness::wsg::{PENDING, floats, move_to, request};
use crate::harness::{eventually, shortest};

/// Longest delay from the end of a holder's connection to the FAST STOP, on an idle machine.
const STOPPED_WITHIN: Duration = Duration::from_millis(50);

#[tokio::test]
async fn holder_killed_during_a_motion_is_an_immediate_fast_stop() {
    let cell = Cell::homed().await;
    let fastest = shortest(STOPPED_WITHIN, async || {
        let before = cell.proxy.frames.count(0x23);
        let mut driver = cell.driver().await;
        assert_eq!(driver.status(MOVE, &move_to(10.0, 5.0)).await, PENDING);
        cell.gateway.until_moving().await;
        let lost = Instant::now();
        driver.reset();
        let stopped = eventually("a FAST STOP", async || cell.proxy.frames.first_since(0x23, lost)).await;
        assert_eq!(cell.proxy.frames.count(0x23), before + 1);
        let state = cell.gateway.until("confirmed", |state| state["fast_stop_confirmed"] == true).await;
        assert_eq!((&state["fast_stop_cause"], &state["lease_holder"]), (&json!("client_lost"), &json!(null)));
        let body = json!({"fast_stop_id": state["fast_stop_id"]});
        cell.gateway.post("acknowledge", &body).await.ok();
        stopped - lost
    })
    .await;
    assert!(fastest <= STOPPED_WITHIN, "{fastest:?}");
}

#[tokio::test]
async fn announced_disconnect_during_a_motion_is_a_stop() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.status(MOVE, &move_to(10.0, 5.0)).await, PENDING);
    cell.gateway.until_moving().await;
    driver.send(0x07, &[]).await;
    let mut replies = [driver.next().await, driver.next().await];
    replies.sort_by_key(|reply| reply.id);
    assert_eq!(replies.map(|reply| (reply.id, reply.status)), [(0x07, SUCCESS), (MOVE, ABORTED)]);
    assert_eq!(driver.status(0x31, &[]).await, ACCESS_DENIED, "no request is accepted after 07h");
    drop(driver);
    let state = cell.gateway.until_standing().await;
    assert!(state["fast_stop"] == false && state["lease_holder"].is_null(), "{state}");
    assert_eq!((cell.proxy.frames.count(0x22), cell.proxy.frames.count(0x23)), (1, 0));
    assert_eq!(cell.proxy.frames.count(0x07), 0, "the gateway's own session stays open");
}

/// For example a script that pipes requests through netcat.
#[tokio::test]
async fn half_closed_client_gets_all_its_replies() {
    let cell = Cell::homed().await;
    for announced in [false, true] {
        let mut driver = cell.driver().await;
        let mut ids: Vec<u8> = [0x06, 0x31, 0x06, 0x33, 0x06, 0x50, 0x30, 0x06, 0x31].repeat(4);
        ids.extend(announced.then_some(0x07));
        let acceleration = floats(&[1500.0]);
        let payload = |id| if id == 0x30 { acceleration.as_slice() } else { &[] };
        let requests: Vec<u8> = ids.iter().flat_map(|&id| request(id, payload(id))).collect();
        driver.send_raw(&requests).await;
        driver.end_sending().await;
        for id in ids {
            let reply = driver.next().await;
            assert_eq!((reply.id, reply.status), (id, SUCCESS));
        }
        assert!(driver.has_ended().await, "then the client is gone");
    }
    assert_eq!(cell.gateway.state().await["fast_stop"], false);
}

#[tokio::test]
async fn half_close_during_a_motion_is_a_loss_and_is_answered() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.status(MOVE, &move_to(10.0, 5.0)).await, PENDING);
    cell.gateway.until_moving().await;
    // The acknowledgement waits for the Loop, and so comes behind the FAST STOP that the client's end causes.
    driver.send_raw(&[request(0x06, b"x"), request(0x24, b"ack"), request(MOVE, &move_to(50.0, 5.0))].concat()).await;
    driver.end_sending().await;
    let mut replies = Vec::new();
    for _ in 0..4 {
        let reply = driver.next().await;
        replies.push((reply.id, reply.status));
    }
    assert!(replies.contains(&(0x06, SUCCESS)) && replies.contains(&(MOVE, ABORTED)), "{replies:?}");
    assert!(driver.has_ended().await);
    let state = cell.gateway.until("confirmed", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!((&state["fast_stop_cause"], &state["lease_holder"]), (&json!("client_lost"), &json!(null)), "{state}");
    assert_eq!((cell.proxy.frames.count(0x24), cell.proxy.frames.count(MOVE)), (0, 1));
}

#[tokio::test]
async fn announcement_behind_an_unanswered_motion_is_no_loss() {
    let cell = Cell::homed().await;
    for round in 1..=3 {
        let mut driver = cell.driver().await;
        let requests = [request(MOVE, &move_to(10.0, 5.0)), request(0x07, &[])].concat();
        driver.send_raw(&requests).await;
        drop(driver);
        let events = cell.gateway.events("kind=lease&order=newest", 2 * round).await;
        let steps: Vec<_> = events.iter().take(2).map(|event| &event["event"]).collect();
        assert_eq!(steps, ["released", "taken"]);
        let state = cell.gateway.until_standing().await;
        assert!(state["fast_stop"] == false && state["reserved_for"].is_null(), "{state}");
    }
}

#[tokio::test]
async fn holder_killed_with_a_part_keeps_it_and_can_return() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.run(GRIP, &floats(&[20.0, 100.0])).await, SUCCESS);
    let sent = cell.proxy.frames.all().into_iter().filter(|frame| !frame.is_upkeep()).count();
    driver.reset();
    cell.gateway.until("the lease is free", |state| state["lease_holder"].is_null()).await;
    let others = cell.gateway.post("release", &json!({"width_mm": 60, "speed_mm_s": 100})).await;
    assert_eq!(others.problem(409, "reserved")["holder"], "wsg:127.0.0.1");
    let state = cell.gateway.state().await;
    assert_eq!((&state["state"], &state["fast_stop"]), (&json!("HOLDING"), &json!(false)), "{state}");
    assert_eq!(cell.proxy.frames.all().into_iter().filter(|frame| !frame.is_upkeep()).count(), sent);

    let mut again = cell.driver().await;
    assert_eq!(again.run(0x26, &floats(&[60.0, 100.0])).await, SUCCESS);
    again.leave().await;
    cell.gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.outcome("SUCCESS");
}

#[tokio::test]
async fn reader_takes_no_lease_and_its_disconnect_stops_nothing() {
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
async fn driver_keeps_the_lease_while_connected() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.run(MOVE, &move_to(50.0, 200.0)).await, SUCCESS);
    // Longer than the time to live of an unused lease.
    let lease = cell.gateway.get("lease").await.ok();
    let until = Instant::now() + Duration::from_millis(lease["ttl_ms"].as_u64().unwrap() + 500);
    eventually("the time to live is over", async || (Instant::now() > until).then_some(())).await;
    let lease = cell.gateway.get("lease").await.ok();
    assert_eq!((&lease["held"], &lease["holder"]), (&json!(true), &json!("wsg:127.0.0.1")), "{lease}");
    cell.gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.problem(409, "lease_held");
    driver.leave().await;
    cell.gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.outcome("SUCCESS");
}

#[tokio::test]
async fn forced_lease_is_not_retaken_by_a_motion() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.run(MOVE, &move_to(50.0, 200.0)).await, SUCCESS);
    let lease = cell.gateway.post("lease", &json!({"force": true, "ttl_ms": 60000})).await.ok();
    assert_eq!(driver.status(MOVE, &move_to(60.0, 200.0)).await, ACCESS_DENIED);
    let release = cell.gateway.request("DELETE", "lease").header("Wsg-Lease", lease["token"].as_str().unwrap());
    cell.gateway.send(release).await.ok();
    assert_eq!(driver.run(MOVE, &move_to(60.0, 200.0)).await, SUCCESS, "the lease is free again");
    driver.reset();
    let state = cell.gateway.until("the lease is free", |state| state["lease_holder"].is_null()).await;
    assert_eq!(state["fast_stop"], false, "the gripper stood");
}

#[tokio::test]
async fn gateway_shutdown_aborts_and_announces() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.status(MOVE, &move_to(5.0, 5.0)).await, PENDING);
    cell.gateway.until_moving().await;
    let ended = cell.gateway.terminate();
    let (ended, status) = tokio::join!(ended, driver.end_of(MOVE));
    assert!(ended.status.success(), "{ended:?}");
    assert_eq!(status, ABORTED, "the motion was stopped");
    assert_eq!(cell.proxy.frames.all().last().map(|frame| frame.id), Some(0x07));
    assert_eq!(cell.proxy.frames.count(0x23), 0, "no client was lost");
}
