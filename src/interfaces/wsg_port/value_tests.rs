//! Values that a client reads, and their automatic updates.

use super::*;

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
    let value = value(id::GET_WIDTH, &bench.state, bench.now);
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
