//! State besides leases that survives a gateway restart.

use std::time::Duration;

use model::{Detail, Outcome, SettingChange, SettingsEvent};
use sim::Change;
use wsg::{self, Force, id};

use super::steps::*;
use crate::seeds::world::World;

#[test]
fn latch_epochs_grow_across_restarts() {
    let mut world = homed();
    let mut before = 0;
    for _ in 0..3 {
        let id = fast_stop(&mut world);
        let epoch = latch(&world).epoch;
        assert!(epoch > before, "{epoch} after {before}");
        world.advance(Duration::from_millis(200));
        acknowledge(&mut world, id);
        world.advance(Duration::from_millis(200));
        assert_eq!(state(&world).fast_stop, Some(false));
        world.restart();
        world.advance(Duration::from_secs(1));
        // The restart closed the connection without an announcement.
        let seen = latch(&world);
        assert!(seen.epoch > epoch, "{} after {epoch}", seen.epoch);
        before = seen.epoch;
        acknowledge(&mut world, seen.fast_stop_id);
        world.advance(Duration::from_millis(200));
    }
}

fn force_limits_journaled(world: &World) -> Vec<f32> {
    let forces = world.journal.events.iter().filter_map(|detail| match detail {
        Detail::Settings(SettingsEvent { setting: SettingChange::ForceLimit { force_n }, .. }) => Some(*force_n),
        _ => None,
    });
    forces.collect()
}

#[test]
fn leaving_overdrive_reduces_the_restored_force_limit() {
    let mut world = homed();
    let force = wsg::Command::SetForceLimit(Force::new(100.0).unwrap());
    let overdrive = |on| wsg::Command::OverdriveMode { on };
    for command in [overdrive(true), force, overdrive(false), overdrive(true)] {
        drop(exchange(&mut world, command));
        world.advance(Duration::from_millis(200));
    }
    assert_eq!(force_limits_journaled(&world), [100.0, 80.0], "as set, then as the device reduced it");
    let from = mark(&world);
    world.device.apply(world.now, Change::CutConnection);
    world.advance(Duration::from_secs(5));
    world.restart();
    world.advance(Duration::from_secs(1));
    assert!(!received(&world, from).contains(&id::SET_FORCE_LIMIT));
    assert!((world.device.snapshot().force_limit_n - 80.0).abs() < 0.1);
}

#[test]
fn force_limit_of_a_grip_is_read_back() {
    let mut world = homed();
    let from = mark(&world);
    assert_eq!(run(&mut world, grip(Some(30.0))).outcome, Some(Outcome::PartHeld));
    assert_eq!(received(&world, from), [id::SET_FORCE_LIMIT, id::GRIP, id::GET_FORCE_LIMIT]);
    assert_eq!(force_limits_journaled(&world), [30.0]);
}
