//! What waits is bounded, and who comes too much is told by which limit. Other limits are filled where they are: of the
//! queue to the actor at its handle, of commands and request ids at their book, of connections and sockets at their doors,
//! of records at the journal.

use std::time::Duration;

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
    assert!(stops.iter().all(Result::is_ok));
    assert_eq!(stop(&mut world, stops.len()).unwrap_err(), overloaded(MAX_WAITING));
    // And nothing is in the way of a FAST STOP, however many come.
    for _ in 0..1000 {
        fast_stop(&mut world);
    }
    world.advance(Duration::from_millis(20));
    assert_eq!(received(&world, from).last(), Some(&id::FAST_STOP));
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
