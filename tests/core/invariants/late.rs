//! Requests, replies and values that arrive late or twice: nothing moves after its client learned that nothing is
//! known.

use std::time::Duration;

use gripper::{Failure, Rejection};
use model::{Detail, DeviceEvent, Outcome, SettingChange, SettingsEvent};
use sim::{BrokenGetter, Change, DeviceConfig, FaultKind, Interface};
use wsg::{self, Acceleration, Data, GripperState, Reply, Status, SystemState, id};

use super::steps::*;
use crate::seeds::world::World;

fn homed_on(interface: Interface) -> World {
    let mut world = World::calm_on(interface, device(), None);
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    world
}

/// Delivers a frame that the gateway sent earlier to the device once more.
fn deliver_again(world: &mut World, command: &wsg::Command) {
    let mut frame = Vec::new();
    command.encode(&mut frame);
    world.device.receive(world.now, &frame);
    world.settle();
}

/// Delivers an update that the device sent earlier.
fn update(world: &mut World, id: u8, data: Data) {
    let mut frame = Vec::new();
    Reply::Success(data).encode(id, &mut frame);
    let now = world.clock();
    world.actor.receive(now, &frame);
    world.settle();
}

#[test]
fn motion_delayed_beyond_its_result_does_not_move_the_fingers() {
    for interface in [Interface::Tcp, Interface::Serial, Interface::Can] {
        let mut world = homed_on(interface);
        let from = mark(&world);
        world.stall_requests(Duration::from_secs(4));
        let command = run(&mut world, move_to(50.0, 200.0));
        assert_eq!(command.outcome, Some(Outcome::Unknown));
        let detail = command.detail.unwrap();
        assert!(detail.ends_with("; the gateway sends a Stop after this command"), "{detail}");
        assert!(received(&world, from).is_empty(), "nothing has arrived");
        world.advance(Duration::from_secs(4));
        assert_eq!(received(&world, from)[..2], [id::PRE_POSITION, id::STOP], "{interface:?}");
        let width_mm = values(&world).width_mm.unwrap();
        assert!(width_mm > 107.0, "the fingers moved to {width_mm} on {interface:?}");
    }
}

/// A Stop can let a part go (the manuals do not say).
#[test]
fn part_gripped_without_any_reply_stays_held() {
    let mut world = World::calm(DeviceConfig { stop_lets_go: true, ..device() }, None);
    run(&mut world, home());
    run(&mut world, move_to(24.0, 200.0));
    world.device.apply(world.now, Change::BreakGetter { id: id::GRIP, how: BrokenGetter::Silent });
    let from = mark(&world);
    let command = run(&mut world, grip(None));
    assert_eq!(command.outcome, Some(Outcome::Unknown));
    world.advance(Duration::from_secs(1));
    assert_eq!((received(&world, from), values(&world).state), (vec![id::GRIP], Some("HOLDING")));
    // A part that was held before says nothing about the next grip.
    let from = mark(&world);
    run(&mut world, grip(None));
    world.advance(Duration::from_secs(1));
    assert_eq!(received(&world, from), [id::GRIP, id::STOP]);
}

#[test]
fn accepted_motion_without_a_result_is_stopped_if_it_may_still_run() {
    let mut world = homed();
    world.device.apply(world.now, Change::Fault { kind: FaultKind::PendingWithoutFinal, id: None, times: 1 });
    let from = mark(&world);
    assert_eq!(run(&mut world, move_to(50.0, 200.0)).outcome, Some(Outcome::Unknown));
    world.advance(Duration::from_secs(1));
    assert_eq!(received(&world, from), [id::PRE_POSITION], "the fingers are known to stand still");
}

#[test]
fn unanswered_motion_of_a_lost_link_is_stopped_after_the_reconnection() {
    let mut world = homed_on(Interface::Serial);
    world.device.apply(world.now, Change::Silent { on: true });
    let running = start(&mut world, move_to(20.0, 10.0));
    world.advance(Duration::from_millis(500));
    assert!(world.device.snapshot().moving);
    world.device.apply(world.now, Change::Silent { on: false });
    let from = mark(&world);
    world.disconnected("unplugged");
    let command = finish(&mut world, &running);
    assert_eq!(command.outcome, Some(Outcome::Unknown));
    assert!(command.detail.unwrap().ends_with("a Stop after this command"));
    world.advance(Duration::from_secs(1));
    assert!(received(&world, from).contains(&id::STOP));
    assert!(!world.device.snapshot().moving);
}

#[test]
fn late_motion_that_overtakes_its_stop_is_stopped_again() {
    let mut world = homed_on(Interface::Udp);
    world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::PRE_POSITION), times: 1 });
    let motion = move_to(50.0, 20.0);
    assert_eq!(run(&mut world, motion.clone()).outcome, Some(Outcome::Unknown));
    world.advance(Duration::from_millis(500));
    deliver_again(&mut world, &motion.request());
    world.advance(Duration::from_millis(200));
    assert!(!world.device.snapshot().moving);
    assert!(values(&world).width_mm.unwrap() > 104.0);
}

#[test]
fn lost_stop_of_a_late_motion_is_repeated() {
    for interface in [Interface::Udp, Interface::Serial, Interface::Can] {
        let mut world = homed_on(interface);
        world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::PRE_POSITION), times: 1 });
        let motion = move_to(50.0, 5.0);
        assert_eq!(run(&mut world, motion.clone()).outcome, Some(Outcome::Unknown));
        world.advance(Duration::from_millis(500));
        world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::STOP), times: 1 });
        deliver_again(&mut world, &motion.request());
        world.advance(Duration::from_millis(200));
        assert!(world.device.snapshot().moving, "the first Stop is lost");
        world.advance(Duration::from_secs(2));
        assert!(!world.device.snapshot().moving, "{interface:?}");
    }
}

#[test]
fn motion_that_begins_after_its_link_was_lost_is_stopped() {
    let mut world = homed_on(Interface::Serial);
    world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::PRE_POSITION), times: 1 });
    let motion = move_to(50.0, 5.0);
    let running = start(&mut world, motion.clone());
    world.advance(Duration::from_millis(200));
    world.disconnected("unplugged");
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Unknown));
    world.advance(Duration::from_secs(2));
    assert!(!world.device.snapshot().moving && world.is_connected());
    deliver_again(&mut world, &motion.request());
    world.advance(Duration::from_millis(500));
    assert!(!world.device.snapshot().moving);
}

#[test]
fn late_motion_is_not_expected_after_a_newer_one() {
    for interface in [Interface::Serial, Interface::Can] {
        let mut world = homed_on(interface);
        world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::PRE_POSITION), times: 1 });
        assert_eq!(run(&mut world, move_to(50.0, 20.0)).outcome, Some(Outcome::Unknown));
        world.advance(Duration::from_millis(500));
        assert_eq!(run(&mut world, move_to(60.0, 200.0)).outcome, Some(Outcome::Success));
        let from = mark(&world);
        world.device.apply(world.now, Change::MoveBySomebody { width_mm: 80.0, speed_mm_s: 10.0 });
        world.advance(Duration::from_secs(1));
        assert!(world.device.snapshot().moving);
        assert!(!received(&world, from).contains(&id::STOP), "{interface:?}");
    }
}

#[test]
fn motion_of_somebody_else_after_a_lost_request_is_not_stopped() {
    let mut world = homed_on(Interface::Tcp);
    world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::PRE_POSITION), times: 1 });
    assert_eq!(run(&mut world, move_to(50.0, 20.0)).outcome, Some(Outcome::Unknown));
    world.advance(Duration::from_secs(1));
    let from = mark(&world);
    world.device.apply(world.now, Change::MoveBySomebody { width_mm: 60.0, speed_mm_s: 10.0 });
    world.advance(Duration::from_secs(1));
    assert!(world.device.snapshot().moving);
    assert!(!received(&world, from).contains(&id::STOP));
}

#[test]
fn grip_is_confirmed_by_a_state_that_a_short_gap_delays() {
    let mut world = World::calm(device().with_part(sim::Part::outside(20.0)), None);
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    let running = start(&mut world, grip(None));
    world.advance(Duration::from_millis(100));
    world.device.apply(world.now, Change::BreakGetter { id: id::GET_GRIPPER_STATE, how: BrokenGetter::Silent });
    while world.device.snapshot().moving {
        world.advance(Duration::from_millis(10));
    }
    world.advance(Duration::from_millis(250));
    world.device.apply(world.now, Change::MendGetters);
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::PartHeld));
}

#[test]
fn unanswered_script_is_followed_by_a_stop() {
    let mut world = homed();
    let from = mark(&world);
    world.stall_requests(Duration::from_secs(2));
    let script = wsg::CustomCommand::new(0xB7, vec![1]).unwrap();
    let running = start(&mut world, model::Motion::Custom(script));
    world.advance(Duration::from_secs(40));
    assert_eq!(running.now().outcome, Some(Outcome::Unknown));
    assert_eq!(received(&world, from)[..2], [0xB7, id::STOP]);
}

#[test]
fn setting_that_took_effect_late_is_read_back() {
    let mut world = homed();
    world.stall_requests(Duration::from_secs(2));
    let acceleration = Acceleration::new(700.0).unwrap();
    let mut set = exchange(&mut world, wsg::Command::SetAcceleration(acceleration));
    world.advance(Duration::from_millis(1500));
    let rejection = set.try_recv().unwrap().unwrap_err();
    assert!(matches!(rejection, Rejection::Failure(Failure::DeviceTimeout { .. })), "{rejection:?}");
    world.advance(Duration::from_secs(4));
    let is_set = |event: &Detail| {
        let setting = SettingChange::Acceleration { acceleration_mm_s2: 700.0 };
        *event == Detail::Settings(SettingsEvent { restored: false, setting })
    };
    assert_eq!(world.journal.events.iter().filter(|event| is_set(event)).count(), 1);
    world.device.apply(world.now, Change::Reboot { ready_after_ms: 200, mid_frame: false });
    world.advance(Duration::from_secs(3));
    assert!((world.device.snapshot().acceleration_mm_s2 - 700.0).abs() < 0.1, "restored as the client wanted it");
}

#[test]
fn duplicate_of_a_request_does_not_end_its_motion() {
    let mut world = homed_on(Interface::Udp);
    let motion = move_to(50.0, 100.0);
    let running = start(&mut world, motion.clone());
    world.advance(Duration::from_millis(100));
    deliver_again(&mut world, &motion.request());
    world.advance(Duration::from_millis(100));
    assert_eq!(running.now().outcome, None, "E_ALREADY_RUNNING belongs to the duplicate");
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Success));
}

#[test]
fn late_datagram_is_not_believed_alone() {
    let mut world = homed_on(Interface::Udp);
    let events = world.journal.events.len();
    update(&mut world, id::GET_SYSTEM_STATE, Data::SystemState(SystemState::empty()));
    update(&mut world, id::GET_GRIPPER_STATE, Data::GripperState(GripperState::PartLost));
    world.advance(Duration::from_millis(100));
    update(&mut world, id::GET_SYSTEM_STATE, Data::SystemState(SystemState::REFERENCED | SystemState::FAST_STOP));
    world.advance(Duration::from_millis(100));
    assert_eq!((state(&world).latch, values(&world).referenced), (None, Some(true)));
    assert_eq!(world.journal.events[events..], [], "no restart, no FAST STOP, no lost part");
    assert_eq!(run(&mut world, move_to(50.0, 100.0)).outcome, Some(Outcome::Success));
}

#[test]
fn alarming_value_counts_once_it_is_repeated() {
    let mut world = homed_on(Interface::Udp);
    world.device.apply(world.now, Change::SetFastStop);
    world.advance(Duration::from_millis(50));
    assert!(latch(&world).fast_stop_confirmed);
    let mut world = homed_on(Interface::Udp);
    world.device.apply(world.now, Change::Reboot { ready_after_ms: 200, mid_frame: false });
    world.advance(Duration::from_secs(4));
    let restarted = Detail::Device(DeviceEvent::Restarted);
    assert_eq!(world.journal.events.iter().filter(|event| **event == restarted).count(), 1);
}

#[test]
fn device_without_loop_does_not_block_a_command_for_good() {
    let mut world = World::calm(device(), None);
    world.device.apply(world.now, Change::BreakGetter { id: id::LOOP, how: BrokenGetter::Silent });
    // The link is set up anew, so that no Loop was ever answered on it.
    world.device.apply(world.now, Change::CutConnection);
    world.advance(Duration::from_secs(5));
    world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::GET_STATISTICS), times: 1 });
    let mut lost = exchange(&mut world, wsg::Command::GetStatistics { reset: true });
    world.advance(Duration::from_secs(5));
    assert!(lost.try_recv().unwrap().is_err());
    let mut next = exchange(&mut world, wsg::Command::GetStatistics { reset: true });
    world.advance(Duration::from_secs(1));
    assert!(next.try_recv().unwrap().is_ok(), "a time limit takes over");
}

#[test]
fn held_part_is_confirmed_by_the_grippers_state() {
    let mut world = World::calm(sim::DeviceConfig::wsg50(), None);
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    let success = FaultKind::FinalStatus { code: Status::E_SUCCESS.code() };
    world.device.apply(world.now, Change::Fault { kind: success, id: Some(id::GRIP), times: 1 });
    let command = run(&mut world, grip(None));
    assert_eq!((command.outcome, command.status_code), (Some(Outcome::NoPart), Some(0)), "41h says NO_PART");

    let mut world = homed();
    let running = start(&mut world, grip(None));
    world.advance(Duration::from_millis(100));
    world.device.apply(world.now, Change::BreakGetter { id: id::GET_GRIPPER_STATE, how: BrokenGetter::Silent });
    let command = finish(&mut world, &running);
    assert_eq!((command.outcome, command.reached_goal), (Some(Outcome::Unknown), None));
    assert!(command.detail.unwrap().contains("is unknown and not HOLDING"));
}

#[test]
fn updates_are_slowed_down_on_a_link_with_long_round_trips() {
    let mut world = world();
    assert_eq!(world.watches.info.borrow().update_period_ms, 10);
    world.longest_delay = Duration::from_millis(700);
    world.advance(Duration::from_secs(30));
    let slowed_ms = world.watches.info.borrow().update_period_ms;
    assert!(slowed_ms >= 80, "{slowed_ms}");
    world.longest_delay = Duration::from_millis(3);
    world.advance(Duration::from_secs(30));
    assert_eq!(world.watches.info.borrow().update_period_ms, slowed_ms, "until the next connection");
    world.device.apply(world.now, Change::CutConnection);
    world.advance(Duration::from_secs(3));
    assert_eq!(world.watches.info.borrow().update_period_ms, 10);
}

#[test]
fn single_long_round_trip_slows_nothing_down() {
    let mut world = homed();
    for _ in 0..5 {
        world.stall_requests(Duration::from_millis(900));
        world.advance(Duration::from_secs(10));
    }
    assert_eq!(world.watches.info.borrow().update_period_ms, 10);
}
