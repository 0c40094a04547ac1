//! Orderly disconnects.

use std::time::Duration;

use gripper::Failure;
use gripper::handle::ActorRequest;
use model::Outcome;
use sim::{Change, FaultKind, Interface};
use wsg::id;

use super::steps::*;
use crate::seeds::world::World;

#[test]
fn announce_before_close() {
    let mut world = homed();
    let slow = start(&mut world, move_to(10.0, 5.0));
    world.advance(Duration::from_millis(500));
    let from = mark(&world);
    let mut drained = request(&mut world, |answer| ActorRequest::Drain { answer });
    assert_eq!(refused(&mut world, home()), Failure::Draining.into());
    let command = finish(&mut world, &slow);
    assert_eq!(command.outcome, Some(Outcome::Aborted), "drain_ms is over");
    world.advance(Duration::from_secs(2));
    assert_eq!(received(&world, from), [id::STOP, id::DISCONNECT_ANNOUNCEMENT]);
    assert_eq!(world.device.received().last().unwrap().id, id::DISCONNECT_ANNOUNCEMENT);
    assert!(!world.device.snapshot().fast_stop);
    let now = world.clock();
    world.actor.drained(now);
    assert_eq!(drained.try_recv(), Ok(()));
}

/// Returns a world whose gateway has begun to switch the updates off, and a mark before. Over TCP, nothing may follow the
/// announcement.
fn switching_off() -> (World, usize) {
    let mut world = World::calm_on(Interface::Udp, device(), None);
    run(&mut world, home());
    world.advance(Duration::from_secs(1));
    let from = mark(&world);
    drop(request(&mut world, |answer| ActorRequest::Drain { answer }));
    world.settle();
    (world, from)
}

#[test]
fn motion_while_updates_are_switched_off_is_stopped() {
    let (mut world, from) = switching_off();
    world.device.apply(world.now, Change::MoveBySomebody { width_mm: 30.0, speed_mm_s: 20.0 });
    world.advance(Duration::from_secs(1));
    assert_eq!(received(&world, from), [id::STOP]);
    assert!(!world.device.snapshot().moving);
}

#[test]
fn fast_stop_while_updates_are_switched_off_is_repeated() {
    let (mut world, from) = switching_off();
    world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::FAST_STOP), times: 1 });
    fast_stop(&mut world);
    world.advance(Duration::from_secs(1));
    assert!(received(&world, from).starts_with(&[id::FAST_STOP; 2]));
    assert!(world.device.snapshot().fast_stop);
}
