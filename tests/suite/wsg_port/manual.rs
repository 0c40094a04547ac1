//! The port behaves like the device where the manual names the behaviour.

use serde_json::json;

use super::{ABORTED, ACCESS_DENIED, Cell, MOVE, NOT_INITIALIZED, RANGE_ERROR, SUCCESS};
use crate::harness::wsg::{Driver, PENDING, floats, move_to};
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
