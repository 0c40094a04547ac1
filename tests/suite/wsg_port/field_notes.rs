//! Habits of known clients. `src/rulings.md` has them with their sources.

use std::time::{Duration, Instant};

use super::{ACCESS_DENIED, Cell, FORMAT_ERROR, GRIP, MOVE, SUCCESS, configured, connect};
use crate::harness::wsg::{Driver, PENDING, floats, move_to, request};
use crate::harness::{Gateway, Scripted, Simulator, Table, shortest, success};

/// "Many acknowledge (24h) as their first act, whether or not anything is latched. … One sends 24h with no key."
#[tokio::test]
async fn acknowledge_as_the_first_request_is_harmless() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.status(0x24, b"ack").await, SUCCESS);
    assert_eq!(driver.status(0x24, &[]).await, FORMAT_ERROR, "as in the manual");
    assert_eq!(cell.proxy.frames.count(0x24), 0, "there is nothing to acknowledge");
}

/// "Many read one frame a recv, and break when a frame arrives in two pieces": [`Driver`] checks for whole frames.
#[tokio::test]
async fn frames_are_never_split() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    for id in [0x40, 0x41, 0x43, 0x44, 0x45] {
        assert_eq!(driver.status_among_updates(id, &[1, 10, 0]).await, SUCCESS);
    }
    driver.send(0x06, &[0xAA; 256]).await;
    let mut echo = driver.next().await;
    for _ in 0..500 {
        if echo.id == 0x06 {
            break;
        }
        echo = driver.next().await;
    }
    assert_eq!((echo.id, echo.data), (0x06, vec![0xAA; 256]));
}

/// "Many spin for ever when the server closes": a lost device closes no client connection, see `link`.
///
/// "Many send 07h and close without reading the answer", also with unread updates.
#[tokio::test]
async fn announcement_counts_without_reading_the_reply() {
    let cell = Cell::homed().await;
    for reads_updates in [false, true] {
        let mut driver = cell.driver().await;
        if reads_updates {
            driver.send(0x43, &[1, 10, 0]).await;
        }
        assert_eq!(driver.status_among_updates(MOVE, &move_to(5.0, 5.0)).await, PENDING);
        cell.gateway.until_moving().await;
        driver.send(0x07, &[]).await;
        driver.reset();
        let state = cell.gateway.until_standing().await;
        assert!(state["fast_stop"] == false && state["lease_holder"].is_null(), "{state}");
        let mut back = cell.driver().await;
        assert_eq!(back.run(MOVE, &move_to(90.0, 400.0)).await, SUCCESS);
        back.leave().await;
    }
    assert_eq!(cell.proxy.frames.count(0x23), 0);
}

/// "one sends it with a one-byte size field"
#[tokio::test]
async fn announcement_with_a_one_byte_size_field_counts() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.status(MOVE, &move_to(5.0, 5.0)).await, PENDING);
    cell.gateway.until_moving().await;
    driver.send_raw(&[0xAA, 0xAA, 0xAA, 0x07, 0x00, 0x62, 0xD1]).await;
    driver.reset();
    let state = cell.gateway.until_standing().await;
    assert!(state["fast_stop"] == false && state["lease_holder"].is_null(), "{state}");
    assert_eq!((cell.proxy.frames.count(0x22), cell.proxy.frames.count(0x23)), (1, 0));
}

/// "Getters 40h to 45h come with three parameter bytes, and from some with none; 31h and 33h with none."
#[tokio::test]
async fn getters_accept_three_parameter_bytes_or_none() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    for (id, bytes) in [(0x40, 4), (0x41, 1), (0x43, 4), (0x44, 4), (0x45, 4)] {
        for parameters in [&[0, 0, 0][..], &[]] {
            let reply = driver.ask(id, parameters).await;
            assert_eq!((reply.status, reply.data.len()), (SUCCESS, bytes), "{id:02X}h with {parameters:?}");
        }
    }
    assert_eq!(driver.ask(0x42, &[]).await.data.len(), 8);
    for id in [0x31, 0x33] {
        assert_eq!(driver.ask(id, &[]).await.data.len(), 4);
    }
}

/// "21h's flags are sent wrong by several (D0 and D1 swapped; 04h): pass what is valid through unchanged."
#[tokio::test]
async fn valid_move_flags_pass_unchanged() {
    let cell = Cell::homed().await;
    let mut driver = cell.driver().await;
    for (given, passed) in [(0x00, 0x00), (0x02, 0x02), (0x04, 0x00), (0x06, 0x02)] {
        let parameters = [&[given], floats(&[50.0 + f32::from(given), 200.0]).as_slice()].concat();
        assert_eq!(driver.run(MOVE, &parameters).await, SUCCESS);
        let sent = cell.proxy.frames.all().into_iter().rfind(|frame| frame.id == MOVE).unwrap();
        assert_eq!(sent.payload, [&[passed], &parameters[1..]].concat());
    }
    let by = [&[0x01], floats(&[-5.0, 200.0]).as_slice()].concat();
    assert_eq!(driver.run(MOVE, &by).await, SUCCESS);
    let width = driver.ask(0x43, &[0; 3]).await.data;
    let width = f32::from_le_bytes(width.try_into().unwrap());
    assert!((width - 51.0).abs() < 0.5, "{width}");
}

/// "Time-outs are short: 100 ms for 30h, 32h, 50h and 53h; 250 ms for switching updates on … also while another
/// client's motion runs."
#[tokio::test]
async fn replies_are_fast_during_another_clients_motion() {
    let cell = Cell::homed().await;
    let (mut holder, mut other) = (cell.driver().await, cell.driver().await);
    assert_eq!(holder.status(MOVE, &move_to(5.0, 5.0)).await, PENDING);
    cell.gateway.until_moving().await;
    let denied = [(0x30, floats(&[500.0])), (0x32, floats(&[20.0])), (MOVE, move_to(50.0, 50.0))];
    for (id, parameters) in denied {
        assert_eq!(quickest(&mut other, id, &parameters, 100).await, ACCESS_DENIED, "{id:02X}h");
        assert_eq!(quickest(&mut holder, 0x30, &floats(&[500.0]), 100).await, SUCCESS);
    }
    for id in [0x50, 0x53] {
        assert_eq!(quickest(&mut other, id, &[], 100).await, SUCCESS, "{id:02X}h");
    }
    assert_eq!(quickest(&mut other, 0x41, &[1, 0xE8, 3], 250).await, SUCCESS);
}

/// Returns the status of a request, and asserts that it arrives within the limit.
async fn quickest(driver: &mut Driver, id: u8, parameters: &[u8], limit_ms: u64) -> u16 {
    let (limit, mut status) = (Duration::from_millis(limit_ms), 0);
    let fastest = shortest(limit, async || {
        let asked = Instant::now();
        status = driver.status(id, parameters).await;
        asked.elapsed()
    })
    .await;
    assert!(fastest <= limit, "{id:02X}h took {fastest:?}");
    status
}

/// "A motion's client loops until the status is not E_CMD_PENDING; some wait for exactly two frames; some read the first
/// only, and find the second in front of a later answer."
#[tokio::test]
async fn motion_has_exactly_two_frames() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    // Two frames, and no third.
    for (id, parameters) in [(0x20, vec![0]), (MOVE, move_to(60.0, 200.0)), (GRIP, floats(&[20.0, 100.0]))] {
        assert_eq!(driver.run(id, &parameters).await, SUCCESS);
        assert_eq!(driver.next_within(Duration::from_millis(100)).await, None);
    }
    // The second frame of a Release arrives before the width.
    assert_eq!(driver.status(0x26, &floats(&[60.0, 200.0])).await, PENDING);
    cell.gateway.until("the motion is done", |state| state["command"].is_null()).await;
    driver.send(0x43, &[0; 3]).await;
    let ids = [driver.next().await.id, driver.next().await.id];
    assert_eq!(ids, [0x26, 0x43]);
    // A refused motion has one frame.
    assert_eq!(driver.status(MOVE, &[1, 2, 3]).await, FORMAT_ERROR);
    assert_eq!(driver.next_within(Duration::from_millis(100)).await, None);
}

/// The manual has two frames for a finger that is switched on, and a script can take its time too.
#[tokio::test]
async fn slow_command_without_motion_has_two_frames() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    assert_eq!(driver.run(0x62, &[1]).await, SUCCESS);
    assert_eq!(driver.status(0x62, &[0]).await, SUCCESS, "off is one step");
    assert_eq!(driver.next_within(Duration::from_millis(100)).await, None);

    let device = Scripted::start(Table::from([(0xB0, vec![vec![0x1A, 0], success(&[7])])])).await;
    let text =
        format!("[grippers.g]\nurl = \"tcp://{}\"\nread_ids = [0xB0]\nwsg_port = \"127.0.0.1:0\"\n", device.address);
    let gateway = configured(&text).await;
    let mut driver = connect(&gateway).await;
    assert_eq!(driver.status(0xB0, &[]).await, PENDING);
    let reply = driver.next().await;
    assert_eq!((reply.id, reply.status, reply.data), (0xB0, SUCCESS, vec![7]));
}

/// "Checksum evaluation is switched off at some sites; such clients send any two bytes."
#[tokio::test]
async fn checksum_evaluation_can_be_off() {
    let device = Simulator::start(&[]).await;
    let text = format!(
        "[grippers.g]\nurl = \"tcp://{}\"\nwsg_port = \"127.0.0.1:0\"\nwsg_port_checksum_evaluation = false\n",
        device.address
    );
    let gateway = configured(&text).await;
    let mut driver = connect(&gateway).await;
    let mut frame = request(0x50, &[]);
    let checksum = frame.len() - 2;
    frame[checksum..].copy_from_slice(&[0, 0]);
    driver.send_raw(&frame).await;
    let reply = driver.next().await;
    assert_eq!((reply.id, reply.status), (0x50, SUCCESS));
}

/// "Custom scripts on the device add ids B0h..B2h, BBh and others. … carry them opaque, in both directions."
#[tokio::test]
async fn custom_ids_pass_unchanged_in_both_directions() {
    let device = Scripted::start(Table::new()).await;
    let answer: Vec<u8> = (0..=255).collect();
    device.answer(0xB0, vec![success(&answer)]);
    device.answer(0xBB, vec![vec![0x67, 0x12]]);
    let (gateway, port) = Gateway::with_port(device.address, &[]).await;
    let mut driver = Driver::connect(port).await;
    for round in 0..50 {
        let reply = driver.ask(0xB0, &[0xAA, 0xAA, 0xAA, round]).await;
        assert_eq!((reply.status, &reply.data), (SUCCESS, &answer));
    }
    let sent: Vec<_> = device.frames.all().into_iter().filter(|frame| frame.id == 0xB0).collect();
    assert_eq!((sent.len(), sent[7].payload.as_slice()), (50, &[0xAA, 0xAA, 0xAA, 7][..]));
    assert_eq!(driver.status(0xBB, &[]).await, 0x1267, "unknown statuses pass unchanged");
    assert_eq!(driver.status(0xB7, &[]).await, 14, "unknown to the device");
    // The fingers have not moved, so other clients can use the scripts too.
    let mut other = Driver::connect(port).await;
    assert_eq!(other.status(0xB0, &[]).await, SUCCESS);
    assert_eq!(gateway.state().await["lease_holder"], serde_json::Value::Null);
}

/// "Force carries no sign"; "Opening-width updates often don't come until the gripper is referenced": until then the
/// width is 0, and no update counts as a change.
#[tokio::test]
async fn width_is_zero_until_referenced() {
    let cell = Cell::new().await;
    let mut driver = cell.driver().await;
    let reply = driver.ask(0x43, &[3, 10, 0]).await;
    assert_eq!((reply.status, reply.data), (SUCCESS, vec![0; 4]));
    assert_eq!(driver.next_within(Duration::from_millis(200)).await, None);
    driver.send(0x20, &[0]).await;
    let mut updates = 0;
    loop {
        let reply = driver.next().await;
        match (reply.id, reply.status) {
            (0x43, _) => updates += 1,
            (0x20, PENDING) => {}
            (id, status) => break assert_eq!((id, status), (0x20, SUCCESS)),
        }
    }
    if updates == 0 {
        assert_eq!(driver.next().await.id, 0x43, "the width of the end stop");
    }
}
