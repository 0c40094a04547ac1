use crate::testing::*;
use crate::{Change, DeviceConfig, Interface};
use wsg::{Command, Data, GripperState, HomingDirection, Reply, Status, SystemState, id};

#[test]
fn stop_ends_motion_and_both_get_replies() {
    for stop_answers_first in [true, false] {
        let mut bench = Bench::homed(DeviceConfig { stop_answers_first, ..DeviceConfig::wsg50() });
        bench.ask(&move_to(10.0, 400.0));
        bench.pass(ms(200));
        assert_eq!(bench.ask(&Command::Stop), [], "not before the fingers are at rest");
        let stop = (id::STOP, DONE);
        let aborted = (id::PRE_POSITION, status(Status::E_CMD_ABORTED));
        let expected = if stop_answers_first { [stop, aborted] } else { [aborted, stop] };
        assert_eq!(bench.pass(ms(100)), expected);
        assert!(bench.has(SystemState::AXIS_STOPPED) && !bench.has(SystemState::MOVING));
        assert_eq!(bench.state(), GripperState::Idle);
        bench.ask(&move_to(50.0, 100.0));
        assert!(!bench.has(SystemState::AXIS_STOPPED), "until the next motion");
    }
}

#[test]
fn ruling_a_stop_while_idle_sets_axis_stopped_or_not() {
    for sets in [true, false] {
        let mut bench = Bench::new(DeviceConfig { stop_sets_flag_when_idle: sets, ..DeviceConfig::wsg50() });
        assert_eq!(bench.reply(&Command::Stop), DONE);
        assert_eq!(bench.has(SystemState::AXIS_STOPPED), sets);
    }
}

#[test]
fn fast_stop_replies_at_once_and_latches_until_acknowledged() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&move_to(10.0, 400.0));
    bench.pass(ms(150));
    let aborted = (id::PRE_POSITION, status(Status::E_CMD_ABORTED));
    assert_eq!(bench.ask(&Command::FastStop), [(id::FAST_STOP, DONE), aborted]);
    let before = bench.snapshot().width_mm;
    bench.pass(ms(30));
    assert!(!bench.snapshot().moving && before - bench.snapshot().width_mm < 5.0);
    assert_eq!(bench.state(), GripperState::Error);
    for command in [Command::Homing(HomingDirection::Inner), move_to(50.0, 50.0), grip(20.0, 50.0), release(90.0, 50.0)]
    {
        assert_eq!(bench.reply(&command), status(Status::E_ACCESS_DENIED));
    }
    assert_eq!(bench.status_of_raw(id::ACKNOWLEDGE_FAST_STOP, b"ACK"), Status::E_CMD_FORMAT_ERROR);
    assert!(bench.has(SystemState::FAST_STOP));
    assert_eq!(bench.reply(&Command::AcknowledgeFastStop), DONE);
    assert!(!bench.has(SystemState::FAST_STOP));
    assert_eq!(bench.state(), GripperState::Error, "until the next motion");
    bench.ask(&move_to(50.0, 50.0));
    assert_eq!(bench.state(), GripperState::Positioning);
}

#[test]
fn fast_stop_takes_any_payload() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    assert_eq!(bench.status_of_raw(id::FAST_STOP, &[1, 2, 3]), Status::E_SUCCESS);
    assert!(bench.has(SystemState::FAST_STOP));
}

#[test]
fn fast_stop_ends_pending_stop() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&move_to(10.0, 400.0));
    bench.pass(ms(150));
    bench.ask(&Command::Stop);
    let aborted = (id::PRE_POSITION, status(Status::E_CMD_ABORTED));
    assert_eq!(bench.ask(&Command::FastStop), [(id::STOP, DONE), (id::FAST_STOP, DONE), aborted]);
    assert_eq!(bench.pass(ms(200)), []);
}

#[test]
fn fw2_has_no_error_state() {
    let mut bench = Bench::homed(DeviceConfig::wsg50().fw2());
    bench.ask(&move_to(10.0, 100.0));
    bench.ask(&Command::FastStop);
    assert_eq!(bench.state(), GripperState::Idle);
    assert!(bench.has(SystemState::FAST_STOP));
}

#[test]
fn stop_ends_clamping() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.apply(Change::PlaceObstacle { width_mm: 40.0 });
    bench.run(&clamp_to(20.0, 100.0));
    assert_eq!(bench.reply(&Command::Stop), DONE);
    assert!(!bench.has(SystemState::BLOCKED_MINUS) && near(bench.snapshot().force_n, 0.0));
    bench.apply(Change::RemoveObstacle);
    bench.pass(ms(500));
    assert!(near(bench.snapshot().width_mm, 40.0));
}

#[test]
fn announced_disconnect_aborts_motion_and_denies_requests() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&move_to(10.0, 100.0));
    bench.pass(ms(100));
    let aborted = (id::PRE_POSITION, status(Status::E_CMD_ABORTED));
    let announced = (id::DISCONNECT_ANNOUNCEMENT, DONE);
    assert_eq!(bench.ask(&Command::DisconnectAnnouncement), [announced, aborted]);
    for command in [Command::FastStop, Command::GetSystemInfo, looped(&[1])] {
        assert_eq!(bench.reply(&command), status(Status::E_ACCESS_DENIED));
    }
    assert_eq!(bench.status_of_raw(0x99, &[]), Status::E_ACCESS_DENIED);
    bench.pass(ms(50));
    bench.device.disconnect(bench.now);
    assert!(!bench.has(SystemState::FAST_STOP));
    assert!(bench.device.connect(bench.now, Interface::Tcp));
    assert_eq!(bench.run(&move_to(50.0, 100.0)), [PENDING, DONE]);
}

#[test]
fn only_tcp_supports_disconnect_announcement() {
    for interface in [Interface::Udp, Interface::Serial, Interface::Can] {
        let mut bench = Bench::on(DeviceConfig::wsg50(), interface);
        assert_eq!(bench.reply(&Command::DisconnectAnnouncement), status(Status::E_NOT_AVAILABLE));
        assert_eq!(bench.reply(&looped(&[1])), Reply::Success(Data::Loop(vec![1])));
    }
}
