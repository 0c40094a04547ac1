//! Bounded queues: an overload error names the limit. Other limits are tested next to their owners: the actor queue at
//! its handle, commands and request ids in their registry, connections and sockets at their interfaces, records at the
//! journal.

use std::time::Duration;

use gripper::handle::ActorRequest;
use gripper::{Failure, Rejection};
use model::Action;
use sim::Change;
use wsg::session::{MAX_WAITING, MAX_WAITING_PER_ID};
use wsg::{self, LoopData, id};

use super::steps::*;

fn overloaded(limit: usize) -> Rejection {
    Failure::Overloaded { limit }.into()
}

/// `bounded`: every queue, buffer and count has a named limit.
#[test]
fn bounded() {
    let mut world = homed();
    world.device.apply(world.now, Change::Silent { on: true });
    let from = mark(&world);
    // One request is in flight, and `MAX_WAITING_PER_ID` more wait for their turn.
    let ask = || wsg::Command::Loop(LoopData::new(vec![1]).unwrap());
    let mut asked: Vec<_> = (0..=MAX_WAITING_PER_ID).map(|_| exchange(&mut world, ask())).collect();
    assert!(asked.iter_mut().all(|asked| asked.try_recv().is_err()), "no request is answered yet");
    assert_eq!(exchange(&mut world, ask()).try_recv().unwrap(), Err(overloaded(MAX_WAITING_PER_ID)));
    // Stops have a lane of their own.
    let stop = |world: &mut _, n: usize| submit(world, Action::Stop, Some(&format!("stop {n}")));
    let stops: Vec<_> = (0..=MAX_WAITING).map(|n| stop(&mut world, n)).collect();
    let newest = stops.last().unwrap().as_ref().unwrap().id();
    assert!(stops.iter().all(Result::is_ok));
    // Further Stops join the newest one in the queue instead of failing.
    let joined = stop(&mut world, stops.len()).unwrap();
    assert_eq!((joined.id(), joined.now().replayed), (newest, true));
    // Any number of FAST STOPs is accepted.
    for _ in 0..1000 {
        fast_stop(&mut world);
    }
    world.advance(Duration::from_millis(20));
    assert_eq!(received(&world, from).last(), Some(&id::FAST_STOP));
}

#[test]
fn stop_is_sent_under_a_flood_of_stops() {
    let mut world = homed();
    let running = start(&mut world, move_to(5.0, 5.0));
    world.advance(Duration::from_millis(200));
    world.device.apply(world.now, Change::Silent { on: true });
    let from = mark(&world);
    for _ in 0..10 * MAX_WAITING {
        // A cancel makes the gateway send its own Stop, which takes no slot from client Stops.
        drop(request(&mut world, |answer| ActorRequest::Cancel { id: running.id(), client: client(), answer }));
    }
    for n in 0..10 * MAX_WAITING {
        assert!(submit(&mut world, Action::Stop, Some(&format!("stop {n}"))).is_ok(), "Stop {n}");
    }
    world.advance(Duration::from_secs(5));
    assert!(received(&world, from).contains(&id::STOP));
}

#[test]
fn waiting_reads_are_bounded() {
    let mut world = homed();
    world.device.apply(world.now, Change::Silent { on: true });
    let mut waiting = Vec::new();
    let limit = loop {
        let mut asked = exchange(&mut world, wsg::Command::GetStatistics { reset: false });
        match asked.try_recv() {
            Ok(Err(Rejection::Failure(Failure::Overloaded { limit }))) => break limit,
            Ok(other) => panic!("{other:?}"),
            Err(_) => waiting.push(asked),
        }
    };
    assert_eq!(waiting.len(), limit, "the error names the limit");
}
