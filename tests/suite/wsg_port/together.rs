//! Several drivers with a REST client and an observer: all work, and each sees only its own frames.

use std::time::Duration;

use serde_json::json;

use super::{ACCESS_DENIED, Cell, GRIP, MOVE, SUCCESS};
use crate::harness::wsg::{floats, move_to};
use crate::harness::{Socket, eventually};

#[tokio::test]
async fn two_drivers_a_rest_client_and_an_observer_share_one_gripper() {
    let cell = Cell::new().await;
    let mut observer = Socket::open(&cell.gateway).await;
    observer.call("subscribe", json!({"topics": ["events", "telemetry"]})).await;
    let (mut one, mut two) = (cell.driver().await, cell.driver().await);
    // The first motion takes the lease, so the other driver's motions are refused.
    assert_eq!(one.run(0x20, &[0]).await, SUCCESS);
    // Each driver gets only its own updates.
    assert_eq!(two.status(0x43, &[1, 10, 0]).await, SUCCESS);
    let reading = async {
        let (mut widths, mut denied) = (0, 0);
        while widths < 60 || denied < 3 {
            if widths % 20 == 0 && widths < 60 {
                two.send(MOVE, &move_to(50.0, 50.0)).await;
            }
            let reply = two.next().await;
            match (reply.id, reply.status) {
                (0x43, SUCCESS) => widths += 1,
                (MOVE, ACCESS_DENIED) => denied += 1,
                other => panic!("not its own: {other:?}"),
            }
        }
        two.send(0x43, &[0; 3]).await;
        two.send(0x31, &[]).await;
        loop {
            match two.next().await.id {
                0x31 => break,
                0x43 => {}
                MOVE => denied += 1,
                other => panic!("not its own: {other:02X}h"),
            }
        }
        denied
    };
    let moving = async {
        assert_eq!(one.run(0x20, &[0]).await, SUCCESS);
        assert_eq!(one.run(GRIP, &floats(&[20.0, 100.0])).await, SUCCESS);
        assert_eq!(one.run(0x26, &floats(&[60.0, 200.0])).await, SUCCESS);
    };
    let asking = async {
        for _ in 0..10 {
            let state = cell.gateway.state().await;
            assert_eq!(state["link"], "connected");
        }
    };
    let (denied, (), ()) = tokio::join!(reading, moving, asking);
    assert!(denied >= 3, "{denied}");
    assert_eq!(one.next_within(Duration::from_millis(100)).await, None, "only requested frames");
    let rest = cell.gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 100})).await;
    assert_eq!(rest.problem(409, "lease_held")["holder"], "wsg:127.0.0.1");
    let held = |event: &serde_json::Value| event["door"] == "wsg" && event["outcome"] == "PART_HELD";
    assert_eq!(observer.notification("event", held).await["kind"], "command");

    // The announced disconnect frees the gripper.
    one.leave().await;
    cell.gateway.post("move", &json!({"width_mm": 40, "speed_mm_s": 200})).await.outcome("SUCCESS");
    assert_eq!(two.run(MOVE, &move_to(50.0, 200.0)).await, SUCCESS);
}

#[tokio::test]
async fn rest_lease_blocks_driver_motions_but_not_reads() {
    let cell = Cell::homed().await;
    let lease = cell.gateway.post("lease", &json!({"holder": "robot-1", "ttl_ms": 60000})).await.ok();
    let mut driver = cell.driver().await;
    for (id, parameters) in [(MOVE, move_to(50.0, 50.0)), (0x30, floats(&[500.0])), (0x38, vec![]), (0x42, vec![1])] {
        assert_eq!(driver.status(id, &parameters).await, ACCESS_DENIED, "{id:02X}h");
    }
    for (id, parameters) in [(0x31, vec![]), (0x40, vec![0; 3]), (0x42, vec![0]), (0x06, vec![1, 2])] {
        assert_eq!(driver.status(id, &parameters).await, SUCCESS, "{id:02X}h");
    }
    // A Stop needs no lease.
    let body = json!({"width_mm": 5, "speed_mm_s": 5, "lease": lease["token"]});
    let id = cell.gateway.begin("move", &body).await;
    cell.gateway.until_moving().await;
    assert_eq!(driver.status(0x22, &[]).await, SUCCESS);
    cell.gateway.command(&id).await.outcome("ABORTED");
}

#[tokio::test]
async fn journal_records_driver_commands() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.run(GRIP, &floats(&[20.0, 100.0])).await, SUCCESS);
    // The first two events belong to the homing.
    for event in cell.gateway.events("kind=command&order=oldest", 4).await.split_off(2) {
        assert_eq!((&event["door"], &event["subject"]), (&json!("wsg"), &json!("wsg:127.0.0.1")), "{event}");
    }
    eventually("the grip record", async || {
        let grips = cell.gateway.get("/api/v1/grips").await.ok();
        (grips["grips"][0]["outcome"] == "PART_HELD").then_some(())
    })
    .await;
}

/// Silent drivers with open connections do not block a FAST STOP.
/// Clients that a port keeps if the machine has enough descriptors.
const MAX_CLIENTS: usize = 512;

#[tokio::test]
async fn fast_stop_gets_a_connection_and_the_holder_keeps_its_own() {
    let cell = Cell::homed().await;
    let mut holder = cell.driver().await;
    assert_eq!(holder.run(MOVE, &move_to(60.0, 300.0)).await, SUCCESS);
    let mut others = Vec::new();
    for _ in 0..=MAX_CLIENTS {
        let mut other = cell.driver().await;
        assert_eq!(other.status(0x50, &[]).await, SUCCESS);
        others.push(other);
    }
    assert_eq!(others[MAX_CLIENTS].status(0x23, &[]).await, SUCCESS);
    assert_eq!(cell.gateway.state().await["fast_stop_cause"], "requested");
    assert_eq!(
        holder.status(MOVE, &move_to(50.0, 300.0)).await,
        ACCESS_DENIED,
        "the holder stays connected, and gets a status"
    );
    assert!(others[0].has_ended().await, "the longest silent driver is disconnected");
    assert_eq!(cell.gateway.state().await["lease_holder"], "wsg:127.0.0.1");
}
