//! What waits is bounded, and who comes too much is told by which limit. Other limits are filled where they are: of the
//! queue to the actor at its handle, of commands and request ids at their book, of connections and sockets at their doors,
//! of records at the journal.

use std::time::Duration;

use wsg_gateway::gripper::handle::Request;
use wsg_gateway::gripper::model::Action;
use wsg_gateway::gripper::{Failure, Rejection};
use wsg_gateway::sim::Change;
use wsg_gateway::wsg::session::MAX_WAITING;
use wsg_gateway::wsg::{self, LoopData, id};

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
    // One is on its way, and so many wait for their turn.
    let ask = || wsg::Command::Loop(LoopData::new(vec![1]).unwrap());
    let mut asked: Vec<_> = (0..=MAX_WAITING).map(|_| exchange(&mut world, ask())).collect();
    assert!(asked.iter_mut().all(|asked| asked.try_recv().is_err()), "none is answered");
    assert_eq!(exchange(&mut world, ask()).try_recv().unwrap(), Err(overloaded(MAX_WAITING)));
    // Stops have a lane of their own.
    let stop = |world: &mut _, n: usize| submit(world, Action::Stop, Some(&format!("stop {n}")));
    let stops: Vec<_> = (0..=MAX_WAITING).map(|n| stop(&mut world, n)).collect();
    let newest = stops.last().unwrap().as_ref().unwrap().id();
    assert!(stops.iter().all(Result::is_ok));
    // None is refused: further ones join the newest that waits.
    let joined = stop(&mut world, stops.len()).unwrap();
    assert_eq!((joined.id(), joined.now().replayed), (newest, true));
    // And nothing is in the way of a FAST STOP, however many come.
    for _ in 0..1000 {
        fast_stop(&mut world);
    }
    world.advance(Duration::from_millis(20));
    assert_eq!(received(&world, from).last(), Some(&id::FAST_STOP));
}

#[test]
fn stop_is_sent_however_many_wait() {
    let mut world = homed();
    let running = start(&mut world, move_to(5.0, 5.0));
    world.advance(Duration::from_millis(200));
    world.device.apply(world.now, Change::Silent { on: true });
    let from = mark(&world);
    for _ in 0..10 * MAX_WAITING {
        // The gateway's own Stop, which a cancel sends, leaves the lane to the clients'.
        drop(request(&mut world, |answer| Request::Cancel { id: running.id(), client: client(), answer }));
    }
    for n in 0..10 * MAX_WAITING {
        assert!(submit(&mut world, Action::Stop, Some(&format!("stop {n}"))).is_ok(), "Stop {n}");
    }
    world.advance(Duration::from_secs(5));
    assert!(received(&world, from).contains(&id::STOP));
}

#[test]
fn readers_that_wait_are_bounded() {
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
    assert_eq!(waiting.len(), limit, "as many as it says");
}
