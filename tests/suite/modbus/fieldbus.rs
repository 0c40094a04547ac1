//! The gripper's own cyclic image.

use serde_json::json;
use tokio_modbus::client::Reader as _;
use wsg_gateway::wsg::id;

use super::{Cell, Plc};
use crate::harness::eventually;

/// Command flags, in the high byte of register 0.
const MOVE: u16 = 0x0100;
const GRASP: u16 = 0x0200;
const RELEASE: u16 = 0x0400;
const HOMING: u16 = 0x0800;
const STOP_OR_ACKNOWLEDGE: u16 = 0x1000;
const FAST_STOP_FLAG: u16 = 0x2000;
const JOG_OPEN: u16 = 0x4000;
const JOG_CLOSE: u16 = 0x8000;

/// Gripper states.
const HOLDING: u16 = 4;

/// Statuses.
const SUCCESS: u16 = 0;
const PENDING: u16 = 26;
const ACCESS_DENIED: u16 = 16;

/// A controller with the cyclic image.
struct Image {
    plc: Plc,
}

impl Image {
    async fn flags(&mut self, flags: u16, width: u16, speed: u16, force: u16) {
        self.plc.write(0, &[flags, width, speed, force]).await.unwrap();
    }

    /// Executes a flag, and waits until its command has ended.
    async fn execute(&mut self, flag: u16, width: u16, speed: u16, force: u16) -> [u16; 6] {
        self.flags(0, width, speed, force).await;
        self.flags(flag, width, speed, force).await;
        self.until("ended", |inputs| inputs[5] != PENDING).await
    }

    async fn until(&mut self, what: &str, wanted: impl Fn(&[u16; 6]) -> bool) -> [u16; 6] {
        let ends = tokio::time::Instant::now() + crate::harness::DEADLINE;
        loop {
            let inputs: [u16; 6] = self.plc.inputs(0, 6).await.try_into().unwrap();
            if wanted(&inputs) {
                return inputs;
            }
            assert!(tokio::time::Instant::now() < ends, "{what}: {inputs:?}");
            tokio::task::yield_now().await;
        }
    }
}

#[tokio::test]
async fn program_for_the_fieldbus_moves_the_gripper() {
    let cell = Cell::start().await;
    let mut image = Image { plc: Plc::connect(cell.address).await };
    let homed = image.execute(HOMING, 0, 0, 0).await;
    assert_eq!((homed[5], homed[2] & 1), (SUCCESS, 1), "REFERENCED: {homed:?}");
    let moved = image.execute(MOVE, 3000, 10_000, 0).await;
    assert!(moved[5] == SUCCESS && moved[3].abs_diff(3000) < 50, "{moved:?}");
    let held = image.execute(GRASP, 2000, 10_000, 3000).await;
    assert_eq!((held[5], held[0] >> 8), (SUCCESS, HOLDING), "{held:?}");
    assert!(held[4].abs_diff(3000) < 200, "{held:?}");
    assert_eq!(image.execute(RELEASE, 4000, 10_000, 0).await[5], SUCCESS);
    let motions = cell.proxy.frames.motions();
    image.flags(RELEASE, 4500, 10_000, 0).await;
    assert_eq!(cell.proxy.frames.motions(), motions, "no edge");

    // A flag that ends a jog stops the fingers, and executes nothing else.
    for next in [0, JOG_CLOSE, HOMING] {
        image.flags(0, 0, 500, 0).await;
        image.flags(JOG_OPEN, 0, 500, 0).await;
        cell.gateway.until_moving().await;
        image.flags(next, 0, 500, 0).await;
        let standing = cell.gateway.until_standing().await;
        assert!(standing["width_mm"].as_f64().unwrap() < 100.0, "{standing}");
    }
    // A second JOG is refused while the first moves the fingers.
    image.flags(0, 0, 500, 0).await;
    image.flags(JOG_CLOSE, 0, 500, 0).await;
    cell.gateway.until_moving().await;
    image.flags(JOG_CLOSE | JOG_OPEN, 0, 500, 0).await;
    assert_eq!(image.until("refused", |inputs| inputs[5] != PENDING).await[5], ACCESS_DENIED);
    image.flags(0, 0, 500, 0).await;
    let standing = cell.gateway.until_standing().await;
    assert!(standing["width_mm"].as_f64().unwrap() > 10.0, "{standing}");
}

#[tokio::test]
async fn refused_jog_stops_no_other_client() {
    let cell = Cell::start().await;
    let mut image = Image { plc: Plc::connect(cell.address).await };
    cell.gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let command = cell.gateway.begin("move", &json!({"width_mm": 30, "speed_mm_s": 50})).await;
    cell.gateway.until_moving().await;
    assert_eq!(image.execute(JOG_OPEN, 0, 500, 0).await[5], ACCESS_DENIED);
    image.flags(0, 0, 500, 0).await;
    cell.gateway.command(&command).await.outcome("SUCCESS");
    assert_eq!(cell.proxy.frames.count(id::STOP), 0);
}

#[tokio::test]
async fn unread_fast_stop_is_not_acknowledged() {
    let cell = Cell::start().await;
    let mut image = Image { plc: Plc::connect(cell.address).await };
    image.flags(0, 0, 0, 0).await;
    image.flags(FAST_STOP_FLAG, 0, 0, 0).await;
    let latched = async || (cell.gateway.state().await["fast_stop_confirmed"] == true).then_some(());
    eventually("latched", latched).await;
    image.flags(0, 0, 0, 0).await;
    image.flags(STOP_OR_ACKNOWLEDGE, 0, 0, 0).await;
    image.flags(0, 0, 0, 0).await;
    // Function code 23 writes before it reads.
    let client = &mut image.plc.client;
    client.read_write_multiple_registers(1000, 6, 0, &[STOP_OR_ACKNOWLEDGE]).await.unwrap().unwrap();
    let refused = image.until("refused", |inputs| inputs[5] != PENDING).await;
    assert_eq!(refused[5], ACCESS_DENIED, "not read yet");
    image.flags(0, 0, 0, 0).await;
    image.plc.inputs(0, 6).await;
    cell.gateway.post("fast-stop", &json!({})).await.ok();
    image.flags(STOP_OR_ACKNOWLEDGE, 0, 0, 0).await;
    let refused = image.until("refused", |inputs| inputs[5] != PENDING).await;
    assert_eq!(refused[5], ACCESS_DENIED, "there is a newer one");
    image.flags(0, 0, 0, 0).await;
    image.flags(STOP_OR_ACKNOWLEDGE, 0, 0, 0).await;
    cell.gateway.until("acknowledged", |state| state["fast_stop"] == false).await;
}
