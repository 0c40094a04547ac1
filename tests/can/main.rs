//! Tests on a real SocketCAN interface. They are excluded from plain `cargo test`, so that a machine without CAN does
//! not count them as passed. Run them with `WSG_TEST_CAN=vcan0 cargo test --test can -- --test-threads=1`. The
//! interface must be up and used by nothing else; the tests take it down and up with `ip`, which needs the privilege.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

#[path = "../suite/conformance/mod.rs"]
mod conformance;
#[path = "../suite/recordings/mod.rs"]
#[allow(dead_code, reason = "recordings of other transports")]
mod recordings;

use std::process::Command as Process;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering};
use std::time::Duration;

use conformance::rig::{Rig, SOON, served, spawn};
use socketcan::tokio::CanSocket;
use socketcan::{
    CanErrorFrame, CanFilter, CanFrame, CanRemoteFrame, EmbeddedFrame, ExtendedId, SocketOptions, StandardId,
};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::time::{sleep, timeout};
use wsg_gateway::model::Link;
use wsg_gateway::transport::{Address, CanAddress};
use wsg_gateway::wsg::{Command, Data, LoopData, id};

fn interface() -> String {
    std::env::var("WSG_TEST_CAN").expect("WSG_TEST_CAN has to name a CAN interface that is up, e.g. WSG_TEST_CAN=vcan0")
}

/// Each device gets its own pair of ids.
fn next_id() -> u16 {
    static NEXT: AtomicU16 = AtomicU16::new(0x100);
    NEXT.fetch_add(2, Ordering::Relaxed)
}

fn device() -> String {
    let (interface, id) = (interface(), next_id());
    format!("can://{interface}?rx={id}&tx={}", id + 1)
}

conformance!(on_can, crate::device());

/// Returns a transport, and a bare socket on the same bus.
async fn pair() -> (wsg_gateway::transport::Pipe, CanSocket, CanAddress) {
    let tx = next_id();
    let address = CanAddress { interface: interface(), tx, rx: tx + 1, bitrate: 500_000 };
    let bus = CanSocket::open(&address.interface).unwrap();
    (Address::Can(address.clone()).connect().await.unwrap(), bus, address)
}

fn data_frame(id: u16, data: &[u8]) -> CanFrame {
    CanFrame::new(StandardId::new(id).unwrap(), data).unwrap()
}

const STOP: [u8; 8] = [0xAA, 0xAA, 0xAA, 0x22, 0, 0, 0x0E, 0x76];

#[tokio::test]
async fn bus_has_the_recorded_frames() {
    let (mut pipe, bus, address) = pair().await;
    for exchange in recordings::read("can") {
        let id = |line: &str| if line == "064" { address.tx } else { address.rx };
        for (n, request) in exchange.requests.iter().enumerate() {
            if n == 0 {
                pipe.writer.write_all(&exchange.request_bytes()).await.unwrap();
                pipe.writer.flush().await.unwrap();
            }
            let frame = timeout(SOON, bus.read_frame()).await.unwrap().unwrap();
            let (recorded_id, data) = recordings::can_frame(request);
            assert_eq!(frame.id(), StandardId::new(id(recorded_id)).unwrap().into(), "{request}");
            assert_eq!(frame.data(), data, "{request}");
        }
        for reply in &exchange.replies {
            let (recorded_id, data) = recordings::can_frame(reply);
            bus.write_frame(data_frame(id(recorded_id), &data)).await.unwrap();
        }
        let mut received = vec![0; exchange.reply_bytes().len()];
        timeout(SOON, pipe.reader.read_exact(&mut received)).await.unwrap().unwrap();
        assert_eq!(received, exchange.reply_bytes());
    }
}

#[tokio::test]
async fn unrelated_frames_are_ignored() {
    let (mut pipe, bus, address) = pair().await;
    bus.write_frame(data_frame(address.rx + 1, &STOP)).await.unwrap();
    let extended = ExtendedId::new(address.rx.into()).unwrap();
    bus.write_frame(CanFrame::new(extended, &STOP).unwrap()).await.unwrap();
    let remote = CanRemoteFrame::new_remote(StandardId::new(address.rx).unwrap(), 8).unwrap();
    bus.write_frame(CanFrame::Remote(remote)).await.unwrap();
    let harmless = CanErrorFrame::new_error(0x04, &[0, 0x04, 0, 0, 0, 0, 0, 0]).unwrap();
    bus.write_frame(CanFrame::Error(harmless)).await.unwrap();
    bus.write_frame(data_frame(address.rx, &STOP)).await.unwrap();
    let mut received = [0; 64];
    let bytes = timeout(SOON, pipe.reader.read(&mut received)).await.unwrap().unwrap();
    assert_eq!(received[..bytes], STOP);
}

#[tokio::test]
async fn cut_on_can_is_noticed() {
    conformance::cut_without_a_connection(&device()).await;
}

#[tokio::test]
async fn link_recovers_from_bus_off() {
    let rig = Rig::homed(&device()).await;
    let bus = CanSocket::open(&interface()).unwrap();
    let bus_off = CanErrorFrame::new_error(0x40, &[0; 8]).unwrap();
    bus.write_frame(CanFrame::Error(bus_off)).await.unwrap();
    rig.until("lost", SOON, |state| state.link_cause.as_ref().is_some_and(|cause| cause.contains("restart-ms 100")))
        .await;
    rig.link(Link::Connected, SOON).await;
    rig.drain().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn link_recovers_from_an_interface_that_was_down() {
    let rig = Rig::homed(&device()).await;
    let set = |state| {
        let done = Process::new("ip").args(["link", "set", &interface(), state]).status().expect("ip is installed");
        assert!(done.success(), "ip link set {} {state}", interface());
    };
    set("down");
    rig.until("lost", SOON, |state| !matches!(state.link, Link::Connected | Link::Unresponsive)).await;
    sleep(Duration::from_secs(1)).await;
    let cause = rig.handle.state().link_cause.clone().unwrap_or_default();
    set("up");
    assert!(cause.ends_with(&format!("is down: bring it up with sudo ip link set {} up", interface())), "{cause}");
    rig.link(Link::Connected, SOON).await;
    rig.drain().await;
}

/// Data that occurs only in the commands of this test.
const MARKED: [u8; 8] = [7; 8];

/// Forwards frames to another id, and drops the next marked frame when `loses` is set.
async fn carry(bus: CanSocket, to: u16, loses: Arc<AtomicBool>) {
    while let Ok(frame) = bus.read_frame().await {
        if frame.data() != MARKED || !loses.swap(false, Ordering::Relaxed) {
            bus.write_frame(data_frame(to, frame.data())).await.unwrap();
        }
    }
}

#[tokio::test]
async fn lost_can_frame_affects_only_one_command() {
    let device = served(&device()).await;
    let Address::Can(behind) = device.address else { panic!("the device is on CAN") };
    let tx = next_id();
    let before = CanAddress { tx, rx: tx + 1, ..behind.clone() };
    let (loses_request, loses_reply) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
    for (from, to, loses) in [(before.tx, behind.tx, &loses_request), (behind.rx, before.rx, &loses_reply)] {
        let bus = CanSocket::open(&interface()).unwrap();
        bus.set_filters(&[CanFilter::new(from.into(), 0x7FF)]).unwrap();
        tokio::spawn(carry(bus, to, loses.clone()));
    }
    let rig = Rig { handle: spawn(Address::Can(before)), switch: device.switch, is_tcp: false };
    rig.link(Link::Connected, SOON).await;

    let marked = || Command::Loop(LoopData::new(vec![7; 40]).unwrap());
    let echo = Ok(Data::Loop(vec![7; 40]));
    for loses in [&loses_request, &loses_reply, &loses_request, &loses_reply] {
        assert_eq!(rig.exchange(marked()).await, echo);
        loses.store(true, Ordering::Relaxed);
        assert!(rig.exchange(marked()).await.is_err(), "the command with the lost slice fails");
        assert!(!loses.load(Ordering::Relaxed), "a slice was lost");
        rig.exchange(Command::GetAcceleration).await.unwrap();
        assert_eq!(rig.exchange(marked()).await, echo, "the next command with the same id");
    }
    let received = rig.received().await;
    let connects: Vec<_> = received.iter().filter(|&&id| id == id::GET_SYSTEM_INFO).collect();
    assert_eq!(connects, [&id::GET_SYSTEM_INFO], "the link was set up only once");
    assert_eq!(rig.handle.state().link, Link::Connected);
    rig.drain().await;
}
