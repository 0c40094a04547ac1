//! What comes right behind another: the next motion, and what a client repeats.

use std::time::Duration;

use wsg_gateway::gripper::Conflict;
use wsg_gateway::gripper::model::{Action, Outcome, Phase};
use wsg_gateway::wsg::id;

use super::steps::*;
use crate::seeds::world::World;

#[test]
fn a_motion_whose_end_is_known_is_not_in_the_way_of_the_next() {
    // Updates are so slow here that its end is told 50 ms later.
    let mut world = World::calm(device(), Some(960));
    run(&mut world, home());
    let from = mark(&world);
    let first = start(&mut world, move_to(80.0, 100.0));
    let next = loop {
        world.advance(Duration::from_millis(1));
        let before = first.now();
        assert_eq!(before.phase, Phase::Running, "the next one is taken before that");
        match submit(&mut world, Action::Motion(move_to(60.0, 100.0)), None) {
            Ok(next) => break next,
            Err(rejection) => assert_eq!(rejection, Conflict::AlreadyRunning { id: before.id }.into()),
        }
    };
    let taken = world.now;
    assert_eq!((first.now().phase, first.now().outcome), (Phase::Done, Some(Outcome::Success)));
    assert_eq!(finish(&mut world, &next).outcome, Some(Outcome::Success));
    let motions: Vec<_> = world.device.received()[from..].iter().filter(|frame| frame.id == id::PRE_POSITION).collect();
    assert_eq!(motions.len(), 2);
    assert!(motions[1].at >= taken + Duration::from_millis(45), "it waits for its pause");
}
