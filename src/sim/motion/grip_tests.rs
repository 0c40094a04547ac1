use crate::testing::*;
use crate::{Change, DeviceConfig, FingerConfig, Model, Part};
use wsg::{Command, Force, GripperState, HomingDirection, Status, SystemState, id};

/// Creates a homed device with a part between its jaws.
fn with_part(config: DeviceConfig, part: Part) -> Bench {
    let mut bench = Bench::homed(config);
    bench.apply(Change::PlacePart(part));
    bench
}

fn holding(config: DeviceConfig) -> Bench {
    let mut bench = with_part(config, Part::outside(20.0));
    assert_eq!(bench.run(&grip(20.0, 100.0)), [PENDING, DONE]);
    assert_eq!(bench.state(), GripperState::Holding);
    bench
}

fn both() -> [DeviceConfig; 2] {
    [DeviceConfig::wsg50(), DeviceConfig::wsg50().fw2()]
}

#[test]
fn part_is_held_with_force_limit() {
    for model in Model::ALL {
        let config = DeviceConfig::new(model);
        let force_n = config.force_limit_n;
        let bench = holding(config);
        assert!(near(bench.snapshot().force_n, force_n), "{model:?}");
        assert!(bench.has(SystemState::BLOCKED_MINUS) && !bench.has(SystemState::MOVING));
        let statistics = bench.snapshot().statistics;
        assert_eq!((statistics.total, statistics.no_part, statistics.lost_part), (1, 0, 0));
    }
}

#[test]
fn force_settles_before_part_counts_as_held() {
    let mut bench = with_part(DeviceConfig::wsg50(), Part::outside(20.0));
    bench.ask(&grip(20.0, 100.0));
    while bench.snapshot().force_n < 39.9 {
        assert_eq!(bench.state(), GripperState::Grasping);
        bench.pass(ms(1));
    }
    assert_eq!(bench.pass(ms(28)), []);
    assert_eq!(bench.state(), GripperState::Grasping);
    assert_eq!(bench.pass(ms(3)), [(id::GRIP, DONE)]);
    assert_eq!(bench.state(), GripperState::Holding);
}

#[test]
fn hollow_part_is_gripped_from_inside() {
    let mut bench = with_part(DeviceConfig::wsg50(), Part::inside(60.0));
    bench.run(&move_to(30.0, 200.0));
    assert_eq!(bench.run(&grip(60.0, 100.0)), [PENDING, DONE]);
    assert!(bench.has(SystemState::BLOCKED_PLUS));
    assert!(bench.snapshot().width_mm > 60.0);
    assert_eq!(bench.run(&release(40.0, 100.0)), [PENDING, DONE]);
    assert_eq!(bench.state(), GripperState::Idle);
}

#[test]
fn grip_without_part_ends_after_clamping_travel() {
    for config in both() {
        let mut bench = Bench::homed(config);
        assert_eq!(bench.run(&grip(20.0, 100.0)), [PENDING, status(Status::E_CMD_FAILED)]);
        assert_eq!(bench.state(), GripperState::NoPart);
        assert!(near(bench.snapshot().width_mm, 17.0));
        let statistics = bench.snapshot().statistics;
        assert_eq!((statistics.total, statistics.no_part), (1, 1));
    }
}

#[test]
fn part_is_recognised_within_tolerance_and_clamping_travel() {
    for (nominal, held) in [(19.2, true), (18.8, false), (22.7, true), (23.5, false)] {
        let mut bench = with_part(DeviceConfig::wsg50(), Part::outside(20.0));
        let expected = if held { DONE } else { status(Status::E_CMD_FAILED) };
        assert_eq!(bench.run(&grip(nominal, 100.0)), [PENDING, expected], "nominal {nominal}");
        let state = if held { GripperState::Holding } else { GripperState::NoPart };
        assert_eq!(bench.state(), state, "nominal {nominal}");
    }
}

#[test]
fn closed_fingers_do_not_count_as_part() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    assert_eq!(bench.run(&grip(1.0, 100.0)), [PENDING, status(Status::E_CMD_FAILED)]);
    assert!(near(bench.snapshot().width_mm, 0.0));
}

#[test]
fn too_soft_part_is_not_found() {
    let part = Part { stiffness_n_mm: 5.0, ..Part::outside(20.0) };
    let mut bench = with_part(DeviceConfig::wsg50(), part);
    assert_eq!(bench.run(&grip(20.0, 100.0)), [PENDING, status(Status::E_CMD_FAILED)]);
    assert_eq!(bench.state(), GripperState::NoPart);
}

#[test]
fn taken_part_is_lost() {
    for config in both() {
        let mut bench = holding(config);
        bench.apply(Change::TakePart);
        assert_eq!(bench.pass(ms(100)), [], "the grip already has its result");
        assert_eq!(bench.state(), GripperState::PartLost);
        assert_eq!(bench.snapshot().statistics.lost_part, 1);
        assert!(near(bench.snapshot().force_n, 0.0) && !bench.has(SystemState::BLOCKED_MINUS));
    }
}

#[test]
fn slipping_part_is_lost() {
    let mut bench = holding(DeviceConfig::wsg50());
    bench.apply(Change::SlipPart);
    bench.pass(ms(200));
    assert_eq!((bench.state(), bench.snapshot().part), (GripperState::PartLost, None));
}

#[test]
fn fingers_follow_shrinking_part_within_clamping_travel() {
    let mut bench = holding(DeviceConfig::wsg50());
    bench.apply(Change::ResizePart { width_mm: 19.95 });
    bench.pass(ms(200));
    assert_eq!(bench.state(), GripperState::Holding);
    assert!(near(bench.snapshot().force_n, 40.0));
    bench.apply(Change::ResizePart { width_mm: 10.0 });
    bench.pass(ms(500));
    assert_eq!(bench.state(), GripperState::PartLost);
}

#[test]
fn release_opens_to_absolute_width() {
    for config in both() {
        let mut bench = holding(config);
        bench.ask(&release(45.0, 100.0));
        assert_eq!(bench.state(), GripperState::Releasing);
        assert_eq!(bench.pass(ms(1000)), [(id::RELEASE, DONE)]);
        assert_eq!(bench.state(), GripperState::Idle);
        assert!(near(bench.snapshot().width_mm, 45.0) && near(bench.snapshot().force_n, 0.0));
        assert_eq!(bench.snapshot().statistics.lost_part, 0);
    }
}

#[test]
fn blocked_release_times_out() {
    for (config, state) in both().into_iter().zip([GripperState::Error, GripperState::Idle]) {
        let mut bench = holding(config);
        bench.apply(Change::PlaceObstacle { width_mm: 30.0 });
        assert_eq!(bench.run(&release(45.0, 100.0)), [PENDING, status(Status::E_TIMEOUT)]);
        assert_eq!(bench.state(), state);
        assert!(bench.has(SystemState::BLOCKED_PLUS));
    }
}

#[test]
fn ruling_no_part_lasts_until_any_motion_in_fw4_and_until_a_grip_or_release_in_fw2() {
    let states = |config, command: &Command| {
        let mut bench = Bench::homed(config);
        bench.run(&grip(20.0, 100.0));
        bench.ask(command);
        let during = bench.state();
        bench.pass(ms(8000));
        (during, bench.state())
    };
    let homing = Command::Homing(wsg::HomingDirection::Default);
    for command in [move_to(50.0, 100.0), homing] {
        let fw4 = states(DeviceConfig::wsg50(), &command);
        assert_eq!(fw4, (GripperState::Positioning, GripperState::Idle));
        let fw2 = states(DeviceConfig::wsg50().fw2(), &command);
        assert_eq!(fw2, (GripperState::NoPart, GripperState::NoPart));
    }
    let released = states(DeviceConfig::wsg50().fw2(), &release(50.0, 100.0));
    assert_eq!(released, (GripperState::Releasing, GripperState::Idle));
}

#[test]
fn regrip_is_allowed_in_same_direction_only() {
    let mut bench = holding(DeviceConfig::wsg50());
    assert_eq!(bench.run(&grip(20.0, 100.0)), [PENDING, DONE], "the same part again");
    assert_eq!(bench.run(&grip(19.0, 100.0)), [PENDING, DONE], "in the same direction");
    assert_eq!(bench.reply(&grip(60.0, 100.0)), status(Status::E_ALREADY_RUNNING), "in the opposite direction");
    bench.run(&release(40.0, 100.0));
    assert_eq!(bench.run(&grip(60.0, 100.0)), [PENDING, status(Status::E_CMD_FAILED)], "after a release");

    // Any other motion ends the gripping process, too.
    for between in [move_to(40.0, 100.0), Command::Homing(HomingDirection::Inner)] {
        let mut bench = Bench::homed(DeviceConfig::wsg50());
        bench.run(&grip(50.0, 100.0));
        assert_eq!(bench.reply(&grip(60.0, 100.0)), status(Status::E_ALREADY_RUNNING));
        assert_eq!(bench.run(&between), [PENDING, DONE]);
        assert_eq!(bench.run(&grip(60.0, 100.0)), [PENDING, status(Status::E_CMD_FAILED)], "{between:?}");
    }

    let mut bench = holding(DeviceConfig::wsg50().fw2());
    assert_eq!(bench.run(&grip(60.0, 100.0)).len(), 2, "fw2 does not have this rule");
}

#[test]
fn stop_while_gripping_leads_to_idle() {
    let mut bench = with_part(DeviceConfig::wsg50(), Part::outside(20.0));
    bench.ask(&grip(20.0, 50.0));
    bench.pass(ms(100));
    bench.ask(&Command::Stop);
    assert_eq!(bench.pass(ms(100)), [(id::STOP, DONE), (id::GRIP, status(Status::E_CMD_ABORTED))]);
    assert_eq!((bench.state(), bench.snapshot().statistics.no_part), (GripperState::Idle, 0));
}

#[test]
fn stop_while_holding_keeps_the_part_unless_configured_otherwise() {
    let mut bench = holding(DeviceConfig::wsg50());
    assert_eq!(bench.reply(&Command::Stop), DONE);
    assert_eq!(bench.state(), GripperState::Holding);

    let mut bench = holding(DeviceConfig { stop_lets_go: true, ..DeviceConfig::wsg50() });
    assert_eq!(bench.reply(&Command::Stop), DONE);
    assert_eq!(bench.state(), GripperState::Idle);
    assert!(near(bench.snapshot().force_n, 0.0));
}

#[test]
fn fast_stop_while_holding_ends_force() {
    let mut bench = holding(DeviceConfig::wsg50());
    assert_eq!(bench.reply(&Command::FastStop), DONE);
    assert_eq!(bench.state(), GripperState::Error);
    assert!(near(bench.snapshot().force_n, 0.0));
    assert_eq!(bench.snapshot().statistics.lost_part, 0);
}

#[test]
fn gripping_force_follows_force_limit() {
    let mut bench = holding(DeviceConfig::wsg50());
    for force_n in [75.0_f32, 12.0] {
        bench.reply(&Command::SetForceLimit(Force::new(force_n).unwrap()));
        bench.pass(ms(100));
        assert!(near(bench.snapshot().force_n, f64::from(force_n)));
        assert_eq!(bench.state(), GripperState::Holding);
    }
}

#[test]
fn force_control_mode_needs_force_finger_and_part() {
    let fingers = [FingerConfig::Fmf, FingerConfig::Fmf];
    let mut bench = holding(DeviceConfig { fingers, ..DeviceConfig::wsg50() });
    assert!(bench.has(SystemState::FORCECNTL_MODE));
    assert_eq!(bench.reply(&Command::TareForceSensor), status(Status::E_ACCESS_DENIED));
    bench.run(&release(50.0, 100.0));
    assert!(!bench.has(SystemState::FORCECNTL_MODE));
    assert_eq!(bench.reply(&Command::TareForceSensor), DONE);
    assert!(!holding(DeviceConfig::wsg50()).has(SystemState::FORCECNTL_MODE));
}
