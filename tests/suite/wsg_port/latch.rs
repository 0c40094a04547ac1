//! Permission to acknowledge a FAST STOP with 24h.

use serde_json::json;

use super::{ACCESS_DENIED, ALREADY_RUNNING, CMD_FAILED, Cell, MOVE, SUCCESS};
use crate::harness::wsg::{PENDING, move_to};
use crate::harness::{Gateway, Simulator};

const FAST_STOP: u32 = 1 << 12;

#[tokio::test]
async fn blind_acknowledge_of_an_unknown_cause_is_refused() {
    // Killing a gateway leaves its device in FAST STOP.
    let device = Simulator::start(&[]).await;
    Gateway::connected_to(device.address).await.kill().await;
    let (gateway, port) = Gateway::with_port(device.address, &[]).await;
    let latched = gateway.until("the FAST STOP", |state| state["fast_stop"] == true).await;
    let mut driver = crate::harness::wsg::Driver::connect(port).await;
    assert_eq!(latched["fast_stop_cause"], "unknown", "this gateway does not know of the other");
    assert_eq!(driver.status(0x24, b"ack").await, ACCESS_DENIED, "the driver has not seen the FAST STOP");
    assert_eq!(gateway.state().await["fast_stop_id"], latched["fast_stop_id"]);
    assert_eq!(driver.flags().await & FAST_STOP, FAST_STOP);
    assert_eq!(driver.status(0x24, b"ack").await, SUCCESS);
    assert_eq!(driver.flags().await & FAST_STOP, 0);
    assert_eq!(gateway.state().await["fast_stop"], false);
}

#[tokio::test]
async fn refused_motion_counts_as_seen() {
    let device = Simulator::start(&[]).await;
    Gateway::connected_to(device.address).await.kill().await;
    let (_gateway, port) = Gateway::with_port(device.address, &[]).await;
    let mut driver = crate::harness::wsg::Driver::connect(port).await;
    assert_eq!(driver.status(0x20, &[0]).await, ACCESS_DENIED);
    assert_eq!(driver.status(0x24, b"ack").await, SUCCESS);
    assert_eq!(driver.run(0x20, &[0]).await, SUCCESS);
}

#[tokio::test]
async fn fast_stop_is_acknowledged_only_by_its_driver() {
    let cell = Cell::homed().await;
    let (mut one, mut other) = (cell.driver().await, cell.driver().await);
    assert_eq!(one.status(MOVE, &move_to(10.0, 5.0)).await, PENDING);
    // A Stop or FAST STOP needs no lease.
    assert_eq!(other.status(0x23, &[]).await, SUCCESS);
    assert_eq!(one.end_of(MOVE).await, super::ABORTED);
    assert_eq!(one.flags().await & FAST_STOP, FAST_STOP);
    assert_eq!(one.status(0x24, b"ack").await, ACCESS_DENIED);
    assert_eq!(other.status(0x24, b"ack").await, SUCCESS);
    assert_eq!(one.run(MOVE, &move_to(20.0, 200.0)).await, SUCCESS, "the driver still holds the lease");
}

#[tokio::test]
async fn driver_that_connects_again_at_once_can_acknowledge() {
    let cell = Cell::homed().await;
    let mut lost = cell.driver().await;
    assert_eq!(lost.status(MOVE, &move_to(10.0, 5.0)).await, PENDING);
    let mut states = crate::harness::Socket::open(&cell.gateway).await;
    states.call("subscribe", json!({"topics": ["state"]})).await;
    lost.reset();
    states.notification("state", |state| state["fast_stop_cause"] == "client_lost").await;
    let mut again = cell.driver().await;
    assert_eq!(again.status(0x24, b"ack").await, SUCCESS);
    assert_eq!(again.run(MOVE, &move_to(20.0, 200.0)).await, SUCCESS);
}

#[tokio::test]
async fn fast_stop_over_http_is_acknowledged_over_http() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    let stopped = cell.gateway.post("fast-stop", &json!({"reason": "light curtain"})).await.ok();
    assert_eq!(driver.flags().await & FAST_STOP, FAST_STOP);
    assert_eq!(driver.status(0x24, b"ack").await, ACCESS_DENIED);
    let refused = cell.gateway.events("kind=refused", 1).await.remove(0);
    let fields = ["door", "subject", "command", "code"].map(|field| refused[field].as_str().unwrap());
    assert_eq!(fields, ["wsg", "wsg:127.0.0.1", "AcknowledgeFastStop", "E_ACCESS_DENIED"], "{refused}");
    cell.gateway.post("acknowledge", &json!({"fast_stop_id": stopped["fast_stop_id"]})).await.ok();
    assert_eq!(driver.status(0x24, b"ack").await, SUCCESS, "nothing is latched");
}

#[tokio::test]
async fn acknowledge_any_allows_every_driver() {
    let device = Simulator::start(&[]).await;
    let text = format!(
        "[grippers.g]\nurl = \"tcp://{}\"\nwsg_port = \"127.0.0.1:0\"\nwsg_port_acknowledge = \"any\"\n",
        device.address
    );
    let gateway = super::configured(&text).await;
    let mut driver = super::connect(&gateway).await;
    gateway.post("fast-stop", &json!({})).await.ok();
    assert_eq!(driver.status(0x24, b"ack").await, SUCCESS);
    assert_eq!(gateway.state().await["fast_stop"], false);
}

#[tokio::test]
async fn next_driver_of_the_host_acknowledges_a_lost_clients_latch() {
    let cell = Cell::homed().await;
    for holder in [true, false] {
        let mut driver = cell.driver().await;
        assert_eq!(driver.status(MOVE, &move_to(10.0, 5.0)).await, PENDING);
        cell.gateway.until_moving().await;
        driver.reset();
        cell.gateway.until("confirmed", |state| state["fast_stop_confirmed"] == true).await;
        let mut next = cell.driver().await;
        if holder {
            // Another client has taken over in the meantime.
            let lease = cell.gateway.post("lease", &json!({"ttl_ms": 60_000})).await.ok();
            assert_eq!(next.status(0x24, b"ack").await, ACCESS_DENIED);
            let release = cell.gateway.request("DELETE", "lease").header("Wsg-Lease", lease["token"].as_str().unwrap());
            cell.gateway.send(release).await.ok();
        }
        assert_eq!(next.status(0x24, b"ack").await, SUCCESS);
        assert_eq!(next.run(MOVE, &move_to(90.0, 400.0)).await, SUCCESS);
        next.leave().await;
    }
}

#[tokio::test]
async fn fast_stop_and_acknowledge_in_one_write_keep_their_order() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    let both = [crate::harness::wsg::request(0x23, &[]), crate::harness::wsg::request(0x24, b"ack")].concat();
    driver.send_raw(&both).await;
    let replies = [driver.next().await, driver.next().await];
    assert_eq!(replies.map(|reply| (reply.id, reply.status)), [(0x23, SUCCESS), (0x24, SUCCESS)]);
    let second = driver.status(MOVE, &move_to(50.0, 200.0)).await;
    assert!(second != ALREADY_RUNNING && second != CMD_FAILED && second == PENDING);
}

#[tokio::test]
async fn fault_under_a_foreign_lease_is_left_to_its_holder() {
    let (device, control) = Simulator::with_control().await;
    let (gateway, port) = Gateway::with_port(device.address, &[]).await;
    let mut driver = crate::harness::wsg::Driver::connect(port).await;
    let fault = r#"{"finger_over_current": {"finger": 1, "on": true}}"#;
    let changed = reqwest::Client::new().post(&control).body(fault).send().await.unwrap();
    assert_eq!(changed.status(), 200);
    gateway.until("the fault", |state| state["fault_code"] == 23).await;
    let lease = gateway.post("lease", &json!({"holder": "cell"})).await.ok();
    // Drivers that start by 24h expect success while nothing is latched.
    assert_eq!(driver.status(0x24, b"ack").await, SUCCESS);
    assert!(gateway.events("kind=acknowledge", 0).await.is_empty());
    let body = json!({"lease": lease["token"]});
    assert_eq!(gateway.post("acknowledge", &body).await.ok()["fast_stop_id"], serde_json::Value::Null);
    let acknowledged = gateway.events("kind=acknowledge", 1).await;
    assert_eq!(acknowledged[0]["subject"], "http:127.0.0.1", "{acknowledged:?}");
}
