//! Malformed requests: the port answers like the device.

use std::time::Duration;

use super::{
    ACCESS_DENIED, ALREADY_RUNNING, CHECKSUM_ERROR, Cell, FORMAT_ERROR, MOVE, NOT_INITIALIZED, OVERRUN, RANGE_ERROR,
    SUCCESS,
};
use crate::harness::Simulator;
use crate::harness::wsg::{Driver, PENDING, floats, move_to, request};

/// Flags of 40h.
const MOVING: u32 = 1 << 1;
const FAST_STOP: u32 = 1 << 12;

#[tokio::test]
async fn malformed_requests_get_the_devices_replies() {
    let cell = Cell::new().await;
    let device = Simulator::start(&[]).await;
    let (mut port, mut device) = (cell.driver().await, Driver::connect(device.address).await);
    let long = vec![0; 257];
    let wrong: [(u8, &[u8]); 26] = [
        (0x06, &long),
        (0x07, &[1]),
        (0x20, &[]),
        (0x20, &[3]),
        (0x21, &[1, 2, 3]),
        (0x22, &[1]),
        (0x24, b"nak"),
        (0x24, &[]),
        (0x25, &[0; 9]),
        (0x26, &[]),
        (0x30, &[0; 3]),
        (0x31, &[0]),
        (0x32, &[]),
        (0x33, &[0]),
        (0x34, &[0; 7]),
        (0x35, &[0]),
        (0x36, &[0]),
        (0x37, &[]),
        (0x38, &[0]),
        (0x40, &[0; 2]),
        (0x42, &[0; 2]),
        (0x46, &[0]),
        (0x50, &[0]),
        (0x51, &[7]),
        (0x51, &[b'x'; 65]),
        (0x62, &[2]),
    ];
    for (id, parameters) in wrong {
        let (answered, expected) = (port.ask(id, parameters).await, device.ask(id, parameters).await);
        assert_eq!(answered, expected, "{id:02X}h with {} bytes", parameters.len());
    }
    for number in [f32::NAN, f32::INFINITY] {
        let parameters = floats(&[number]);
        assert_eq!(port.ask(0x30, &parameters).await, device.ask(0x30, &parameters).await);
    }
    assert_eq!(port.ask(0xB0, &[1]).await, device.ask(0xB0, &[1]).await, "an unknown id");
}

/// A damaged frame gets a status; other garbage is ignored.
#[tokio::test]
async fn damaged_frames_do_not_affect_the_next_request() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    let mut damaged = request(0x50, &[]);
    damaged[6] ^= 0xFF;
    driver.send_raw(&damaged).await;
    let reply = driver.next().await;
    assert_eq!((reply.id, reply.status), (0x50, CHECKSUM_ERROR));
    assert_eq!(driver.status(0x50, &[]).await, SUCCESS);
    // The connection has begun with a frame: see `foreign_protocols` for others.
    for garbage in [&b"GET / HTTP/1.1\r\n\r\n"[..], &[0xAA; 7], &[0x00, 0xAA, 0xAA, 0x20]] {
        driver.send_raw(&[garbage, &request(0x50, &[])].concat()).await;
        let reply = driver.next().await;
        assert_eq!((reply.id, reply.status), (0x50, SUCCESS), "{garbage:x?}");
    }
    // Half a frame followed by silence is dropped, and so is an impossible size.
    for half in [&request(MOVE, &move_to(10.0, 10.0))[..9], &[0xAA, 0xAA, 0xAA, 0x40, 0xFF, 0xFF]] {
        driver.send_raw(half).await;
        assert_eq!(driver.next_within(Duration::from_millis(700)).await, None);
        assert_eq!(driver.status(0x50, &[]).await, SUCCESS);
    }
    assert_eq!(cell.proxy.frames.motions(), 0);
}

/// The port and the device consume a frame of any size whole. Nothing in its payload is executed.
#[tokio::test]
async fn payload_is_not_executed_whatever_its_size() {
    let cell = Cell::homed().await;
    let device = Simulator::start(&[]).await;
    let (mut port, mut device) = (cell.driver().await, Driver::connect(device.address).await);
    assert_eq!(device.run(0x20, &[0]).await, SUCCESS);
    let motions = cell.proxy.frames.motions();
    for inside in [request(MOVE, &move_to(50.0, 50.0)), request(0x23, &[])] {
        let payload = [vec![0; 10], inside, vec![0; 5000]].concat();
        for (id, status) in [(0x06, FORMAT_ERROR), (0x51, OVERRUN)] {
            assert_eq!(port.status(id, &payload).await, status);
            assert_eq!(device.status(id, &payload).await, status);
        }
    }
    // With a wrong checksum, too.
    let mut damaged = request(0x06, &[vec![0; 10], request(MOVE, &move_to(50.0, 50.0)), vec![0; 99]].concat());
    *damaged.last_mut().unwrap() ^= 1;
    for driver in [&mut port, &mut device] {
        driver.send_raw(&damaged).await;
    }
    assert_eq!(port.next().await.status, CHECKSUM_ERROR);
    for driver in [&mut port, &mut device] {
        let flags = driver.flags().await;
        assert_eq!(flags & (MOVING | FAST_STOP), 0, "{flags:x}");
    }
    assert_eq!((cell.proxy.frames.motions(), cell.proxy.frames.count(0x23)), (motions, 0));
}

#[tokio::test]
async fn request_split_at_every_byte_is_one_request() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    for byte in request(0x06, b"hello") {
        driver.send_raw(&[byte]).await;
    }
    assert_eq!(driver.next().await.data, b"hello");
}

#[tokio::test]
async fn state_errors_come_before_format_errors() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.status(MOVE, &move_to(10.0, 10.0)).await, NOT_INITIALIZED);
    assert_eq!(driver.run(0x20, &[0]).await, SUCCESS);
    assert_eq!(driver.status(MOVE, &[]).await, FORMAT_ERROR);
    assert_eq!(driver.status(MOVE, &move_to(5.0, 5.0)).await, PENDING);
    for parameters in [vec![], move_to(50.0, 50.0)] {
        assert_eq!(driver.status(MOVE, &parameters).await, ALREADY_RUNNING);
    }
    driver.send(0x23, &[]).await;
    let mut ids = [driver.next().await.id, driver.next().await.id];
    ids.sort_unstable();
    assert_eq!(ids, [MOVE, 0x23]);
    for parameters in [vec![], move_to(50.0, 50.0)] {
        assert_eq!(driver.status(MOVE, &parameters).await, ACCESS_DENIED);
    }
}

#[tokio::test]
async fn values_are_clamped_and_soft_limits_refuse() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.run(MOVE, &move_to(5000.0, 100_000.0)).await, SUCCESS);
    let sent = cell.proxy.frames.all().into_iter().rfind(|frame| frame.id == MOVE).unwrap();
    assert_eq!(sent.payload, move_to(110.0, 420.0), "the stroke and the maximum speed");
    for (set, get, given, taken) in [(0x30, 0x31, 1e9, 5000.0), (0x32, 0x33, 0.0, 5.0), (0x32, 0x33, 1e9, 80.0)] {
        assert_eq!(driver.status(set, &floats(&[given])).await, SUCCESS);
        assert_eq!(driver.ask(get, &[]).await.data, floats(&[taken]));
    }
    assert_eq!(driver.status(0x34, &floats(&[10.0, 60.0])).await, SUCCESS);
    assert_eq!(driver.status(MOVE, &move_to(5.0, 100.0)).await, RANGE_ERROR);
    assert_eq!(driver.run(MOVE, &move_to(50.0, 100.0)).await, SUCCESS);
    assert_eq!(driver.status(0x36, &[]).await, SUCCESS);
    assert_eq!(driver.status(0x35, &[]).await, 1, "E_NOT_AVAILABLE");
}

#[tokio::test]
async fn too_many_requests_are_an_overrun() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    let many = request(0x06, b"x").repeat(100);
    driver.send_raw(&many).await;
    let mut statuses = [0; 2];
    for _ in 0..100 {
        match driver.next().await.status {
            SUCCESS => statuses[0] += 1,
            OVERRUN => statuses[1] += 1,
            other => panic!("{other}"),
        }
    }
    assert!(statuses[0] >= 64 && statuses[0] + statuses[1] == 100, "{statuses:?}");
}

#[tokio::test]
async fn refusals_are_in_journal_metrics_and_log() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    let mut damaged = request(0x50, &[]);
    *damaged.last_mut().unwrap() ^= 1;
    for _ in 0..3 {
        driver.send_raw(&damaged).await;
        assert_eq!(driver.next().await.status, CHECKSUM_ERROR);
    }
    assert_eq!(driver.status(0x24, &[]).await, FORMAT_ERROR);
    let refused = cell.gateway.events("kind=refused&order=oldest", 2).await;
    let fields = |index: usize| ["command", "code", "cause"].map(|field| refused[index][field].as_str().unwrap());
    assert_eq!(fields(0), ["GetSystemInfo", "E_CHECKSUM_ERROR", "frame damaged: its checksum is wrong"]);
    assert_eq!(fields(1)[..2], ["AcknowledgeFastStop", "E_CMD_FORMAT_ERROR"]);
    assert!(fields(1)[2].contains("0 bytes were given"), "{refused:?}");
    let figures = cell.gateway.figures().await;
    let damaged = "wsg_port_refused_total{gripper=\"g\",status=\"E_CHECKSUM_ERROR\"}";
    assert_eq!(figures.get(damaged), Some(&3.0));
    for remedy in ["wsg_port_checksum_evaluation = false", "61 63 6B"] {
        cell.gateway.until_logged(remedy).await;
    }
}
