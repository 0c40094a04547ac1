use wsg::{Command, GripperState, HomingDirection, Reply, Status, SystemState, id};

use super::*;
use crate::testing::{Bench, DONE, PENDING, clamp_to, move_to, ms, near, status};
use crate::{Change, DeviceConfig, Part};

/// Period of the script in these tests.
const PERIOD: Duration = Duration::from_millis(25);

fn with(script: SteeringScript) -> DeviceConfig {
    let steering = SteeringConfig { script: Some(script), period: PERIOD, delay: Duration::ZERO };
    DeviceConfig { steering, ..DeviceConfig::wsg50() }
}

/// Payload of a public script's request.
fn request(values: &[f32]) -> Vec<u8> {
    [vec![0], bytes_of_f32(values)].concat()
}

fn bytes_of_f32(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn gains(position_mm: f32) -> Vec<u8> {
    request(&[position_mm, 0.0, 15.0, 0.001, 40.0, 20.0])
}

/// Sends a request, and returns the data of the reply, which comes within a period.
fn ask(bench: &mut Bench, id: u8, payload: &[u8]) -> Vec<u8> {
    let mut frames = bench.ask_raw(id, payload);
    frames.extend(bench.pass(PERIOD));
    match frames.as_slice() {
        [(answered, Reply::Success(Data::Custom(bytes)))] if *answered == id => bytes.clone(),
        other => panic!("{other:?}"),
    }
}

fn status_of(bench: &mut Bench, payload: &[u8]) -> Status {
    let mut frames = bench.ask_raw(WATCHDOG, payload);
    frames.extend(bench.pass(PERIOD));
    assert_eq!(frames.len(), 1, "{frames:?}");
    frames[0].1.status()
}

fn float(bytes: &[u8], index: usize) -> f64 {
    f64::from(f32::from_le_bytes(bytes[index..index + 4].try_into().unwrap()))
}

#[test]
fn gains_lead_to_the_target_and_the_reply_has_state_and_width() {
    let mut bench = Bench::homed(with(SteeringScript::Pd));
    let at_start = ask(&mut bench, TARGET, &gains(60.0));
    assert_eq!(at_start.len(), 17);
    assert!(bench.has(SystemState::MOVING));
    assert_eq!(bench.state(), GripperState::Idle);
    for _ in 0..100 {
        ask(&mut bench, TARGET, &gains(60.0));
    }
    assert!(near(bench.snapshot().width_mm, 60.0), "{:?}", bench.snapshot());
    let bytes = ask(&mut bench, READ, &[0]);
    assert_eq!(u32::from(bytes[0]), bench.snapshot().flags.bits() & 0xFF);
    assert!(near(float(&bytes, 1), 60.0));
    assert!(float(&bytes, 13) > float(&at_start, 13), "the script's clock runs");
}

#[test]
fn public_scripts_go_on_when_their_client_is_silent() {
    let mut bench = Bench::homed(with(SteeringScript::Pd));
    ask(&mut bench, TARGET, &gains(100.0));
    bench.pass(ms(3000));
    let width_mm = bench.snapshot().width_mm;
    assert!(width_mm < 0.1, "the fingers keep the last speed to the end of their travel: {width_mm}");
    assert!(bench.has(SystemState::BLOCKED_MINUS) && !bench.has(SystemState::MOVING));

    let mut bench = Bench::homed(with(SteeringScript::Width));
    assert_eq!(ask(&mut bench, TARGET, &request(&[30.0, 50.0])).len(), 21);
    bench.pass(ms(3000));
    assert!(near(bench.snapshot().width_mm, 30.0));
    assert!(!bench.has(SystemState::MOVING));
    ask(&mut bench, SPEED, &request(&[0.0, 50.0]));
    bench.pass(ms(3000));
    assert!(bench.snapshot().width_mm > 109.9);
}

#[test]
fn newest_target_wins_without_a_jump() {
    let mut bench = Bench::homed(with(SteeringScript::Width));
    ask(&mut bench, TARGET, &request(&[20.0, 200.0]));
    bench.pass(ms(200));
    let before = bench.snapshot();
    assert!(near(before.speed_mm_s, -200.0));
    bench.ask_raw(TARGET, &request(&[100.0, 200.0]));
    let mut slowest_mm_s = before.speed_mm_s;
    for _ in 0..300 {
        bench.pass(ms(1));
        let speed_mm_s = bench.snapshot().speed_mm_s;
        let change_mm_s = (speed_mm_s - slowest_mm_s).abs();
        assert!(change_mm_s <= 2.501, "2,500 mm/s² allow no change of {change_mm_s}");
        slowest_mm_s = speed_mm_s;
        if speed_mm_s >= 199.9 {
            break;
        }
    }
    assert!(near(slowest_mm_s, 200.0));
}

#[test]
fn requests_wait_for_the_period_and_the_delay() {
    let steering = SteeringConfig { delay: ms(5), ..with(SteeringScript::Width).steering };
    let mut bench = Bench::homed(DeviceConfig { steering, ..DeviceConfig::wsg50() });
    for _ in 0..3 {
        assert_eq!(bench.ask_raw(TARGET, &request(&[30.0, 50.0])), []);
    }
    let mut answered = Vec::new();
    for at in 1..=60 {
        answered.extend(bench.pass(ms(1)).iter().map(|_| at));
    }
    assert_eq!(answered, [5, 30, 55]);
    for _ in 0..=MAX_WAITING_REQUESTS {
        bench.ask_raw(READ, &[]);
    }
    assert_eq!(bench.snapshot().refused_requests, 1);
}

#[test]
fn stop_and_fast_stop_end_steering_until_the_next_target() {
    let mut bench = Bench::homed(with(SteeringScript::Width));
    ask(&mut bench, TARGET, &request(&[20.0, 100.0]));
    assert_eq!(bench.ask(&move_to(50.0, 50.0)), [(id::PRE_POSITION, status(Status::E_ALREADY_RUNNING))]);
    assert_eq!(bench.run(&Command::Stop), [DONE]);
    let stopped_mm = bench.snapshot().width_mm;
    bench.pass(ms(500));
    assert!(near(bench.snapshot().width_mm, stopped_mm) && bench.has(SystemState::AXIS_STOPPED));
    ask(&mut bench, TARGET, &request(&[20.0, 100.0]));
    assert!(bench.has(SystemState::MOVING) && !bench.has(SystemState::AXIS_STOPPED));

    bench.reply(&Command::FastStop);
    bench.pass(ms(500));
    let stopped_mm = bench.snapshot().width_mm;
    ask(&mut bench, TARGET, &request(&[20.0, 100.0]));
    ask(&mut bench, SPEED, &request(&[0.0, 100.0]));
    bench.pass(ms(500));
    assert!(near(bench.snapshot().width_mm, stopped_mm), "nothing moves in FAST STOP");
}

#[test]
fn target_ends_a_motion_and_a_grip() {
    let mut bench = Bench::homed(with(SteeringScript::Width).with_part(Part::outside(20.0)));
    assert_eq!(bench.ask(&move_to(30.0, 50.0)), [(id::PRE_POSITION, PENDING)]);
    let frames = bench.ask_raw(TARGET, &request(&[80.0, 50.0]));
    assert_eq!(frames[0], (id::PRE_POSITION, status(Status::E_CMD_ABORTED)));
    for _ in 0..40 {
        ask(&mut bench, TARGET, &request(&[15.0, 100.0]));
    }
    assert!(bench.has(SystemState::BLOCKED_MINUS) && !bench.has(SystemState::MOVING));
    assert!(near(bench.snapshot().force_n, 40.0), "the script presses with the force limit: {:?}", bench.snapshot());
    ask(&mut bench, TARGET, &request(&[60.0, 100.0]));
    bench.pass(PERIOD);
    assert!(bench.has(SystemState::MOVING) && !bench.has(SystemState::BLOCKED_MINUS));
    assert_eq!(bench.snapshot().statistics.total, 0);
}

#[test]
fn soft_limits_hold_for_targets_and_speeds() {
    let limits = wsg::SoftLimits::new(crate::testing::width(40.0), crate::testing::width(109.5)).unwrap();
    let mut bench = Bench::homed(DeviceConfig { soft_limits: Some(limits), ..with(SteeringScript::Width) });
    ask(&mut bench, TARGET, &request(&[30.0, 100.0]));
    assert!(!bench.has(SystemState::MOVING), "a target beyond the limits is refused");
    ask(&mut bench, SPEED, &request(&[0.0, -100.0]));
    bench.pass(ms(2000));
    assert!(bench.has(SystemState::FAST_STOP));
    assert!(bench.snapshot().width_mm > 38.0);
}

#[test]
fn watchdog_stops_the_fingers_after_its_time() {
    let mut bench = Bench::homed(with(SteeringScript::Watchdog));
    let target = bytes_of_f32(&[20.0, 100.0]);
    for _ in 0..20 {
        let bytes = ask(&mut bench, WATCHDOG, &target);
        assert_eq!((bytes.len(), bytes[9]), (10, 0));
    }
    assert!(bench.has(SystemState::MOVING));
    // 25 of 200 ms have passed.
    bench.pass(ms(174));
    assert!(near(bench.snapshot().speed_mm_s, -100.0));
    assert_eq!(ask(&mut bench, WATCHDOG, &[])[9], 0, "a read is no target");
    bench.pass(ms(40));
    assert!(!bench.has(SystemState::MOVING) && bench.has(SystemState::AXIS_STOPPED));
    let bytes = ask(&mut bench, WATCHDOG, &[]);
    assert!(near(float(&bytes, 0), bench.snapshot().width_mm));
    assert_eq!(bytes[9], STOPPED_BY_WATCHDOG);
    assert_eq!(ask(&mut bench, WATCHDOG, &target)[9], STOPPED_BY_WATCHDOG, "until the reply to the next target");
    assert_eq!(ask(&mut bench, WATCHDOG, &target)[9], 0);
}

#[test]
fn watchdog_script_says_why_it_refuses_a_target() {
    let limits = wsg::SoftLimits::new(crate::testing::width(40.0), crate::testing::width(109.5)).unwrap();
    let mut bench = Bench::new(DeviceConfig { soft_limits: Some(limits), ..with(SteeringScript::Watchdog) });
    let inside = bytes_of_f32(&[60.0, 100.0]);
    assert_eq!(status_of(&mut bench, &inside), Status::E_NOT_INITIALIZED);
    bench.run(&Command::Homing(HomingDirection::Default));
    assert_eq!(status_of(&mut bench, &bytes_of_f32(&[f32::NAN, 100.0])), Status::E_CMD_FORMAT_ERROR);
    assert_eq!(status_of(&mut bench, &inside[..7]), Status::E_CMD_FORMAT_ERROR);
    bench.pass(ms(25));
    let outside = bytes_of_f32(&[30.0, 100.0]);
    while !bench.has(SystemState::FAST_STOP) {
        assert_eq!(status_of(&mut bench, &outside), Status::E_SUCCESS, "the script does not know the soft limits");
    }
    assert_eq!(status_of(&mut bench, &inside), Status::E_ACCESS_DENIED);
    assert!(!bench.has(SystemState::MOVING));
}

#[test]
fn public_script_is_silent_about_a_request_that_it_cannot_read() {
    let mut bench = Bench::homed(with(SteeringScript::Pd));
    assert_eq!(bench.ask_raw(TARGET, &[0; 9]), []);
    assert_eq!(bench.ask_raw(READ, &[]), []);
    assert_eq!(bench.pass(ms(99)), []);
    assert_eq!(bench.pass(ms(1)).len(), 1, "it goes on after a pause");
    assert_eq!(bench.status_of_raw(SPEED, &request(&[0.0, 10.0])), Status::E_CMD_UNKNOWN);
}

#[test]
fn requests_are_forgotten_with_their_script_and_client() {
    let mut bench = Bench::homed(with(SteeringScript::Width));
    assert!(bench.has(SystemState::SCRIPT_RUNNING));
    ask(&mut bench, READ, &[]);
    bench.ask_raw(READ, &[]);
    bench.ask_raw(TARGET, &request(&[30.0, 50.0]));
    bench.apply(Change::FailScript);
    assert_eq!(bench.status_of_raw(TARGET, &request(&[30.0, 50.0])), Status::E_CMD_UNKNOWN);
    assert_eq!(bench.pass(ms(100)), []);
    bench.apply(Change::StartScript);
    bench.run(&clamp_to(60.0, 100.0));
    assert!(near(bench.snapshot().width_mm, 60.0));
}
