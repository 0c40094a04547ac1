//! Stand-ins for real drivers, each with its habits.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::time::interval;

use super::{CMD_FAILED, Cell, GRIP, MOVE, SUCCESS};
use crate::harness::wsg::{PENDING, floats, move_to, request};

/// A simple blocking driver: a blind acknowledge, then one request at a time; a motion ends with a status other than
/// pending. It never announces its disconnect.
#[tokio::test]
async fn blocking_driver_works() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.status(0x24, b"ack").await, SUCCESS);
    for (id, parameters) in [
        (0x20, vec![1]),
        (0x32, floats(&[40.0])),
        (0x30, floats(&[2000.0])),
        (GRIP, floats(&[20.0, 100.0])),
        (0x26, floats(&[80.0, 200.0])),
        (MOVE, move_to(40.0, 200.0)),
    ] {
        let mut status = driver.status(id, &parameters).await;
        while status == PENDING {
            status = driver.next().await.status;
        }
        assert_eq!(status, SUCCESS, "{id:02X}h");
    }
    assert_eq!(driver.status(GRIP, &floats(&[90.0, 200.0])).await, PENDING);
    assert_eq!(driver.end_of(GRIP).await, CMD_FAILED, "opening finds no part");
    drop(driver);
    let state = cell.gateway.until("the lease is free", |state| state["lease_holder"].is_null()).await;
    assert_eq!(state["fast_stop"], false, "the driver left while the gripper stood");
}

/// A driver that takes only the first frame of each read, and reads less often than frames come. It sees every value,
/// because those of equal periods do not arrive together.
#[tokio::test]
async fn driver_that_takes_one_frame_a_read_sees_every_value() {
    const READS: usize = 60;
    let cell = Cell::homed().await;
    let mut stream = TcpStream::connect(cell.port).await.unwrap();
    for id in [0x40, 0x41, 0x43, 0x44, 0x45] {
        stream.write_all(&request(id, &[1, 20, 0])).await.unwrap();
    }
    // No multiple of the period, so that the reads come at all times of it.
    let mut due = interval(Duration::from_millis(27));
    let mut first = BTreeMap::<u8, usize>::new();
    for _ in 0..READS {
        due.tick().await;
        let mut bytes = [0; 4096];
        let read = stream.read(&mut bytes).await.unwrap();
        assert!(read > 6, "{read} bytes");
        *first.entry(bytes[3]).or_default() += 1;
    }
    for id in [0x40, 0x41, 0x43, 0x44, 0x45] {
        assert!(first.get(&id).is_some_and(|count| *count >= READS / 20), "{id:02X}h: {first:?}");
    }
}

/// A driver that enables all updates, and finds its replies among them by id.
#[tokio::test]
async fn driver_with_updates_works() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    for id in [0x40, 0x41, 0x43, 0x44, 0x45] {
        driver.send(id, &[1, 10, 0]).await;
    }
    driver.send(0x26, &floats(&[80.0, 100.0])).await;
    let (mut updates, mut steps) = (BTreeMap::<u8, usize>::new(), Vec::new());
    while steps.len() < 2 {
        let reply = driver.next().await;
        match reply.id {
            0x26 => steps.push(reply.status),
            id => *updates.entry(id).or_default() += 1,
        }
    }
    assert_eq!(steps, [PENDING, SUCCESS]);
    assert_eq!(updates.keys().copied().collect::<Vec<_>>(), [0x40, 0x41, 0x43, 0x44, 0x45]);
    assert!(updates.values().all(|&count| count >= 5), "{updates:?}");
    // A single query switches the updates of an id off.
    for id in [0x40, 0x41, 0x44, 0x45] {
        driver.send(id, &[0; 3]).await;
    }
    driver.send(0x06, b"behind").await;
    while driver.next().await.id != 0x06 {}
    for _ in 0..10 {
        assert_eq!(driver.next().await.id, 0x43);
    }
    driver.send(0x43, &[0; 3]).await;
    while driver.next_within(Duration::from_millis(100)).await.is_some() {}
    driver.reset();
}

/// A driver that sends all its requests at once.
#[tokio::test]
async fn pipelined_requests_are_answered_in_order() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    let all = [
        request(0x32, &floats(&[30.0])),
        request(0x33, &[]),
        request(0x50, &[]),
        request(0x40, &[0; 3]),
        request(0x06, b"one"),
        request(0x06, b"two"),
        request(0x25, &floats(&[20.0, 200.0])),
        request(0x41, &[0; 3]),
        request(0x26, &floats(&[60.0, 200.0])),
        request(0x43, &[0; 3]),
    ];
    driver.send_raw(&all.concat()).await;
    let mut answers = Vec::new();
    while answers.len() < 11 {
        let reply = driver.next().await;
        answers.push((reply.id, reply.status));
    }
    let end = answers.iter().position(|answer| *answer == (GRIP, SUCCESS)).expect("the grip's end");
    answers.remove(end);
    let expected = [
        (0x32, SUCCESS),
        (0x33, SUCCESS),
        (0x50, SUCCESS),
        (0x40, SUCCESS),
        (0x06, SUCCESS),
        (0x06, SUCCESS),
        (GRIP, PENDING),
        (0x41, SUCCESS),
        (0x26, super::ALREADY_RUNNING),
        (0x43, SUCCESS),
    ];
    assert_eq!(answers, expected);
    let ids: Vec<_> =
        cell.proxy.frames.all().iter().map(|frame| frame.id).filter(|id| [0x25, 0x32].contains(id)).collect();
    assert_eq!(ids, [0x32, 0x25], "the device gets them in the same order");
}

/// A driver with updates and a thread that writes without waiting. For each new target it sends a Stop and the next
/// motion in two consecutive writes.
#[tokio::test]
async fn stop_directly_followed_by_a_motion_works() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    for id in [0x43, 0x44, 0x45] {
        assert_eq!(driver.status_among_updates(id, &[1, 20, 0]).await, SUCCESS);
    }
    let (mut moved, mut widths) = (Vec::new(), 0);
    for target in [10.0, 90.0, 60.0] {
        driver.send(0x22, &[]).await;
        driver.send(MOVE, &move_to(target, 50.0)).await;
        loop {
            let reply = driver.next().await;
            match reply.id {
                MOVE if reply.status == PENDING => break,
                MOVE => moved.push(reply.status),
                0x22 => assert_eq!(reply.status, SUCCESS),
                id => assert!([0x43, 0x44, 0x45].contains(&id), "{reply:?}"),
            }
        }
        cell.gateway.until_moving().await;
    }
    while moved.len() < 3 {
        let reply = driver.next().await;
        match reply.id {
            MOVE => moved.push(reply.status),
            0x43 => widths += 1,
            _ => {}
        }
    }
    assert_eq!(moved, [super::ABORTED, super::ABORTED, SUCCESS], "each motion is reported, and none is refused");
    assert!(widths > 0);
    driver.reset();
}

/// A driver that repeats its target and force limit 50 times a second, without waiting for replies.
#[tokio::test]
async fn repeated_commands_are_each_answered() {
    const ROUNDS: usize = 60;
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    let mut due = tokio::time::interval(Duration::from_millis(20));
    for _ in 0..ROUNDS {
        due.tick().await;
        driver.send(0x32, &floats(&[40.0])).await;
        driver.send(MOVE, &move_to(60.0, 100.0)).await;
    }
    let (mut set, mut moved) = (0, BTreeMap::<u16, usize>::new());
    let of = |moved: &BTreeMap<u16, usize>, status| moved.get(&status).copied().unwrap_or_default();
    while set < ROUNDS || moved.values().sum::<usize>() < ROUNDS + of(&moved, PENDING) {
        let reply = driver.next().await;
        match reply.id {
            0x32 => set += 1,
            MOVE => *moved.entry(reply.status).or_default() += 1,
            other => panic!("{other:02X}h"),
        }
    }
    let (begun, ended) = (of(&moved, PENDING), of(&moved, SUCCESS));
    assert!(begun > 0 && begun == ended, "each started motion ends: {moved:?}");
    let width = driver.ask(0x43, &[0; 3]).await.data;
    assert_eq!(width, floats(&[60.0]));
    driver.leave().await;
    assert_eq!(cell.gateway.state().await["fast_stop"], false);
}

/// A Stop directly after a motion stops that motion, even before the fingers move.
#[tokio::test]
async fn stop_in_the_same_write_stops_the_motion() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    driver.send_raw(&[request(MOVE, &move_to(5.0, 5.0)), request(0x22, &[])].concat()).await;
    let mut replies: Vec<(u8, u16)> = Vec::new();
    while replies.len() < 3 {
        let reply = driver.next().await;
        replies.push((reply.id, reply.status));
    }
    let of_motion: Vec<_> = replies.iter().filter(|(id, _)| *id == MOVE).map(|(_, status)| *status).collect();
    assert_eq!(of_motion, [PENDING, super::ABORTED], "{replies:?}");
    assert!(replies.contains(&(0x22, SUCCESS)), "{replies:?}");
    cell.gateway.until_standing().await;
}
