use crate::testing::*;
use crate::{AxisDirection, Change, DeviceConfig, Model};
use wsg::{Command, Data, Force, GripperState, HomingDirection, Reply, SoftLimits, Status, SystemState, id};

fn limits(minus: f32, plus: f32) -> Command {
    Command::SetSoftLimits(SoftLimits::new(width(minus), width(plus)).unwrap())
}

fn inner() -> Command {
    Command::Homing(HomingDirection::Inner)
}

#[test]
fn homing_finds_either_end_stop_and_backs_off() {
    for model in Model::ALL {
        let config = DeviceConfig::new(model);
        let stroke_mm = config.stroke_mm();
        let mut bench = Bench::new(config);
        assert!(!bench.snapshot().referenced);
        bench.home();
        assert!(near(bench.snapshot().width_mm, stroke_mm - 1.0), "{model:?}");
        assert_eq!(bench.run(&inner()), [PENDING, DONE]);
        assert!(near(bench.snapshot().width_mm, 1.0), "{model:?}");
        assert!(near(bench.snapshot().true_width_mm, 1.0), "{model:?}");
    }
}

#[test]
fn default_homing_direction_is_configurable() {
    let config = DeviceConfig { homing: AxisDirection::Closing, ..DeviceConfig::wsg50() };
    assert!(near(Bench::homed(config).snapshot().width_mm, 1.0));
}

#[test]
fn homing_is_unreferenced_and_positioning() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    assert_eq!(bench.ask(&inner()), [(id::HOMING, PENDING)]);
    bench.pass(ms(100));
    assert!(bench.has(SystemState::MOVING) && !bench.has(SystemState::REFERENCED));
    assert_eq!(bench.state(), GripperState::Positioning);

    let mut bench = Bench::homed(DeviceConfig::wsg50().fw2());
    bench.ask(&inner());
    assert_eq!(bench.state(), GripperState::Idle, "fw2 has no state for homing");
}

#[test]
fn obstacle_during_homing_gives_wrong_origin() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::PlaceObstacle { width_mm: 30.0 });
    assert_eq!(bench.run(&inner()), [PENDING, DONE]);
    assert!(near(bench.snapshot().width_mm, 1.0));
    assert!(near(bench.snapshot().true_width_mm, 31.0));
}

#[test]
fn blocked_back_off_fails_homing() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.ask(&inner());
    while bench.snapshot().true_width_mm > 0.001 {
        bench.pass(ms(1));
    }
    bench.apply(Change::PlaceObstacle { width_mm: 0.3 });
    let frames = bench.pass(ms(500));
    assert_eq!(frames, [(id::HOMING, status(Status::E_AXIS_BLOCKED))]);
    assert!(!bench.snapshot().referenced);
}

#[test]
fn ruling_every_motion_but_homing_needs_a_reference() {
    for config in [DeviceConfig::wsg50(), DeviceConfig::wsg50().fw2()] {
        let mut bench = Bench::new(config);
        for command in [move_to(50.0, 50.0), grip(50.0, 50.0), release(50.0, 50.0)] {
            assert_eq!(bench.reply(&command), status(Status::E_NOT_INITIALIZED));
        }
        bench.home();
        assert_eq!(bench.run(&move_to(50.0, 50.0)), [PENDING, DONE]);
    }
}

#[test]
fn move_duration_follows_speed_and_acceleration() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&move_to(50.0, 100.0));
    let start = bench.now;
    while bench.snapshot().moving {
        bench.pass(ms(1));
    }
    // 59 mm at 100 mm/s, and 40 ms each to speed up and slow down at 2500 mm/s².
    let elapsed = bench.now - start;
    assert!((ms(625)..ms(640)).contains(&elapsed), "{elapsed:?}");
    assert!(near(bench.snapshot().width_mm, 50.0));
}

#[test]
fn speed_sign_gives_direction() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&move_to(50.0, 100.0));
    bench.pass(ms(200));
    assert!(near(bench.snapshot().speed_mm_s, -100.0));
    bench.pass(ms(1000));
    bench.ask(&move_to(100.0, 100.0));
    bench.pass(ms(200));
    assert!(near(bench.snapshot().speed_mm_s, 100.0));
}

#[test]
fn relative_move_starts_at_current_width() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.run(&move_to(50.0, 400.0));
    bench.run(&move_by(-10.5, 400.0));
    assert!(near(bench.snapshot().width_mm, 39.5));
}

#[test]
fn width_and_speed_are_clamped() {
    for model in Model::ALL {
        let config = DeviceConfig::new(model);
        let (stroke_mm, max) = (config.stroke_mm(), f64::from(config.limits.max_speed.mm_s()));
        let mut bench = Bench::homed(config);
        bench.ask(&move_to(-50.0, 9999.0));
        let mut fastest = 0.0_f64;
        while bench.snapshot().moving {
            fastest = fastest.max(-bench.snapshot().speed_mm_s);
            bench.pass(ms(1));
        }
        assert!(fastest > 0.5 * max && fastest < max + 0.1, "{model:?}: {fastest}");
        assert!(near(bench.snapshot().width_mm, 0.0));
        assert_eq!(bench.run(&move_to(9999.0, 9999.0)), [PENDING, DONE]);
        assert!(near(bench.snapshot().width_mm, stroke_mm));
        bench.ask(&move_to(0.0, -7.0));
        bench.pass(ms(100));
        assert!(near(bench.snapshot().speed_mm_s, -5.0), "5 mm/s is the lowest speed");
    }
}

#[test]
fn checks_follow_the_manuals_order() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.ask(&Command::Homing(HomingDirection::Default));
    assert_eq!(bench.status_of_raw(id::GRIP, &[1]), Status::E_ALREADY_RUNNING);
    bench.ask(&Command::FastStop);
    assert_eq!(bench.status_of_raw(id::GRIP, &[1]), Status::E_ACCESS_DENIED);
    bench.pass(ms(100));
    bench.ask(&Command::AcknowledgeFastStop);
    assert_eq!(bench.status_of_raw(id::GRIP, &[1]), Status::E_CMD_FORMAT_ERROR);
    assert_eq!(bench.status_of_raw(id::HOMING, &[3]), Status::E_INVALID_PARAMETER);
    assert_eq!(bench.reply(&grip(20.0, 50.0)), status(Status::E_NOT_INITIALIZED));
    bench.home();
    bench.reply(&limits(10.0, 60.0));
    for command in [move_to(9.0, 50.0), grip(9.0, 50.0), release(110.0, 50.0)] {
        assert_eq!(bench.reply(&command), status(Status::E_RANGE_ERROR));
    }
}

#[test]
fn second_motion_is_rejected_while_one_runs() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&move_to(50.0, 50.0));
    for command in [move_to(60.0, 50.0), grip(20.0, 50.0), release(90.0, 50.0), inner()] {
        assert_eq!(bench.reply(&command), status(Status::E_ALREADY_RUNNING));
    }
}

#[test]
fn stop_on_block_leaves_the_motor_off() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.apply(Change::PlaceObstacle { width_mm: 40.0 });
    assert_eq!(bench.run(&move_to(20.0, 100.0)), [PENDING, status(Status::E_AXIS_BLOCKED)]);
    assert!(bench.has(SystemState::BLOCKED_MINUS) && !bench.has(SystemState::BLOCKED_PLUS));
    assert!(near(bench.snapshot().force_n, 0.0));
    bench.apply(Change::RemoveObstacle);
    bench.pass(ms(500));
    assert!(near(bench.snapshot().width_mm, 40.0), "the fingers do not snap to the target");
    assert_eq!(bench.run(&move_to(100.0, 100.0)), [PENDING, DONE]);
    bench.apply(Change::PlaceObstacle { width_mm: 105.0 });
    bench.run(&move_to(110.0, 100.0));
    assert!(bench.has(SystemState::BLOCKED_PLUS));
}

#[test]
fn clamp_on_block_presses_and_snaps_to_target_when_freed() {
    // Half of the nominal force (fw4), or the force limit (fw2).
    for (config, force_n) in [(DeviceConfig::wsg50(), 40.0), (DeviceConfig::wsg50().fw2(), 25.0)] {
        let mut bench = Bench::homed(DeviceConfig { force_limit_n: 25.0, ..config });
        bench.apply(Change::PlaceObstacle { width_mm: 40.0 });
        assert_eq!(bench.run(&clamp_to(20.0, 100.0)), [PENDING, status(Status::E_AXIS_BLOCKED)]);
        assert!(near(bench.snapshot().force_n, force_n) && bench.has(SystemState::BLOCKED_MINUS));
        assert!(!bench.has(SystemState::MOVING));
        bench.apply(Change::RemoveObstacle);
        bench.pass(ms(50));
        assert!(bench.has(SystemState::MOVING) && !bench.has(SystemState::BLOCKED_MINUS));
        assert_eq!(bench.reply(&move_to(50.0, 50.0)), status(Status::E_ALREADY_RUNNING));
        assert!(!bench.has(SystemState::TARGET_POS_REACHED));
        assert_eq!(bench.pass(ms(1000)), []);
        assert!(near(bench.snapshot().width_mm, 20.0) && bench.has(SystemState::TARGET_POS_REACHED));
    }
}

/// fw2 limits pre-positioning with the force limit, fw4 with half of the nominal force (fw2 3.3.3, `fw4-en 3.2.2`).
#[test]
fn force_limit_changes_the_clamping_force_in_fw2_only() {
    for (config, force_n) in [(DeviceConfig::wsg50(), 40.0), (DeviceConfig::wsg50().fw2(), 60.0)] {
        let mut bench = Bench::homed(DeviceConfig { force_limit_n: 40.0, ..config });
        bench.apply(Change::PlaceObstacle { width_mm: 40.0 });
        bench.run(&clamp_to(20.0, 100.0));
        assert!(near(bench.snapshot().force_n, 40.0));
        bench.reply(&Command::SetForceLimit(Force::new(60.0).unwrap()));
        bench.pass(ms(500));
        assert!(near(bench.snapshot().force_n, force_n), "{}", bench.snapshot().force_n);
        assert!(bench.has(SystemState::BLOCKED_MINUS));
    }
}

#[test]
fn target_pos_reached_follows_end_of_moving() {
    let reached = |config| {
        let mut bench = Bench::homed(config);
        bench.ask(&move_to(100.0, 100.0));
        while bench.has(SystemState::MOVING) {
            assert!(!bench.has(SystemState::TARGET_POS_REACHED));
            bench.pass(ms(1));
        }
        let at_once = bench.has(SystemState::TARGET_POS_REACHED);
        bench.pass(ms(10));
        assert!(bench.has(SystemState::TARGET_POS_REACHED));
        bench.ask(&move_to(50.0, 100.0));
        assert!(!bench.has(SystemState::TARGET_POS_REACHED));
        at_once
    };
    assert!(!reached(DeviceConfig::wsg50()), "fw4: not synchronous");
    assert!(reached(DeviceConfig::wsg50().fw2()));
}

#[test]
fn ruling_fingers_outside_the_soft_limits_may_move_towards_them() {
    for (start_mm, out_mm, towards_mm, beyond_mm) in [(70.0, 71.0, 60.0, 19.0), (10.0, 9.0, 15.0, 51.0)] {
        for config in [DeviceConfig::wsg50(), DeviceConfig::wsg50().fw2()] {
            let mut bench = Bench::homed(config);
            bench.run(&move_to(start_mm, 400.0));
            bench.reply(&limits(20.0, 50.0));
            assert!(bench.has_any(SystemState::SOFT_LIMIT_MINUS | SystemState::SOFT_LIMIT_PLUS));
            assert_eq!(bench.reply(&move_to(out_mm, 50.0)), status(Status::E_RANGE_ERROR), "further out");
            assert_eq!(bench.run(&move_to(towards_mm, 50.0)), [PENDING, DONE]);
            assert!(!bench.has(SystemState::FAST_STOP));
            assert_eq!(bench.reply(&move_to(start_mm, 50.0)), status(Status::E_RANGE_ERROR), "and not back");
            assert_eq!(bench.reply(&move_to(beyond_mm, 50.0)), status(Status::E_RANGE_ERROR), "not beyond");
            assert_eq!(bench.run(&move_to(30.0, 50.0)), [PENDING, DONE]);
        }
    }
}

#[test]
fn ruling_a_target_outside_the_soft_limits_is_refused_whichever_way_it_is_reached() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.run(&move_to(50.0, 400.0));
    bench.reply(&limits(20.0, 60.0));
    for command in [move_to(61.0, 50.0), move_by(11.0, 50.0), move_by(-31.0, 50.0), clamp_to(19.0, 50.0)] {
        assert_eq!(bench.reply(&command), status(Status::E_RANGE_ERROR));
    }
    assert_eq!(bench.run(&move_by(10.0, 50.0)), [PENDING, DONE]);
    assert!(bench.has(SystemState::SOFT_LIMIT_PLUS));
    assert_eq!(bench.reply(&move_to(60.5, 50.0)), status(Status::E_RANGE_ERROR));
    bench.run(&move_to(20.0, 50.0));
    assert!(bench.has(SystemState::SOFT_LIMIT_MINUS) && !bench.has(SystemState::SOFT_LIMIT_PLUS));
    bench.run(&move_to(40.0, 50.0));
    assert!(!bench.has_any(SystemState::SOFT_LIMIT_MINUS | SystemState::SOFT_LIMIT_PLUS));
}

#[test]
fn only_motion_back_inside_new_soft_limits_is_allowed() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.run(&move_to(80.0, 400.0));
    bench.reply(&limits(20.0, 60.0));
    assert!(bench.has(SystemState::SOFT_LIMIT_PLUS));
    assert_eq!(bench.reply(&move_to(90.0, 50.0)), status(Status::E_RANGE_ERROR));
    assert_eq!(bench.run(&move_to(50.0, 100.0)), [PENDING, DONE]);
    assert!(!bench.has_any(SystemState::SOFT_LIMIT_PLUS | SystemState::FAST_STOP));
}

#[test]
fn entering_forbidden_range_triggers_fast_stop() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.run(&move_to(80.0, 400.0));
    bench.ask(&move_to(20.0, 50.0));
    bench.pass(ms(200));
    bench.reply(&limits(50.0, 90.0));
    assert_eq!(bench.pass(ms(1000)), [(id::PRE_POSITION, status(Status::E_RANGE_ERROR))]);
    assert!(bench.has(SystemState::FAST_STOP | SystemState::SOFT_LIMIT_MINUS));
    assert!(bench.snapshot().width_mm > 49.0);
}

#[test]
fn homing_ignores_soft_limits() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.run(&move_to(50.0, 400.0));
    bench.reply(&limits(40.0, 60.0));
    assert_eq!(bench.run(&inner()), [PENDING, DONE]);
    assert!(!bench.has(SystemState::FAST_STOP) && bench.has(SystemState::SOFT_LIMIT_MINUS));
}

#[test]
fn unset_soft_limits_are_not_available() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    assert_eq!(bench.reply(&Command::GetSoftLimits), status(Status::E_NOT_AVAILABLE));
    bench.reply(&limits(5.0, 60.0));
    assert!(matches!(bench.reply(&Command::GetSoftLimits), Reply::Success(Data::SoftLimits(_))));
    bench.reply(&Command::ClearSoftLimits);
    assert_eq!(bench.reply(&Command::GetSoftLimits), status(Status::E_NOT_AVAILABLE));
}

#[test]
fn late_calls_give_same_result() {
    let story = |stride| {
        let mut bench = Bench::new(DeviceConfig::wsg50());
        bench.stride = ms(stride);
        let mut frames = bench.run(&Command::Homing(HomingDirection::Default));
        bench.apply(Change::PlacePart(crate::Part::outside(20.0)));
        frames.extend(bench.run(&grip(20.0, 80.0)));
        bench.apply(Change::SlipPart);
        bench.pass(ms(8000));
        frames.extend(bench.run(&release(60.0, 200.0)));
        frames.extend(bench.run(&clamp_to(10.0, 50.0)));
        (frames, bench.snapshot())
    };
    let in_time = story(1);
    assert_eq!(in_time.0.len(), 8);
    assert_eq!(story(7), in_time);
    assert_eq!(story(8000), in_time);
}

#[test]
fn own_timeouts_alone_give_same_result() {
    let story = |by_timeouts: bool| {
        let mut bench = Bench::homed(DeviceConfig::wsg50().with_part(crate::Part::outside(20.0)));
        bench.ask(&Command::GetWidth(updates(true, 25)));
        let end = bench.now + ms(5000);
        let mut frames = bench.ask(&grip(20.0, 80.0));
        while by_timeouts && let Some(due) = bench.device.poll_timeout() {
            assert!(due > bench.now, "due timers have run");
            bench.now = due;
            bench.device.handle_timeout(due);
            frames.extend(bench.frames());
        }
        frames.extend(bench.pass(end - bench.now));
        (frames, bench.snapshot())
    };
    assert_eq!(story(true), story(false));
}

#[test]
fn no_timer_runs_while_idle() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    assert_eq!(bench.device.poll_timeout(), None);
    bench.home();
    assert_eq!(bench.device.poll_timeout(), None);
    bench.apply(Change::PlacePart(crate::Part::outside(20.0)));
    bench.run(&grip(20.0, 80.0));
    assert_eq!(bench.device.poll_timeout(), None, "nor while a part is held");
}
