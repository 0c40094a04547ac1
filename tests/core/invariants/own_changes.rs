//! Queries that follow a change: their values show its effect.

use std::iter::once;
use std::time::Duration;

use gripper::Rejection;
use model::{Action, UpdateMode};
use sim::{DeviceConfig, Interface};
use tokio::sync::oneshot;
use wsg::{Command, Data, GripperState, SoftLimits, SystemState, Updates, Width, id};

use super::steps::*;
use crate::seeds::world::World;

const FLAGS: Command = Command::GetSystemState(Updates::Off);
const STATE: Command = Command::GetGripperState(Updates::Off);

/// Far shorter than a byte on any line, so that a query follows a reply at once.
const TICK: Duration = Duration::from_micros(100);

/// Worlds with this device, each homed: on a fast and on a slow line, and with a device that sends only changes.
fn homed_worlds(device: &DeviceConfig) -> Vec<World> {
    let mut fast = World::calm(device.clone(), None);
    let mut slow = World::calm_on(Interface::Serial, device.clone(), Some(960));
    let mut changes = World::calm_on(Interface::Can, device.clone(), None);
    changes.config.rules.updates.mode = UpdateMode::Changes;
    changes.restart();
    changes.advance(Duration::from_secs(2));
    for world in [&mut fast, &mut slow, &mut changes] {
        run(world, home());
    }
    once(fast).chain(once(slow)).chain(once(changes)).collect()
}

fn firmwares() -> [DeviceConfig; 2] {
    [device(), device().fw2()]
}

fn until(world: &mut World, is_over: impl Fn(&World) -> bool) {
    for _ in 0..20_000 {
        if is_over(world) {
            return;
        }
        world.advance(TICK);
    }
    panic!("it does not happen");
}

fn answer(world: &mut World, mut answered: oneshot::Receiver<Result<Data, Rejection>>) -> Data {
    for _ in 0..20_000 {
        if let Ok(answer) = answered.try_recv() {
            return answer.unwrap();
        }
        world.advance(TICK);
    }
    panic!("no answer");
}

fn ask(world: &mut World, command: Command) -> Data {
    let answered = exchange(world, command);
    answer(world, answered)
}

fn flags(world: &mut World) -> SystemState {
    let Data::SystemState(flags) = ask(world, FLAGS) else { panic!("no flags") };
    flags
}

#[test]
fn stop_shows_in_the_flags() {
    for device in firmwares() {
        for mut world in homed_worlds(&device) {
            start(&mut world, move_to(10.0, 20.0));
            world.advance(Duration::from_millis(500));
            let stop = submit(&mut world, Action::Stop, None).unwrap();
            until(&mut world, |_| stop.now().outcome.is_some());
            let flags = flags(&mut world);
            assert!(flags.contains(SystemState::AXIS_STOPPED), "{flags:?}");
            assert!(!flags.contains(SystemState::MOVING), "{flags:?}");
        }
    }
}

#[test]
fn tare_shows_in_the_force() {
    let sensor = DeviceConfig { force_sensor: true, force_sensor_offset_n: -3.0, ..device() };
    for mut world in homed_worlds(&sensor) {
        assert_eq!(values(&world).force_n, Some(3.0));
        ask(&mut world, Command::TareForceSensor);
        let Data::Force(force) = ask(&mut world, Command::GetForce(Updates::Off)) else { panic!("no force") };
        assert!(force.n().abs() < 0.01, "{force:?}");
    }
}

#[test]
fn soft_limits_show_in_the_flags() {
    for device in firmwares() {
        for mut world in homed_worlds(&device) {
            let limits = SoftLimits::new(Width::new(20.0).unwrap(), Width::new(50.0).unwrap()).unwrap();
            ask(&mut world, Command::SetSoftLimits(limits));
            assert!(flags(&mut world).contains(SystemState::SOFT_LIMIT_PLUS));
            ask(&mut world, Command::ClearSoftLimits);
            assert!(!flags(&mut world).contains(SystemState::SOFT_LIMIT_PLUS));
        }
    }
}

#[test]
fn fast_stop_shows_in_the_state() {
    for mut world in homed_worlds(&device()) {
        fast_stop(&mut world);
        until(&mut world, |world| latch(world).fast_stop_confirmed);
        assert_eq!(ask(&mut world, STATE), Data::GripperState(GripperState::Error));
        assert!(flags(&mut world).contains(SystemState::FAST_STOP));
    }
}

#[test]
fn begun_motion_shows_in_state_and_flags() {
    for device in firmwares() {
        for mut world in homed_worlds(&device) {
            let grip = start(&mut world, grip(None));
            until(&mut world, |_| grip.now().accepted);
            assert_eq!(ask(&mut world, STATE), Data::GripperState(GripperState::Grasping));
            assert!(flags(&mut world).contains(SystemState::MOVING));
            finish(&mut world, &grip);
            assert_eq!(ask(&mut world, STATE), Data::GripperState(GripperState::Holding));
        }
    }
}

#[test]
fn many_queries_after_a_change_ask_the_device_once() {
    let mut world = World::calm(DeviceConfig { force_sensor: true, ..device() }, None);
    run(&mut world, home());
    ask(&mut world, Command::TareForceSensor);
    let from = mark(&world);
    let asked: Vec<_> = (0..100).map(|_| exchange(&mut world, FLAGS)).collect();
    for answered in asked {
        answer(&mut world, answered);
    }
    ask(&mut world, FLAGS);
    let queries = world.device.received()[from..].iter().filter(|frame| frame.id == id::GET_SYSTEM_STATE);
    assert_eq!(queries.count(), 1);
    assert_eq!(world.device.snapshot().updates.len(), 5, "automatic updates stay on");
}
