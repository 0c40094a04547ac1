//! The fields `fault` and `fault_code`, the numbers of motions, and the count of changes in the state.

use std::time::Duration;

use model::{Code, FastStopCause, Fault, Outcome};
use sim::{Change, FaultKind};
use wsg::id;

use super::steps::*;
use crate::seeds::world::World;

fn fault(world: &World) -> (bool, u16) {
    (state(world).fault, state(world).fault_code)
}

#[test]
fn fault_ends_with_the_acknowledge() {
    let mut world = world();
    assert_eq!(fault(&world), (false, 0), "a gripper that has to be homed has no fault");
    run(&mut world, home());
    let id = fast_stop(&mut world);
    world.advance(Duration::from_millis(200));
    assert_eq!(fault(&world), (true, Fault::FastStop(FastStopCause::Requested).code()));
    acknowledge(&mut world, id);
    world.advance(Duration::from_millis(200));
    assert_eq!((values(&world).state, fault(&world)), (Some("ERROR"), (false, 0)));
    assert_eq!(run(&mut world, move_to(50.0, 100.0)).outcome, Some(Outcome::Success));
    assert_eq!(fault(&world), (false, 0));
}

#[test]
fn lost_link_is_a_fault() {
    let mut world = homed();
    world.disconnected("unplugged");
    assert_eq!(fault(&world), (true, Fault::LinkDown.code()));
}

#[test]
fn device_fault_is_named_by_its_fast_stop() {
    let mut world = homed();
    world.device.apply(world.now, Change::Overheat { temperature_c: 90.0 });
    world.advance(Duration::from_millis(200));
    assert_eq!(fault(&world), (true, Fault::FastStop(FastStopCause::TemperatureFault).code()));
}

#[test]
fn fault_flag_without_a_fast_stop_is_a_fault() {
    let mut world = homed();
    world.device.apply(world.now, Change::FingerOverCurrent { finger: 1, on: true });
    world.advance(Duration::from_millis(200));
    assert_eq!((state(&world).fast_stop, fault(&world)), (Some(false), (true, Fault::Finger.code())));
}

#[test]
fn error_without_a_fast_stop_is_a_fault_until_the_next_motion() {
    let mut world = homed();
    world.device.apply(world.now, Change::PlaceObstacle { width_mm: 50.0 });
    assert_eq!(run(&mut world, move_to(20.0, 50.0)).outcome, Some(Outcome::Blocked));
    world.advance(Duration::from_millis(200));
    assert_eq!((values(&world).state, fault(&world)), (Some("ERROR"), (true, Fault::DeviceError.code())));
    run(&mut world, move_to(80.0, 50.0));
    assert_eq!(fault(&world), (false, 0));
}

#[test]
fn motions_are_numbered_across_restarts() {
    let mut world = homed();
    assert_eq!((state(&world).last_command, state(&world).last_outcome), (1, Some(Outcome::Success)));
    let running = start(&mut world, move_to(50.0, 50.0));
    assert_eq!((running.now().number, state(&world).last_command), (Some(2), 2));
    assert_eq!(state(&world).last_outcome, None);
    finish(&mut world, &running);
    assert_eq!(
        (state(&world).last_command_id, state(&world).last_outcome),
        (Some(running.id()), Some(Outcome::Success))
    );
    world.restart();
    world.advance(Duration::from_secs(1));
    assert!(state(&world).last_command >= 2);
    assert_eq!(
        (state(&world).last_command_id, state(&world).last_outcome),
        (Some(running.id()), Some(Outcome::Success))
    );
}

#[test]
fn unknown_outcome_says_why() {
    let mut world = homed();
    world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::GRIP), times: 9 });
    let command = run(&mut world, grip(None));
    assert_eq!((command.outcome, command.code), (Some(Outcome::Unknown), Some(Code::DeviceTimeout)));
    let running = start(&mut world, move_to(5.0, 10.0));
    world.advance(Duration::from_millis(300));
    world.disconnected("unplugged");
    let command = finish(&mut world, &running);
    assert_eq!((command.outcome_code, command.code), (10, Some(Code::LinkDown)));
    assert!(command.detail.unwrap().contains("unplugged"));
}

#[test]
fn idle_gripper_changes_no_state() {
    let mut world = homed();
    world.advance(Duration::from_secs(10));
    let before = state(&world);
    world.watches.state.mark_unchanged();
    world.advance(Duration::from_secs(1));
    let after = state(&world);
    assert!(after.values.flags.arrived_at() > before.values.flags.arrived_at(), "updates still arrive");
    assert_eq!((after.seq, world.watches.state.has_changed().unwrap()), (before.seq, false));
    run(&mut world, move_to(50.0, 100.0));
    assert!(state(&world).seq > after.seq + 10, "each change counts");
}
