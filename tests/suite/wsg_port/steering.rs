//! Clients that steer the fingers of an independent device, in the two public protocols.

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use serde_json::json;
use tokio::time::{MissedTickBehavior, interval};

use super::{ABORTED, SUCCESS, configured, connect};
use crate::harness::wsg::{Driver, floats};
use crate::harness::{Gateway, STEER, Simulator, Steered, Target, eventually, shortest};

const STOP: u8 = 0x22;

/// Time of silence after which a Stop comes, in the configuration of these tests.
const SILENCE: Duration = Duration::from_millis(500);

async fn cell(period: Duration) -> (Steered, Gateway) {
    let device = Steered::start(period).await;
    let gateway = gateway_of(device.address, STEER).await;
    (device, gateway)
}

async fn gateway_of(device: SocketAddr, script: u8) -> Gateway {
    let port = "wsg_port = \"127.0.0.1:0\"";
    configured(&format!("[grippers.g]\nurl = \"tcp://{device}\"\nstream_ids = [{script}]\n{port}\n")).await
}

/// Width and speed, in 9 bytes.
fn width(width_mm: f32) -> Vec<u8> {
    [vec![0], floats(&[width_mm, 10.0])].concat()
}

/// Position, speed, gains and force limits, in 25 bytes. The gain makes the fingers as slow as with [`width`].
fn gains(width_mm: f32) -> Vec<u8> {
    [vec![0], floats(&[width_mm, 0.0, 0.1, 0.001, 80.0, 80.0])].concat()
}

/// Sends targets 50 times a second, like drivers that wait for each reply.
async fn steer(driver: &mut Driver, target: &[u8], requests: u32) {
    let mut due = interval(Duration::from_millis(20));
    due.set_missed_tick_behavior(MissedTickBehavior::Delay);
    for _ in 0..requests {
        due.tick().await;
        assert_eq!(driver.status(STEER, target).await, SUCCESS);
    }
}

/// Waits until a stream that a Stop holds off may begin anew.
async fn pause() {
    let until = Instant::now() + Duration::from_millis(500);
    eventually("the pause is over", async || (Instant::now() > until).then_some(())).await;
}

#[tokio::test]
async fn silent_client_is_stopped_in_time() {
    for target in [width(0.0), gains(0.0)] {
        let (device, gateway) = cell(Duration::from_millis(5)).await;
        let mut driver = connect(&gateway).await;
        let limit = SILENCE + Duration::from_millis(20);
        let time = shortest(limit, async || {
            steer(&mut driver, &target, 50).await;
            let stops = device.frames.count(STOP);
            assert!(device.moves(), "the fingers go on without the client");
            eventually("a Stop", async || (device.frames.count(STOP) > stops).then_some(())).await;
            assert!(!device.moves());
            let last = device.targets().pop().unwrap().arrived_at;
            let time = device.frames.first_since(STOP, last).unwrap() - last;
            assert!(time >= SILENCE, "a Stop after {time:?}");
            assert!(device.width_mm() > 50.0);
            pause().await;
            time
        })
        .await;
        assert!(time <= limit, "a Stop after {time:?}");
        driver.leave().await;
    }
}

#[tokio::test]
async fn newest_target_is_young_although_the_script_is_slower() {
    let (device, gateway) = cell(Duration::from_millis(25)).await;
    let mut driver = connect(&gateway).await;
    // 50 ms on an idle machine; the oldest of 100 targets that wait in a row would be 1.5 s old.
    let limit = Duration::from_millis(100);
    let oldest = shortest(limit, async || {
        let first = device.targets().len();
        let mut due = interval(Duration::from_millis(10));
        let mut sent = Vec::new();
        for number in 0..100_u8 {
            due.tick().await;
            sent.push(Instant::now());
            driver.send(STEER, &width(f32::from(number))).await;
        }
        for _ in 0..100 {
            assert_eq!(driver.next().await.status, SUCCESS);
        }
        let targets = device.targets();
        assert!(targets.len() - first < 100, "the script is too slow for all targets");
        let age = |target: &Target| target.taken_at - sent[target.width_mm as usize];
        targets[first..].iter().map(age).max().unwrap()
    })
    .await;
    assert!(oldest <= limit, "the oldest target was {oldest:?} old");
}

#[tokio::test]
async fn no_target_follows_a_stop_of_another_client() {
    let (device, gateway) = cell(Duration::ZERO).await;
    let mut driver = connect(&gateway).await;
    for _ in 0..5 {
        assert_eq!(driver.status(STEER, &width(0.0)).await, SUCCESS);
        for _ in 0..10 {
            driver.send(STEER, &width(0.0)).await;
        }
        gateway.post("stop", &json!({})).await.ok();
        let stopped_at = device.frames.all().iter().rfind(|frame| frame.id == STOP).unwrap().at;
        for _ in 0..10 {
            driver.next().await;
        }
        let until = Instant::now() + Duration::from_millis(300);
        while Instant::now() < until {
            assert_eq!(driver.status(STEER, &width(0.0)).await, ABORTED);
        }
        assert_eq!(device.frames.first_since(STEER, stopped_at), None);
        assert!(!device.moves());
        pause().await;
    }
}

#[tokio::test]
async fn simulated_scripts_move_the_fingers_until_the_client_is_silent() {
    let with_watchdog = floats(&[0.0, 10.0]);
    for (script, id, target) in
        [("pd", STEER, gains(0.0)), ("width", STEER, width(0.0)), ("watchdog", 0xB4, with_watchdog)]
    {
        let device = Simulator::start(&["--option", &format!("steering={script}")]).await;
        let gateway = gateway_of(device.address, id).await;
        gateway.post("home", &json!({})).await.outcome("SUCCESS");
        let mut driver = connect(&gateway).await;
        while gateway.state().await["moving"] != true {
            assert_eq!(driver.status(id, &target).await, SUCCESS, "{script}");
        }
        let state = gateway.until("the fingers stop", |state| state["moving"] == false).await;
        assert!(state["width_mm"].as_f64().unwrap() > 50.0, "{script}: {state}");
        // The watchdog of the script is faster than the gateway, which records a Stop of its own.
        let expected = usize::from(script != "watchdog");
        eventually("the record of the Stop", async || {
            let events = gateway.events("kind=device", 1).await;
            (events.iter().filter(|event| event["event"] == "stream_silent").count() == expected).then_some(())
        })
        .await;
        driver.leave().await;
    }
}
