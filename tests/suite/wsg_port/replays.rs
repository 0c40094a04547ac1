//! Frames of public drivers, composed as in each driver's source (`tests/recordings/drivers`).

use std::net::SocketAddr;
use std::time::{Duration, Instant};

use serde_json::json;
use tokio::net::UdpSocket;

use super::{Cell, SUCCESS, configured, connect};
use crate::harness::wsg::{Driver, PENDING};
use crate::harness::{DEADLINE, Gateway, Scripted, Simulator, Table, eventually, success};
use crate::recordings;

const REFERENCED: u32 = 1;
const MOVING: u32 = 1 << 1;

/// Steps of a driver's session, each with its frames.
fn steps<const N: usize>(driver: &str) -> [Vec<Vec<u8>>; N] {
    let steps = recordings::read(&format!("drivers/{driver}"));
    let frames = |step: recordings::Exchange| step.requests.iter().map(|line| recordings::bytes(line)).collect();
    steps.into_iter().map(frames).collect::<Vec<_>>().try_into().unwrap()
}

/// Sends the frames one after the other, and returns the final status of each.
async fn replay(driver: &mut Driver, frames: &[Vec<u8>]) -> Vec<u16> {
    let mut statuses = Vec::new();
    for frame in frames {
        driver.send_raw(frame).await;
        let mut reply = driver.next().await;
        while reply.status == PENDING {
            reply = driver.next().await;
        }
        assert_eq!(reply.id, frame[3]);
        statuses.push(reply.status);
    }
    statuses
}

/// A device with scripts, whose fingers move when the test says so.
async fn scripted() -> (Scripted, Gateway) {
    let scripts = [0xB0, 0xB1, 0xB2].map(|id| (id, vec![success(&[id])]));
    let device = Scripted::start(Table::from(scripts)).await;
    let text = format!("[grippers.g]\nurl = \"tcp://{}\"\nwsg_port = \"127.0.0.1:0\"\n", device.address);
    let gateway = configured(&text).await;
    (device, gateway)
}

#[tokio::test]
async fn driver_starts_again_after_its_own_loss_and_after_the_devices_fast_stop() {
    let [start, _, steer, stop] = steps("umi");
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    assert_eq!(replay(&mut driver, &start).await, [SUCCESS; 2]);
    assert_eq!(driver.status(0x21, &crate::harness::wsg::move_to(5.0, 5.0)).await, PENDING);
    cell.gateway.until_moving().await;
    driver.reset();
    cell.gateway.until("its loss", |state| state["fast_stop_confirmed"] == true).await;
    let mut driver = cell.driver().await;
    assert_eq!(replay(&mut driver, &start).await, [SUCCESS; 2], "the blind 24h clears the driver's own loss");
    replay(&mut driver, &stop).await;
    driver.leave().await;
    assert_eq!(steer.len(), 1);
    // Another client requested this FAST STOP.
    cell.gateway.post("fast-stop", &json!({})).await.ok();
    let mut driver = cell.driver().await;
    assert_eq!(replay(&mut driver, &start[..1]).await, [super::ACCESS_DENIED]);
}

#[tokio::test]
async fn script_that_reads_takes_no_lease_and_its_end_stops_nothing() {
    let (device, gateway) = scripted().await;
    for driver in ["umi", "nalt"] {
        let read: Vec<Vec<u8>> = recordings::read(&format!("drivers/{driver}"))[1]
            .requests
            .iter()
            .map(|line| recordings::bytes(line))
            .collect();
        let mut driver = connect(&gateway).await;
        for _ in 0..70 {
            assert_eq!(replay(&mut driver, &read).await, [SUCCESS]);
        }
        // Ctrl-C in the middle of a read.
        driver.send_raw(&read[0]).await;
        driver.reset();
    }
    eventually("the last read", async || (device.frames.count(0xB0) >= 141).then_some(())).await;
    let state = gateway.state().await;
    assert_eq!(
        (&state["fast_stop"], &state["lease_holder"], &state["lease_epoch"]),
        (&json!(false), &json!(null), &json!(0))
    );
    assert_eq!((device.frames.count(0x23), gateway.events("kind=command", 0).await.len()), (0, 0));
}

#[tokio::test]
async fn script_that_steers_takes_the_lease_once_the_fingers_move() {
    let [_, _, to_width, at_speed] = steps::<4>("nalt");
    // The ids of nalt's scripts, and of a site that steers with B0h.
    for frame in [to_width, at_speed, vec![crate::harness::wsg::request(0xB0, &[1; 9])]] {
        let (device, gateway) = scripted().await;
        let (mut driver, mut other) = (connect(&gateway).await, connect(&gateway).await);
        replay(&mut driver, &frame).await;
        assert_eq!(gateway.state().await["lease_holder"], json!(null), "nothing moves");
        replay(&mut driver, &frame).await;
        device.flags(REFERENCED | MOVING);
        gateway.until("the lease", |state| state["lease_holder"] == "wsg:127.0.0.1").await;
        assert_eq!(replay(&mut other, &frame).await, [super::ACCESS_DENIED]);
        assert_eq!(replay(&mut driver, &frame).await, [SUCCESS]);
        // The lease outlives its time to live.
        let taken = Instant::now();
        eventually("a longer silence", async || (taken.elapsed() > Duration::from_millis(3500)).then_some(())).await;
        assert_eq!(gateway.state().await["lease_holder"], "wsg:127.0.0.1");
        driver.reset();
        let state = gateway.until("the loss", |state| state["fast_stop_cause"] == "client_lost").await;
        assert_eq!(state["lease_holder"], json!(null));
    }
}

#[tokio::test]
async fn fingers_that_begin_to_move_after_a_loss_are_stopped() {
    let (device, gateway) = scripted().await;
    let [_, _, steer, _] = steps::<4>("nalt");
    let mut driver = connect(&gateway).await;
    assert_eq!(replay(&mut driver, &steer).await, [SUCCESS]);
    driver.reset();
    device.flags(REFERENCED | MOVING);
    let state = gateway.until("the loss", |state| state["fast_stop_cause"] == "client_lost").await;
    assert_eq!(state["fast_stop_by"], "wsg:127.0.0.1");
    assert!(gateway.events("kind=device", 0).await.iter().all(|event| event["event"] != "foreign_motion"));
}

#[tokio::test]
async fn script_is_refused_in_fast_stop() {
    let (device, gateway) = scripted().await;
    let [_, read, ..] = steps::<4>("nalt");
    gateway.post("fast-stop", &json!({})).await.ok();
    let mut driver = connect(&gateway).await;
    assert_eq!(replay(&mut driver, &read).await, [super::ACCESS_DENIED]);
    assert_eq!(device.frames.count(0xB0), 0);
    gateway.until_logged("remedy").await;
    let figures = gateway.figures().await;
    let series = "wsg_port_refused_total{gripper=\"g\",status=\"E_ACCESS_DENIED\"}";
    assert_eq!(figures.get(series), Some(&1.0));
}

/// A driver that sends and receives on two sockets.
struct Datagrams {
    sender: UdpSocket,
    receiver: UdpSocket,
    port: SocketAddr,
    gateway: Gateway,
    _device: Simulator,
}

impl Datagrams {
    async fn new(options: &str) -> Self {
        let device = Simulator::with_part().await;
        let sender = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let receiver = UdpSocket::bind("127.0.0.1:0").await.unwrap();
        let replies = receiver.local_addr().unwrap().port();
        let gripper = format!("g=tcp://{}", device.address);
        let port = format!("g=udp://127.0.0.1:0?reply_port={replies}{options}");
        let gateway = Gateway::start(&["--gripper", &gripper, "--wsg-port", &port]).await;
        gateway.until_link("connected").await;
        let port = gateway.word_after("WSG port of g: udp://").await.parse().unwrap();
        Self { sender, receiver, port, gateway, _device: device }
    }

    async fn send(&self, frames: &[Vec<u8>]) {
        for frame in frames {
            self.sender.send_to(frame, self.port).await.unwrap();
        }
    }

    /// Waits for a reply of this id, and returns its status and data.
    async fn next(&self, id: u8) -> (u16, Vec<u8>) {
        let reading = async {
            let mut datagram = [0; 512];
            loop {
                let read = self.receiver.recv(&mut datagram).await.unwrap();
                if datagram[3] == id {
                    return (u16::from_le_bytes([datagram[6], datagram[7]]), datagram[8..read - 2].to_vec());
                }
            }
        };
        tokio::time::timeout(DEADLINE, reading).await.expect("a datagram")
    }

    async fn end_of(&self, id: u8) -> u16 {
        loop {
            let (status, _) = self.next(id).await;
            if status != PENDING {
                return status;
            }
        }
    }
}

#[tokio::test]
async fn silent_udp_driver_keeps_its_updates_and_executes_its_next_command() {
    let [start, updates, move_to] = steps::<3>("drake");
    let driver = Datagrams::new("&lost_after_ms=200").await;
    // Homing takes longer than the driver may be silent.
    driver.gateway.post("home", &json!({})).await.outcome("SUCCESS");
    driver.send(&start[..1]).await;
    assert_eq!(driver.next(0x53).await.0, SUCCESS);
    driver.send(&updates).await;
    driver.next(0x43).await;
    let silent = Instant::now();
    while silent.elapsed() < Duration::from_secs(1) {
        assert_eq!(driver.next(0x43).await.0, SUCCESS);
    }
    // The driver still gets new positions.
    driver.gateway.post("move", &json!({"width_mm": 90, "speed_mm_s": 400})).await.outcome("SUCCESS");
    eventually("the new width", async || {
        let (_, width) = driver.next(0x43).await;
        (f32::from_le_bytes(width.try_into().unwrap()) < 91.0).then_some(())
    })
    .await;
    driver.send(&move_to).await;
    let (status, _) = driver.next(0x21).await;
    assert_eq!(status, PENDING, "the next command is executed");
}

#[tokio::test]
async fn closed_udp_port_loses_the_client_at_once() {
    let [start, updates, move_to] = steps::<3>("drake");
    let driver = Datagrams::new("&lost_after_ms=60000").await;
    driver.send(&start).await;
    assert_eq!(driver.end_of(0x20).await, SUCCESS);
    driver.send(&updates).await;
    driver.send(&move_to).await;
    driver.gateway.until_moving().await;
    let Datagrams { receiver, gateway, .. } = driver;
    let dead = Instant::now();
    drop(receiver);
    gateway.until("the loss", |state| state["fast_stop_cause"] == "client_lost").await;
    assert!(dead.elapsed() < Duration::from_secs(2), "{:?}", dead.elapsed());
}

#[tokio::test]
async fn restarted_udp_driver_gets_no_updates_of_its_predecessor() {
    let [_, updates, _] = steps::<3>("drake");
    let mut driver = Datagrams::new("&lost_after_ms=200").await;
    driver.send(&updates).await;
    driver.next(0x45).await;
    let silent = Instant::now();
    eventually("silence", async || (silent.elapsed() > Duration::from_millis(300)).then_some(())).await;
    driver.sender = UdpSocket::bind("127.0.0.1:0").await.unwrap();
    driver.send(&[crate::harness::wsg::request(0x06, b"x")]).await;
    assert_eq!(driver.next(0x06).await.0, SUCCESS);
    let update = tokio::time::timeout(Duration::from_millis(300), driver.next(0x43)).await;
    assert!(update.is_err(), "{update:?}");
}
