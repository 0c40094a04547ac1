//! Motions on a slow line, whose values arrive long after they were measured.

use std::time::Duration;

use model::{Detail, DeviceEvent, Link, Outcome};
use sim::Interface;

use super::steps::*;
use crate::seeds::world::World;

/// At 9600 baud, the values arrive every 140 ms.
fn homed_on_a_slow_line() -> World {
    let mut world = World::calm_on(Interface::Serial, device(), Some(960));
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    world
}

#[test]
fn result_has_the_width_at_rest() {
    let mut world = homed_on_a_slow_line();
    for goal_mm in [80.0, 61.0, 40.0, 71.0, 33.0] {
        let report = run(&mut world, move_to(goal_mm, 200.0));
        let width_mm = report.width_mm.unwrap();
        assert!((width_mm - goal_mm).abs() < 0.5, "{width_mm} mm at the end of a move to {goal_mm} mm");
    }
}

#[test]
fn stopped_homing_is_no_restart() {
    for after_ms in (20..300).step_by(20) {
        let mut world = homed_on_a_slow_line();
        start(&mut world, home());
        world.advance(Duration::from_millis(after_ms));
        fast_stop(&mut world);
        world.advance(Duration::from_secs(1));
        let restarts = |detail: &&Detail| matches!(detail, Detail::Device(DeviceEvent::Restarted));
        assert_eq!(world.journal.events.iter().filter(restarts).count(), 0, "{after_ms} ms");
        assert_eq!(state(&world).link, Link::Connected, "{after_ms} ms");
        assert!(latch(&world).fast_stop_confirmed, "{after_ms} ms");
    }
}
