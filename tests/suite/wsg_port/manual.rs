//! The port behaves like the device where the manual names the behaviour.

use std::time::Duration;

use serde_json::json;

use super::{ABORTED, ACCESS_DENIED, Cell, FORMAT_ERROR, MOVE, NOT_INITIALIZED, RANGE_ERROR, SUCCESS};
use crate::harness::wsg::{Driver, PENDING, Reply, floats, move_to};
use crate::harness::{Gateway, Proxy, Simulator};

const SET_SOFT_LIMITS: u8 = 0x34;
const POWER: u8 = 0x72;

/// A device of each firmware, behind a gateway, and another on its own. Both are homed.
async fn port_and_device(firmware: &str) -> (Cell, Driver, Simulator, Driver) {
    let options = ["--firmware", firmware];
    let (behind, alone) = (Simulator::start(&options).await, Simulator::start(&options).await);
    let proxy = Proxy::to(behind.address);
    let (gateway, port) = Gateway::with_port(proxy.address, &[]).await;
    let cell = Cell { _device: behind, proxy, gateway, port };
    let (mut port, mut device) = (cell.driver().await, Driver::connect(alone.address).await);
    for driver in [&mut port, &mut device] {
        assert_eq!(driver.status(MOVE, &move_to(10.0, 10.0)).await, NOT_INITIALIZED);
        assert_eq!(driver.run(0x20, &[0]).await, SUCCESS);
    }
    (cell, port, alone, device)
}

/// `fw4-en 3.2.4`: all motion commands produce `E_ACCESS_DENIED` during a FAST STOP.
#[tokio::test]
async fn fast_stop_and_lease_are_reported_before_values() {
    for firmware in ["fw2", "fw4"] {
        let (cell, mut port, _alone, mut device) = port_and_device(firmware).await;
        for driver in [&mut port, &mut device] {
            assert_eq!(driver.status(SET_SOFT_LIMITS, &floats(&[10.0, 60.0])).await, SUCCESS);
            assert_eq!(driver.status(MOVE, &move_to(5.0, 100.0)).await, RANGE_ERROR);
        }
        assert_eq!(cell.driver().await.status(MOVE, &move_to(5.0, 100.0)).await, ACCESS_DENIED, "the lease");
        let beyond = json!({"width_mm": 5000, "speed_mm_s": 50});
        let outside = json!({"width_mm": 5, "speed_mm_s": 50});
        for body in [&beyond, &outside] {
            assert_eq!(cell.gateway.post("move", body).await.body["code"], "lease_held");
        }
        let force = json!({"force_n": 5000});
        assert_eq!(cell.gateway.put("settings/force-limit", &force).await.body["code"], "lease_held");
        for driver in [&mut port, &mut device] {
            assert_eq!(driver.status(0x23, &[]).await, SUCCESS);
            for (id, parameters) in
                [(MOVE, move_to(5.0, 100.0)), (0x25, floats(&[5.0, 50.0])), (0x26, floats(&[5.0, 50.0]))]
            {
                assert_eq!(driver.status(id, &parameters).await, ACCESS_DENIED, "{id:02X}h {firmware}");
            }
        }
        for body in [&beyond, &outside] {
            assert_eq!(cell.gateway.post("move", body).await.body["code"], "fast_stop");
        }
        port.leave().await;
    }
}

/// `fw4-en 3.3.5`: outside the soft limits, only the direction back is allowed.
#[tokio::test]
async fn fingers_outside_the_soft_limits_may_move_towards_them() {
    for firmware in ["fw2", "fw4"] {
        let (_cell, mut port, _alone, mut device) = port_and_device(firmware).await;
        for driver in [&mut port, &mut device] {
            assert_eq!(driver.run(MOVE, &move_to(70.0, 400.0)).await, SUCCESS);
            assert_eq!(driver.status(SET_SOFT_LIMITS, &floats(&[20.0, 50.0])).await, SUCCESS);
            assert_eq!(driver.status(MOVE, &move_to(75.0, 100.0)).await, RANGE_ERROR);
            assert_eq!(driver.run(MOVE, &move_to(60.0, 100.0)).await, SUCCESS);
            assert_eq!(driver.status(MOVE, &move_to(70.0, 100.0)).await, RANGE_ERROR);
            assert_eq!(driver.status(MOVE, &move_to(15.0, 100.0)).await, RANGE_ERROR);
            assert_eq!(driver.run(MOVE, &move_to(40.0, 100.0)).await, SUCCESS);
        }
    }
}

/// `fw4-en 3.6.3`: off is immediate, also while the finger powers up.
#[tokio::test]
async fn finger_power_off_does_not_wait() {
    let (_cell, mut port, _alone, mut device) = port_and_device("fw4").await;
    for driver in [&mut port, &mut device] {
        assert_eq!(driver.status(POWER, &[1]).await, PENDING);
        let begin = std::time::Instant::now();
        driver.send(POWER, &[0]).await;
        let mut statuses = [driver.next().await.status, driver.next().await.status];
        statuses.sort_unstable();
        assert_eq!(statuses, [SUCCESS, ABORTED], "the power-up is over");
        let took = begin.elapsed();
        assert!(took.as_millis() < 400, "{took:?}: powering up takes 500 ms");
        let flags = driver.ask(0x71, &[]).await;
        assert_eq!((flags.status, flags.data[0] & 1), (SUCCESS, 0));
    }
}

const MOVING: u32 = 1 << 1;
const SOFT_LIMIT_PLUS: u32 = 1 << 5;
const AXIS_STOPPED: u32 = 1 << 6;
const FAST_STOP: u32 = 1 << 12;
const CMD_FAILURE: u32 = 1 << 18;

/// Sends a request, and returns its reply and the other frames before it.
async fn reply_among(driver: &mut Driver, id: u8, payload: &[u8]) -> (Reply, Vec<Reply>) {
    driver.send(id, payload).await;
    let mut others = Vec::new();
    loop {
        let reply = driver.next().await;
        if reply.id == id {
            return (reply, others);
        }
        others.push(reply);
    }
}

async fn state(driver: &mut Driver) -> u8 {
    driver.ask(0x41, &[0; 3]).await.data[0]
}

/// The effect precedes the reply on the device, so the next query shows it.
#[tokio::test]
async fn query_after_a_change_shows_it() {
    for firmware in ["fw2", "fw4"] {
        let (_cell, mut port, _alone, mut device) = port_and_device(firmware).await;
        for driver in [&mut port, &mut device] {
            assert_eq!(driver.status(MOVE, &move_to(60.0, 20.0)).await, PENDING);
            assert_eq!(driver.flags().await & (MOVING | AXIS_STOPPED), MOVING, "{firmware}");
            assert_eq!(state(driver).await, 6, "{firmware}");
            let (stop, mut others) = reply_among(driver, 0x22, &[]).await;
            assert_eq!(stop.status, SUCCESS);
            let (flags, further) = reply_among(driver, 0x40, &[0; 3]).await;
            let flags = u32::from_le_bytes(flags.data.try_into().unwrap());
            assert_eq!(flags & (MOVING | AXIS_STOPPED), AXIS_STOPPED, "{firmware}");
            others.extend(further);
            if others.is_empty() {
                others.push(driver.next().await);
            }
            assert_eq!((others[0].id, others[0].status), (MOVE, ABORTED));
            assert_eq!(driver.status(SET_SOFT_LIMITS, &floats(&[20.0, 50.0])).await, SUCCESS);
            assert_eq!(driver.flags().await & SOFT_LIMIT_PLUS, SOFT_LIMIT_PLUS, "{firmware}");
            assert_eq!(driver.status(0x36, &[]).await, SUCCESS);
            assert_eq!(driver.flags().await & SOFT_LIMIT_PLUS, 0, "{firmware}");
            assert_eq!(driver.status(0x23, &[]).await, SUCCESS);
            assert_eq!(state(driver).await, if firmware == "fw4" { 7 } else { 0 }, "{firmware}");
            assert_eq!(driver.flags().await & FAST_STOP, FAST_STOP, "{firmware}");
            assert_eq!(driver.status(0x24, b"ack").await, SUCCESS);
            assert_eq!(driver.flags().await & FAST_STOP, 0, "{firmware}");
        }
    }
}

/// CMD_FAILURE says that the last request failed: that of the same client, whoever has refused it.
#[tokio::test]
async fn failure_flag_is_about_the_clients_own_last_request() {
    for firmware in ["fw2", "fw4"] {
        let (cell, mut port, _alone, mut device) = port_and_device(firmware).await;
        for driver in [&mut port, &mut device] {
            assert_eq!(driver.status(0x36, &[]).await, SUCCESS);
            assert_eq!(driver.flags().await & CMD_FAILURE, 0, "cleared soft limits, {firmware}");
            for (id, parameters, status) in [(0x35, vec![], 1), (0x32, vec![1], FORMAT_ERROR), (0xB9, vec![], 14)] {
                assert_eq!(driver.status(id, &parameters).await, status, "{id:02X}h {firmware}");
                assert_eq!(driver.flags().await & CMD_FAILURE, CMD_FAILURE, "{id:02X}h {firmware}");
                assert_eq!(driver.flags().await & CMD_FAILURE, 0, "the query itself succeeded, {firmware}");
            }
        }
        // The reads of others fail.
        assert_eq!(port.status(0x40, &[3, 10, 0]).await, SUCCESS);
        let mut other = cell.driver().await;
        assert_eq!(other.status(0x35, &[]).await, 1);
        cell.gateway.until("the device shows it", has_failed).await;
        assert_eq!(port.next_within(Duration::from_millis(100)).await, None, "{firmware}");
        assert_eq!(other.flags().await & CMD_FAILURE, CMD_FAILURE);
    }
}

fn has_failed(state: &serde_json::Value) -> bool {
    state["flags"].as_array().is_some_and(|flags| flags.iter().any(|flag| flag == "CMD_FAILURE"))
}
