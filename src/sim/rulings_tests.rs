//! Rulings of the simulator where the manuals are silent or contradict each other. `deploy/guide/simulator.md` lists
//! them.

use super::testing::*;
use super::{Change, DeviceConfig, Part};
use wsg::{Command, Data, DeviceTag, GripperState, HomingDirection, Reply, Status, SystemState, Updates, Width, id};

fn holding(config: DeviceConfig) -> Bench {
    let mut bench = Bench::homed(config.with_part(Part::outside(20.0)));
    assert_eq!(bench.run(&grip(20.0, 100.0)), [PENDING, DONE]);
    bench
}

#[test]
fn stop_resets_blocked_while_holding_until_the_next_block() {
    let mut bench = holding(DeviceConfig::wsg50());
    assert!(bench.has(SystemState::BLOCKED_MINUS));
    assert_eq!(bench.reply(&Command::Stop), DONE);
    bench.pass(ms(500));
    assert!(!bench.has(SystemState::BLOCKED_MINUS));
    assert_eq!(bench.state(), GripperState::Holding);
    assert_eq!(bench.run(&grip(20.0, 100.0)), [PENDING, DONE]);
    assert!(bench.has(SystemState::BLOCKED_MINUS));
}

#[test]
fn total_counts_every_grip_that_was_accepted() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.run(&grip(20.0, 100.0));
    bench.run(&release(60.0, 400.0));
    bench.ask(&grip(20.0, 50.0));
    bench.pass(ms(100));
    bench.ask(&Command::Stop);
    bench.pass(ms(100));
    bench.ask(&Command::FastStop);
    assert_eq!(bench.reply(&grip(20.0, 50.0)), status(Status::E_ACCESS_DENIED));
    let statistics = bench.snapshot().statistics;
    assert_eq!((statistics.total, statistics.no_part, statistics.lost_part), (2, 1, 0));
}

#[test]
fn failed_motion_leads_to_error_in_fw4_only() {
    for (config, expected) in
        [(DeviceConfig::wsg50(), GripperState::Error), (DeviceConfig::wsg50().fw2(), GripperState::Idle)]
    {
        for command in [move_to(20.0, 100.0), clamp_to(20.0, 100.0)] {
            let mut bench = Bench::homed(config.clone());
            bench.apply(Change::PlaceObstacle { width_mm: 40.0 });
            assert_eq!(bench.run(&command), [PENDING, status(Status::E_AXIS_BLOCKED)]);
            assert_eq!(bench.state(), expected);
            bench.ask(&Command::Stop);
            bench.run(&move_to(60.0, 100.0));
            assert_eq!(bench.state(), GripperState::Idle, "until the next motion");
        }
    }
}

#[test]
fn fw2_reaches_a_target_by_move_and_grip_but_not_by_release() {
    for (config, by_release) in [(DeviceConfig::wsg50(), true), (DeviceConfig::wsg50().fw2(), false)] {
        let mut bench = holding(config);
        assert!(bench.has(SystemState::TARGET_POS_REACHED));
        bench.run(&release(60.0, 100.0));
        assert_eq!(bench.has(SystemState::TARGET_POS_REACHED), by_release);
        bench.run(&move_to(50.0, 100.0));
        assert!(bench.has(SystemState::TARGET_POS_REACHED));
        bench.home();
        assert!(!bench.has(SystemState::TARGET_POS_REACHED));
    }
}

#[test]
fn jammed_drive_times_out() {
    let homing = Command::Homing(HomingDirection::Default);
    for command in [homing, move_to(20.0, 100.0), grip(20.0, 100.0), release(60.0, 100.0)] {
        let mut bench = Bench::homed(DeviceConfig::wsg50());
        bench.apply(Change::Jam { on: true });
        assert_eq!(bench.run(&command), [PENDING, status(Status::E_TIMEOUT)]);
        assert_eq!((bench.state(), bench.has(SystemState::MOVING)), (GripperState::Error, false));
        bench.apply(Change::Jam { on: false });
        bench.home();
    }
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&move_to(20.0, 100.0));
    bench.pass(ms(100));
    bench.apply(Change::Jam { on: true });
    assert_eq!(bench.ask(&Command::Stop), []);
    let aborted = (id::PRE_POSITION, status(Status::E_CMD_ABORTED));
    assert_eq!(bench.pass(ms(4000)), [(id::STOP, status(Status::E_TIMEOUT)), aborted.clone()]);
    // A FAST STOP and its acknowledgement do not time out.
    bench.ask(&move_to(20.0, 100.0));
    assert_eq!(bench.ask(&Command::FastStop), [(id::FAST_STOP, DONE), aborted]);
    assert_eq!(bench.reply(&Command::AcknowledgeFastStop), DONE);
}

#[test]
fn hard_limit_is_a_range_error() {
    // An obstacle during the homing shifts the origin, so the end stop comes before the target.
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::PlaceObstacle { width_mm: 80.0 });
    bench.home();
    bench.apply(Change::RemoveObstacle);
    for command in [move_to(10.0, 200.0), clamp_to(5.0, 200.0)] {
        assert_eq!(bench.run(&command), [PENDING, status(Status::E_RANGE_ERROR)]);
        assert!(bench.has(SystemState::BLOCKED_MINUS) && near(bench.snapshot().force_n, 0.0), "stopped");
        bench.run(&move_to(100.0, 200.0));
    }
}

#[test]
fn empty_tag_removes_the_tag() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    let tag = |text: &str| Command::SetDeviceTag(DeviceTag::new(text.as_bytes()).unwrap());
    bench.reply(&tag("cell 7"));
    assert_eq!(bench.reply(&tag("")), DONE);
    assert_eq!(bench.reply(&Command::GetDeviceTag), status(Status::E_NOT_AVAILABLE));
}

/// fw4-en 3.5.2 says ASCII; fw2 3.5.2 says text, and strips trailing NULs.
#[test]
fn tag_of_fw2_takes_other_characters_and_nuls() {
    for (config, expected) in
        [(DeviceConfig::wsg50(), status(Status::E_INVALID_PARAMETER)), (DeviceConfig::wsg50().fw2(), DONE)]
    {
        for tag in ["Zelle ü", "cell 7\0"] {
            let mut bench = Bench::new(config.clone());
            assert_eq!(bench.reply(&Command::SetDeviceTag(DeviceTag::from_text(tag).unwrap())), expected, "{tag:?}");
            if expected == DONE {
                let shown = DeviceTag::from_text(tag.trim_end_matches('\0')).unwrap();
                assert_eq!(bench.reply(&Command::GetDeviceTag), Reply::Success(Data::DeviceTag(shown)));
            }
        }
    }
}

#[test]
fn fast_stop_can_keep_a_held_part() {
    let mut bench = holding(DeviceConfig { fast_stop_lets_go: false, ..DeviceConfig::wsg50() });
    assert_eq!(bench.reply(&Command::FastStop), DONE);
    bench.pass(ms(500));
    assert!(near(bench.snapshot().force_n, 40.0));
    assert_eq!(bench.state(), GripperState::Error);
    bench.reply(&Command::AcknowledgeFastStop);
    bench.apply(Change::TakePart);
    bench.pass(ms(500));
    assert_eq!((bench.state(), bench.snapshot().statistics.lost_part), (GripperState::Error, 1));
    assert_eq!(bench.run(&release(60.0, 100.0)), [PENDING, DONE]);
}

#[test]
fn reversed_soft_limits_are_refused() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    let payload: Vec<u8> = [60.0_f32, 10.0].into_iter().flat_map(f32::to_le_bytes).collect();
    assert_eq!(bench.status_of_raw(id::SET_SOFT_LIMITS, &payload), Status::E_INVALID_PARAMETER);
    assert_eq!(bench.reply(&Command::GetSoftLimits), status(Status::E_NOT_AVAILABLE));
    assert_eq!(bench.run(&move_to(5.0, 200.0)), [PENDING, DONE]);
}

#[test]
fn fw2_returns_moving_widths_before_homing_and_fw4_zero() {
    for (config, is_shown) in [(DeviceConfig::wsg50(), false), (DeviceConfig::wsg50().fw2(), true)] {
        let mut bench = Bench::new(config);
        bench.ask(&Command::Homing(HomingDirection::Default));
        bench.pass(ms(200));
        assert!(!bench.has(SystemState::REFERENCED));
        let shown = bench.reply(&Command::GetWidth(Updates::Off));
        assert_eq!(shown != Reply::Success(Data::Width(Width::ZERO)), is_shown);
    }
}
