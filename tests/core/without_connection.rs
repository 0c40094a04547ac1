//! Links without connections (UDP, RS-232, CAN): nothing reports a lost peer, so silence and lost references have to.
//! The tests run on a virtual clock and check the frames that the device received.

use std::time::Duration;

use gripper::Conflict;
use gripper::handle::ActorRequest;
use model::{Link, Outcome};
use sim::{Change, Interface};
use wsg::{self, Acceleration, SystemState, id};

use super::invariants::steps::{
    device, exchange, fast_stop, finish, home, latch, mark, move_to, received, refused, request, run, start, state,
    values,
};
use super::seeds::world::World;

fn homed() -> World {
    let mut world = World::calm_on(Interface::Serial, device(), Some(11_520));
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    world
}

fn reboot(ready_after_ms: u32) -> Change {
    Change::Reboot { ready_after_ms, mid_frame: false }
}

#[test]
fn lost_reference_reveals_a_restart_and_settings_are_restored() {
    let mut world = homed();
    let acceleration = Acceleration::new(500.0).unwrap();
    drop(exchange(&mut world, wsg::Command::SetAcceleration(acceleration)));
    world.advance(Duration::from_millis(200));
    let running = start(&mut world, move_to(10.0, 10.0));
    world.advance(Duration::from_millis(200));
    let from = mark(&world);
    world.device.apply(world.now, reboot(300));
    // The gateway renews the automatic updates within a second, and they show the restart.
    world.advance(Duration::from_secs(3));
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Unknown));
    assert_eq!((state(&world).link, values(&world).referenced), (Link::Connected, Some(false)));
    assert!((world.device.snapshot().acceleration_mm_s2 - 500.0).abs() < 0.1);
    let received = received(&world, from);
    assert!(received.contains(&id::SET_ACCELERATION), "{received:02X?}");
    assert!(!received.iter().any(|&id| id::is_motion(id)), "{received:02X?}");
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
}

#[test]
fn lost_updates_reveal_a_restart_of_an_unreferenced_device() {
    let mut world = World::calm_on(Interface::Serial, device(), Some(11_520));
    let acceleration = Acceleration::new(500.0).unwrap();
    drop(exchange(&mut world, wsg::Command::SetAcceleration(acceleration)));
    world.advance(Duration::from_millis(200));
    let from = mark(&world);
    world.device.apply(world.now, reboot(300));
    world.advance(Duration::from_secs(3));
    assert_eq!((state(&world).link, values(&world).referenced), (Link::Connected, Some(false)));
    assert!((world.device.snapshot().acceleration_mm_s2 - 500.0).abs() < 0.1);
    assert!(received(&world, from).contains(&id::SET_ACCELERATION));
}

#[test]
fn restart_during_a_homing_ends_it_as_unknown_early() {
    let mut world = homed();
    let acceleration = Acceleration::new(500.0).unwrap();
    drop(exchange(&mut world, wsg::Command::SetAcceleration(acceleration)));
    world.advance(Duration::from_millis(200));
    let homing = start(&mut world, home());
    world.advance(Duration::from_millis(60));
    let from = mark(&world);
    world.device.apply(world.now, reboot(300));
    world.advance(Duration::from_secs(4));
    assert_eq!(homing.now().outcome, Some(Outcome::Unknown), "{}", world.tail());
    assert_eq!(state(&world).link, Link::Connected);
    assert!((world.device.snapshot().acceleration_mm_s2 - 500.0).abs() < 0.1);
    assert!(!received(&world, from).iter().any(|&id| id::is_motion(id)));
}

#[test]
fn motion_after_a_restart_waits_for_the_settings() {
    let mut world = homed();
    let acceleration = Acceleration::new(500.0).unwrap();
    drop(exchange(&mut world, wsg::Command::SetAcceleration(acceleration)));
    world.advance(Duration::from_millis(200));
    world.device.apply(world.now, reboot(200));
    world.advance(Duration::from_millis(900));
    // The gateway has not noticed the restart yet, and the homing hides the lost reference.
    let homing = start(&mut world, home());
    finish(&mut world, &homing);
    world.advance(Duration::from_secs(2));
    assert_eq!(state(&world).link, Link::Connected, "{}", world.tail());
    assert!((world.device.snapshot().acceleration_mm_s2 - 500.0).abs() < 0.1);
}

#[test]
fn long_reply_on_the_slowest_line_is_not_silence() {
    let mut world = World::calm_on(Interface::Serial, device(), Some(120));
    world.advance(Duration::from_secs(10));
    assert_eq!(state(&world).link, Link::Connected, "{}", world.tail());
    let data = wsg::LoopData::new(vec![0x55; 256]).unwrap();
    let mut echoed = exchange(&mut world, wsg::Command::Loop(data));
    for _ in 0..1000 {
        world.advance(Duration::from_millis(10));
        assert_eq!(state(&world).link, Link::Connected, "{}", world.tail());
    }
    assert!(matches!(echoed.try_recv(), Ok(Ok(wsg::Data::Loop(data))) if data.len() == 256));
}

#[test]
fn homing_is_not_taken_for_a_restart() {
    let mut world = homed();
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    let mut foreign = Vec::new();
    wsg::Command::Homing(wsg::HomingDirection::Default).encode(&mut foreign);
    let from = mark(&world);
    world.device.receive(world.now, &foreign);
    let mut lost_reference = false;
    for _ in 0..500 {
        world.advance(Duration::from_millis(10));
        lost_reference |= values(&world).referenced == Some(false);
        assert_eq!(state(&world).link, Link::Connected);
    }
    assert!(lost_reference);
    assert_eq!(received(&world, from), [id::HOMING]);
}

#[test]
fn silence_is_noticed_within_1500_ms_and_the_link_is_reopened() {
    let mut world = homed();
    world.device.apply(world.now, Change::HalfOpen { on: true });
    world.advance(Duration::from_millis(1450));
    assert_eq!(state(&world).link, Link::Connected);
    world.advance(Duration::from_millis(100));
    assert_eq!(state(&world).link, Link::Unresponsive);
    // The simulated device ends the fault when the link is reopened.
    world.advance(Duration::from_secs(6));
    assert!(world.log.iter().any(|line| line.contains("closing: nothing was heard")), "{}", world.tail());
    assert_eq!(state(&world).link, Link::Connected);
    assert!(state(&world).latch.is_none(), "without a connection to end, the device did not stop");
}

#[test]
fn orderly_end_is_a_stop_without_an_announcement() {
    let mut world = homed();
    let slow = start(&mut world, move_to(10.0, 5.0));
    world.advance(Duration::from_millis(500));
    let from = mark(&world);
    let mut drained = request(&mut world, |answer| ActorRequest::Drain { answer });
    assert_eq!(finish(&mut world, &slow).outcome, Some(Outcome::Aborted));
    world.advance(Duration::from_secs(2));
    assert_eq!(received(&world, from), [id::STOP]);
    assert!(!world.device.snapshot().moving);
    let now = world.clock();
    world.actor.drained(now);
    assert_eq!(drained.try_recv(), Ok(()));
}

#[test]
fn latch_survives_a_restart_without_a_disconnect() {
    let mut world = homed();
    let id = fast_stop(&mut world);
    world.advance(Duration::from_millis(200));
    world.device.apply(world.now, reboot(300));
    world.advance(Duration::from_secs(3));
    assert!(world.log.iter().any(|line| line.contains("closing: the device restarted")), "{}", world.tail());
    assert_eq!((state(&world).link, latch(&world).fast_stop_id), (Link::Connected, id));
    let is_stopped = world.device.snapshot().flags.contains(SystemState::FAST_STOP);
    assert!(is_stopped && latch(&world).fast_stop_confirmed, "the device had forgotten it");
    assert_eq!(refused(&mut world, home()), Conflict::FastStop { id }.into());
}
