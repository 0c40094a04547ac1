//! Streams that steer the fingers: silence stops them, and a Stop of anybody holds them off.

use std::time::Duration;

use gripper::{Rejection, handle::Ticket};
use model::error::Failure;
use model::{Action, Motion};
use sim::Change;
use wsg::{CustomCommand, id};

use super::steps::*;
use crate::seeds::world::{STREAM_ID, World};

/// Period of a stream at 30 Hz.
const EVERY: Duration = Duration::from_millis(33);

fn target(world: &mut World) -> Result<Ticket, Rejection> {
    let target = CustomCommand::new(STREAM_ID, vec![1]).unwrap();
    submit(world, Action::Motion(Motion::Custom(target)), None)
}

/// Moves the fingers with a script, whose targets come for this time.
fn steer(world: &mut World, time: Duration) {
    world.device.apply(world.now, Change::MoveBySomebody { width_mm: 10.0, speed_mm_s: 5.0 });
    let until = world.now + time;
    while world.now < until {
        target(world).unwrap();
        world.advance(EVERY);
    }
}

#[test]
fn silent_stream_is_stopped() {
    let mut world = homed();
    let from = mark(&world);
    steer(&mut world, Duration::from_secs(3));
    assert!(!received(&world, from).contains(&id::STOP), "a stream that goes on is not stopped");
    let from = mark(&world);
    world.advance(Duration::from_millis(520));
    assert_eq!(received(&world, from), [id::STOP]);
    world.advance(Duration::from_secs(3));
    assert_eq!(received(&world, from), [id::STOP], "one Stop is enough");
}

#[test]
fn no_target_follows_a_stop() {
    let mut world = homed();
    steer(&mut world, Duration::from_secs(1));
    submit(&mut world, Action::Stop, None).unwrap();
    let from = mark(&world);
    for _ in 0..100 {
        world.advance(EVERY);
        let refused = target(&mut world).unwrap_err();
        assert!(matches!(refused, Rejection::Failure(Failure::StoppedFirst { .. })), "{refused:?}");
    }
    assert!(!received(&world, from).contains(&STREAM_ID));
    world.advance(Duration::from_millis(500));
    target(&mut world).expect("the stream begins anew after a pause");
}
