//! Faults of the device without a FAST STOP.

use std::time::Duration;

use gripper::handle::ActorRequest;
use gripper::{Conflict, Invalid, Rejection};
use model::{Detail, LeaseToken, TakeLease};
use sim::Change;
use tokio::sync::oneshot;
use wsg::{self, LoopData, id};

use super::steps::*;
use crate::seeds::world::World;

fn acknowledge_fault(world: &mut World, lease: Option<LeaseToken>) -> oneshot::Receiver<Result<(), Rejection>> {
    request(world, |answer| ActorRequest::AcknowledgeFault { client: client(), lease, answer })
}

fn is_missing_id(rejection: &Rejection) -> bool {
    matches!(rejection, Rejection::Invalid(Invalid::Malformed { field: "fast_stop_id", .. }))
}

#[test]
fn fault_without_a_latch_is_acknowledged_under_the_lease() {
    let mut world = homed();
    let from = mark(&world);
    assert!(is_missing_id(&acknowledge_fault(&mut world, None).try_recv().unwrap().unwrap_err()), "no fault");
    world.device.apply(world.now, Change::FingerOverCurrent { finger: 1, on: true });
    world.advance(Duration::from_millis(100));
    let take = TakeLease::by(client());
    let token = LeaseToken::from("mine");
    drop(request(&mut world, |answer| ActorRequest::TakeLease { take, token: token.clone(), answer }));
    let refused = acknowledge_fault(&mut world, None).try_recv().unwrap().unwrap_err();
    assert!(matches!(refused, Rejection::Conflict(Conflict::LeaseTokenMissing { .. })), "{refused:?}");
    assert_eq!(received(&world, from), [0; 0]);
    world.invariants.acknowledge_taken();
    let mut answered = acknowledge_fault(&mut world, Some(token));
    world.advance(Duration::from_millis(100));
    assert_eq!(answered.try_recv().unwrap(), Ok(()));
    assert_eq!(received(&world, from), [id::ACKNOWLEDGE_FAST_STOP]);
    let is_record = |detail: &Detail| match detail {
        Detail::Acknowledge(event) => event.fast_stop_id.is_none() && event.cleared,
        _ => false,
    };
    assert!(world.journal.events.iter().any(is_record));
}

#[test]
fn latch_is_acknowledged_by_its_id_only() {
    let mut world = homed();
    world.device.apply(world.now, Change::Overheat { temperature_c: 120.0 });
    world.advance(Duration::from_millis(200));
    let from = mark(&world);
    assert!(is_missing_id(&acknowledge_fault(&mut world, None).try_recv().unwrap().unwrap_err()));
    assert_eq!(received(&world, from), [0; 0]);
}

#[test]
fn fast_stop_withdraws_a_waiting_acknowledgement() {
    let mut world = World::calm(device(), Some(960));
    world.device.apply(world.now, Change::FingerOverCurrent { finger: 1, on: true });
    world.advance(Duration::from_secs(1));
    let from = mark(&world);
    // A long frame keeps the line busy.
    drop(exchange(&mut world, wsg::Command::Loop(LoopData::new(vec![0; 60]).unwrap())));
    let mut answered = acknowledge_fault(&mut world, None);
    let id = fast_stop(&mut world);
    assert_eq!(answered.try_recv().unwrap(), Err(Conflict::FastStop { id }.into()));
    world.advance(Duration::from_secs(1));
    assert!(!received(&world, from).contains(&id::ACKNOWLEDGE_FAST_STOP));
    assert!(latch(&world).fast_stop_confirmed);
}
