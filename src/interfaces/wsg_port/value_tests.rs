//! Values that a client reads, and their automatic updates.

use super::super::super::status::RefusedStatus;
use super::super::super::values::value;
use super::queries::MAX_FRAMES_BEFORE_UPDATES;
use super::*;

/// Data of the only frame that was sent.
fn shown(bench: &mut Bench) -> Data {
    let frame = bench.device.poll_frame().expect("a frame");
    assert_eq!(bench.device.poll_frame(), None, "one frame");
    let payload = frame.get(6..frame.len() - 2).unwrap();
    let Ok(Reply::Success(data)) = Reply::parse(frame[3], payload) else { panic!("no value: {frame:02x?}") };
    data
}

/// Whether 40h shows that the client's last request failed.
fn shows_failure(bench: &mut Bench) -> bool {
    bench.send(id::GET_SYSTEM_STATE, &[0; 3]);
    let Data::SystemState(flags) = shown(bench) else { panic!("no flags") };
    flags.contains(SystemState::CMD_FAILURE)
}

fn refused(status: Status) -> PortReply {
    PortReply::Refused(RefusedStatus { status, fast_stop: None })
}

#[test]
fn updates_keep_their_period_but_not_below_the_minimum() {
    let mut bench = Bench {
        device: VirtualDevice::new("wsg:10.0.0.1".into(), &rules(), Arc::new(custom_ids()), 50),
        ..Bench::new()
    };
    bench.send(id::GET_WIDTH, &[1, 10, 0]);
    bench.send(id::GET_FORCE, &[1, 100, 0]);
    assert_eq!(bench.sent().len(), 2, "switching on is answered");
    bench.pass(Duration::from_millis(500));
    let sent = bench.sent();
    let counts = [id::GET_WIDTH, id::GET_FORCE].map(|id| sent.iter().filter(|(sent, _)| *sent == id).count());
    assert_eq!(counts, [10, 5]);
    bench.send(id::GET_WIDTH, &[0; 3]);
    bench.pass(Duration::from_millis(100));
    assert_eq!(bench.sent().iter().filter(|(sent, _)| *sent == id::GET_WIDTH).count(), 1, "updates are off, one reply");
}

#[test]
fn updates_on_change_follow_a_change() {
    let mut bench = Bench::new();
    bench.send(id::GET_GRIPPER_STATE, &[3, 10, 0]);
    assert!(bench.device.watches());
    bench.pass(Duration::from_secs(1));
    assert_eq!(bench.sent().len(), 1);
    bench.take_state(GripperState::Idle);
    bench.pass(Duration::from_millis(1));
    assert_eq!(bench.sent(), [(id::GET_GRIPPER_STATE, Status::E_SUCCESS)]);
    // A change without a link is sent once the link is back.
    bench.state.link = Link::Reconnecting;
    bench.state.values.forget();
    bench.pass(Duration::from_secs(1));
    assert_eq!(bench.sent(), []);
    bench.state.link = Link::Connected;
    bench.take_state(GripperState::Holding);
    bench.pass(Duration::from_millis(1));
    assert_eq!(bench.sent(), [(id::GET_GRIPPER_STATE, Status::E_SUCCESS)]);
}

#[test]
fn unknown_values_are_not_available_and_send_no_updates() {
    let mut bench = Bench::new();
    bench.send(id::GET_WIDTH, &[1, 10, 0]);
    bench.send(id::GET_FORCE, &[1, 10, 0]);
    assert_eq!(bench.sent(), [(id::GET_WIDTH, Status::E_SUCCESS), (id::GET_FORCE, Status::E_SUCCESS)]);
    bench.state.values.width.lose(Missing::Silent);
    bench.pass(Duration::from_millis(100));
    let sent = bench.sent();
    assert_eq!(sent.len(), 10);
    assert!(sent.iter().all(|(id, _)| *id == id::GET_FORCE), "{sent:?}");
    bench.send(id::GET_WIDTH, &[0; 3]);
    bench.state.values.flags.lose(Missing::Silent);
    bench.send(id::GET_SYSTEM_STATE, &[0; 3]);
    let sent = bench.sent();
    assert_eq!(sent[0], (id::GET_WIDTH, Status::E_NOT_AVAILABLE));
    assert!(sent.contains(&(id::GET_SYSTEM_STATE, Status::E_NOT_AVAILABLE)));
    bench.state = State { link: Link::Connected, ..State::unknown("g".parse().unwrap()) };
    bench.send(id::GET_FORCE, &[0; 3]);
    assert_eq!(bench.sent().pop(), Some((id::GET_FORCE, Status::E_NOT_AVAILABLE)), "never known");
}

#[test]
fn width_is_zero_before_homing() {
    let mut bench = Bench::new();
    bench.state.values = Values::fixed(SystemState::empty(), GripperState::Idle, [20.0, 0.0, 0.0]);
    let value = value(id::GET_WIDTH, &bench.state, bench.now, false);
    assert_eq!(value, Some(Data::Width(crate::wsg::Width::ZERO)));
}

#[test]
fn unread_updates_are_skipped_but_replies_are_not() {
    let mut bench = Bench::new();
    bench.send(id::GET_FORCE, &[1, 10, 0]);
    bench.pass(Duration::from_secs(10));
    bench.send(id::GET_SPEED, &[0; 3]);
    let sent = bench.sent();
    assert_eq!((sent.len(), sent.last().unwrap().0), (MAX_FRAMES_BEFORE_UPDATES + 1, id::GET_SPEED));
    assert!(!bench.device.has_overflown());
}

#[test]
fn no_stale_values_without_a_link() {
    let mut bench = Bench::new();
    bench.send(id::GET_WIDTH, &[1, 10, 0]);
    let known = bench.state.values;
    bench.state.link = Link::Reconnecting;
    bench.state.values.forget();
    bench.sent();
    bench.pass(Duration::from_secs(1));
    bench.send(id::GET_SPEED, &[0; 3]);
    bench.send(id::ACKNOWLEDGE_FAST_STOP, b"ack");
    let io = Status::E_IO_ERROR;
    assert_eq!(bench.sent(), [(id::GET_SPEED, io), (id::ACKNOWLEDGE_FAST_STOP, io)]);
    (bench.state.link, bench.state.values) = (Link::Connected, known);
    bench.pass(Duration::from_millis(100));
    assert!((9..=11).contains(&bench.sent().len()), "missed updates are not sent later");
}

#[test]
fn failure_flag_belongs_to_the_clients_own_last_request() {
    let mut bench = Bench::new();
    // The device's flag is about a request of the gateway or another client.
    let flags = SystemState::REFERENCED | SystemState::CMD_FAILURE;
    bench.state.values.flags.take(bench.now, flags, Duration::from_hours(1));
    assert!(!shows_failure(&mut bench));
    // Requests that the device, the gateway and the port itself refuse.
    bench.send(id::GET_SOFT_LIMITS, &[]);
    let ask = bench.order().ask;
    bench.answer(ask, PortReply::Reply(Reply::Status(Status::E_NOT_AVAILABLE)));
    bench.sent();
    assert!(shows_failure(&mut bench));
    assert!(!shows_failure(&mut bench), "the query itself succeeded");
    bench.send(id::HOMING, &[0]);
    let ask = bench.order().ask;
    bench.answer(ask, refused(Status::E_ACCESS_DENIED));
    bench.sent();
    assert!(shows_failure(&mut bench));
    bench.send(id::SET_FORCE_LIMIT, &[1]);
    assert_eq!(bench.sent(), [(id::SET_FORCE_LIMIT, Status::E_CMD_FORMAT_ERROR)]);
    assert!(shows_failure(&mut bench));
    // A motion fails with its result.
    bench.send(id::HOMING, &[0]);
    let ask = bench.order().ask;
    bench.answer(ask, PortReply::Accepted);
    bench.sent();
    assert!(!shows_failure(&mut bench));
    bench.answer(PortRequest { is_awaited: false, ..ask }, PortReply::Reply(Reply::Status(Status::E_AXIS_BLOCKED)));
    bench.sent();
    assert!(shows_failure(&mut bench));
}

#[test]
fn failure_of_another_client_sends_no_update() {
    let mut bench = Bench::new();
    bench.send(id::GET_SYSTEM_STATE, &[3, 10, 0]);
    assert_eq!(bench.sent().len(), 1);
    let failed = SystemState::REFERENCED | SystemState::CMD_FAILURE;
    bench.state.values.flags.take(bench.now, failed, Duration::from_hours(1));
    bench.pass(Duration::from_secs(1));
    assert_eq!(bench.sent(), []);
    bench.send(id::SET_FORCE_LIMIT, &[1]);
    bench.pass(Duration::from_secs(1));
    let sent = bench.sent();
    assert_eq!(sent, [(id::SET_FORCE_LIMIT, Status::E_CMD_FORMAT_ERROR), (id::GET_SYSTEM_STATE, Status::E_SUCCESS)]);
}

/// Orders a change, and answers it with success.
fn change(bench: &mut Bench) {
    bench.send(id::CLEAR_SOFT_LIMITS, &[]);
    let ask = bench.order().ask;
    bench.state.values.changed_at = Some(bench.now);
    bench.answer(ask, NOTHING);
    assert_eq!(bench.sent(), [(id::CLEAR_SOFT_LIMITS, Status::E_SUCCESS)]);
}

#[test]
fn query_after_a_change_has_a_newer_value() {
    let mut bench = Bench::new();
    bench.pass(Duration::from_millis(100));
    change(&mut bench);
    bench.send(id::GET_FORCE, &[1, 50, 0]);
    bench.send(id::GET_GRIPPER_STATE, &[0; 3]);
    assert_eq!(bench.sent(), [], "known values are from before the change");
    let PortOrdered { ask, order } = bench.order();
    assert_eq!(order, PortOrder::Exchange(Command::GetForce(Updates::Off)));
    bench.pass(Duration::from_millis(1));
    let force = crate::wsg::Force::new(1.0).unwrap();
    bench.state.values.force.take(bench.now, force, Duration::from_hours(1));
    bench.take_state(GripperState::Idle);
    bench.answer(ask, PortReply::Reply(Reply::Success(Data::Force(force))));
    assert_eq!(bench.device.poll_order(), None, "the state is newer, too");
    assert_eq!(bench.sent(), [(id::GET_FORCE, Status::E_SUCCESS), (id::GET_GRIPPER_STATE, Status::E_SUCCESS)]);
    bench.pass(Duration::from_millis(50));
    assert_eq!(bench.sent(), [(id::GET_FORCE, Status::E_SUCCESS)], "the updates are on");
}

#[test]
fn change_of_another_client_delays_no_query() {
    let mut bench = Bench::new();
    bench.pass(Duration::from_millis(100));
    bench.state.values.changed_at = Some(bench.now);
    bench.send(id::LOOP, &[]);
    let ask = bench.order().ask;
    bench.answer(ask, PortReply::Reply(Reply::Success(Data::Loop(Vec::new()))));
    bench.sent();
    bench.send(id::GET_FORCE, &[0; 3]);
    assert_eq!((bench.sent(), bench.device.poll_order()), (vec![(id::GET_FORCE, Status::E_SUCCESS)], None));
}

#[test]
fn failed_measurement_is_told() {
    let mut bench = Bench::new();
    bench.pass(Duration::from_millis(100));
    change(&mut bench);
    bench.send(id::GET_SPEED, &[0; 3]);
    let ask = bench.order().ask;
    bench.answer(ask, refused(Status::E_TIMEOUT));
    assert_eq!(bench.sent(), [(id::GET_SPEED, Status::E_TIMEOUT)]);
    bench.state.link = Link::Unresponsive;
    bench.send(id::GET_SPEED, &[0; 3]);
    assert_eq!(bench.device.poll_order(), None, "nothing can be asked");
}

#[test]
fn flags_say_after_a_change_that_there_is_no_width() {
    let mut bench = Bench::new();
    bench.state.values = Values::fixed(SystemState::empty(), GripperState::Idle, [20.0, 0.0, 0.0]);
    bench.pass(Duration::from_millis(100));
    change(&mut bench);
    bench.send(id::GET_WIDTH, &[0; 3]);
    let PortOrdered { ask, order } = bench.order();
    assert_eq!(order, PortOrder::Exchange(Command::GetSystemState(Updates::Off)));
    bench.pass(Duration::from_millis(1));
    bench.state.values.flags.take(bench.now, SystemState::empty(), Duration::from_hours(1));
    bench.answer(ask, PortReply::Reply(Reply::Success(Data::SystemState(SystemState::empty()))));
    assert_eq!(shown(&mut bench), Data::Width(crate::wsg::Width::ZERO));
}
