//! Conformance suite, run over every transport against the simulated device behind a real socket, pty or bus.

pub mod rig;

use std::future::Future;
use std::time::Duration;

use tokio::time::sleep;
use wsg_gateway::gripper::{DeviceRefusal, Now, Rejection};
use wsg_gateway::model::{Action, FastStopId, Link, Motion, Outcome, Reason};
use wsg_gateway::sim::Change;
use wsg_gateway::wsg::{
    Acceleration, Command, CustomCommand, Data, DeviceTag, Finger, Force, LoopData, SoftLimits, Speed, Status,
    SystemState, Updates, Width, id,
};

use rig::{Rig, SOON, client, has, home, move_to};

/// Default of `$run` in [`conformance!`].
pub async fn once<T: Future<Output = ()>>(test: impl Fn() -> T) {
    test().await;
}

/// Expands to the suite for one transport. `$url` is an expression for the URL of a new simulated device, and `$run`
/// runs one test.
#[macro_export]
macro_rules! conformance {
    ($transport:ident, $url:expr) => {
        $crate::conformance!($transport, $url, run by $crate::conformance::once);
    };
    ($transport:ident, $url:expr, run by $run:path) => {
        $crate::conformance!($transport, $url, $run,
            every_command automatic_updates fast_stop_during_a_motion reboot_during_a_motion silence_and_recovery
            pulled_wire_and_recovery orderly_end);
    };
    ($transport:ident, $url:expr, $run:path, $($test:ident)*) => {
        mod $transport {
            $(
                #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
                async fn $test() {
                    $run(async || $crate::conformance::$test(&$url).await).await;
                }
            )*
        }
    };
}

/// Commands without motion, and their expected results.
fn exchanges() -> Vec<(Command, Data)> {
    let width = |mm| Width::new(mm).unwrap();
    let limits = SoftLimits::new(width(5.0), width(100.0)).unwrap();
    let acceleration = Acceleration::new(1500.0).unwrap();
    let force = Force::new(35.0).unwrap();
    let tag = DeviceTag::new(b"cell 7").unwrap();
    let all: Vec<u8> = (0..=255).collect();
    let script = CustomCommand::new(0xB0, all[..100].to_vec()).unwrap();
    vec![
        (Command::Loop(LoopData::new(all.clone()).unwrap()), Data::Loop(all.clone())),
        (Command::Loop(LoopData::new(vec![0xAA; 64]).unwrap()), Data::Loop(vec![0xAA; 64])),
        (Command::SetAcceleration(acceleration), Data::Acceleration(acceleration)),
        (Command::GetAcceleration, Data::Acceleration(acceleration)),
        (Command::SetForceLimit(force), Data::ForceLimit(force)),
        (Command::GetForceLimit, Data::ForceLimit(force)),
        (Command::SetSoftLimits(limits), Data::SoftLimits(limits)),
        (Command::GetSoftLimits, Data::SoftLimits(limits)),
        (Command::ClearSoftLimits, Data::None),
        (Command::TareForceSensor, Data::None),
        (Command::SetDeviceTag(tag.clone()), Data::DeviceTag(tag.clone())),
        (Command::GetDeviceTag, Data::DeviceTag(tag)),
        (Command::Custom(script), Data::Custom(all[..100].to_vec())),
    ]
}

/// Commands without motion whose result depends on the device.
fn getters() -> Vec<Command> {
    let mut getters = vec![
        Command::GetSystemState(Updates::Off),
        Command::GetGripperState(Updates::Off),
        Command::GetWidth(Updates::Off),
        Command::GetSpeed(Updates::Off),
        Command::GetForce(Updates::Off),
        Command::GetStatistics { reset: false },
        Command::GetTemperature,
        Command::GetSystemInfo,
        Command::GetSystemLimits,
        Command::OverdriveMode { on: true },
        Command::OverdriveMode { on: false },
    ];
    for finger in [Finger::One, Finger::Two] {
        getters.extend([Command::GetFingerInfo(finger), Command::GetFingerFlags(finger)]);
    }
    let finger = Finger::Two;
    getters.extend([Command::FingerPower { finger, on: true }, Command::FingerPower { finger, on: false }]);
    getters.push(Command::GetFingerData(Finger::One));
    getters
}

/// Every command in the manuals and one script command, each at least once; two-step commands run to their results.
pub async fn every_command(url: &str) {
    let rig = Rig::homed(url).await;
    for (command, expected) in exchanges() {
        let name = format!("{command:?}");
        let returned = rig.exchange(command).await.unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(returned, expected, "{name}");
    }
    for command in getters() {
        let name = format!("{command:?}");
        rig.exchange(command).await.unwrap_or_else(|error| panic!("{name}: {error}"));
    }
    let (width, speed) = (Width::new(20.0).unwrap(), Speed::new(100.0).unwrap());
    assert_eq!(rig.run(move_to(30.0, 200.0)).await.outcome, Some(Outcome::Success));
    let grip = Motion::Grip {
        width,
        speed,
        force: Some(Force::new(20.0).unwrap()),
        part_id: None,
        recipe: None,
        is_reference: false,
    };
    assert_eq!(rig.run(grip).await.outcome, Some(Outcome::PartHeld));
    let release = Motion::Release { width: Width::new(40.0).unwrap(), speed };
    assert_eq!(rig.run(release).await.outcome, Some(Outcome::Success));
    let mut stop = rig.submit(Action::Stop).await.unwrap();
    assert_eq!(stop.wait(SOON).await.outcome, Some(Outcome::Success));
    let stopped = rig.handle.fast_stop(FastStopId::generate(), client(), Reason::truncated("test")).await;
    rig.until("stopped", SOON, |state| state.latch.as_ref().is_some_and(|latch| latch.fast_stop_confirmed)).await;
    rig.handle.acknowledge(stopped.id, client()).await.unwrap();
    // A force finger is always powered, and a finger without electronics has no data.
    for command in [Command::FingerPower { finger: Finger::One, on: true }, Command::GetFingerData(Finger::Two)] {
        let refusal = rig.exchange(command).await.unwrap_err();
        let status = if let Rejection::Device(DeviceRefusal { status, .. }) = refusal { Some(status) } else { None };
        assert_eq!(status, Some(Status::E_NOT_AVAILABLE), "{refusal:?}");
    }

    let received = rig.received().await;
    let missing = (0..=u8::MAX).filter(|id| {
        let asked = *id != id::DISCONNECT_ANNOUNCEMENT && id::describe(*id).is_some();
        asked && !received.contains(id)
    });
    assert_eq!(missing.collect::<Vec<_>>(), Vec::<u8>::new(), "the device has received these ids: {received:02X?}");
    rig.drain().await;
}

/// Automatic updates arrive and take at most half of the line; readers cost the device nothing.
pub async fn automatic_updates(url: &str) {
    let rig = Rig::homed(url).await;
    let mut slow = rig.start(move_to(20.0, 40.0)).await;
    let received = rig.switch.snapshot().await.unwrap().received_frames;
    let mut states = rig.handle.states();
    let mut widths = Vec::new();
    // The motion ends with the last change, or directly after it.
    let ended = loop {
        tokio::select! {
            biased;
            ended = slow.ended() => break ended,
            changed = tokio::time::timeout(SOON, states.changed()) => changed.expect("values arrive").unwrap(),
        }
        widths.extend(rig.handle.state().values.width_mm(Now::read().instant));
    };
    assert_eq!(ended.outcome, Some(Outcome::Success));
    widths.dedup();
    // The motion takes two seconds: at the slowest update period of these lines, a hundred values and more.
    assert!(widths.len() > 40, "{} widths arrived", widths.len());
    assert!(widths.windows(2).all(|pair| pair[0] >= pair[1] - 0.1), "in order: {widths:?}");
    let asked = rig.switch.snapshot().await.unwrap().received_frames - received;
    assert!(asked < 20, "the device was asked {asked} times");
    rig.drain().await;
}

/// A FAST STOP is confirmed at once, aborts the motion with its id, and blocks motion until it is acknowledged.
pub async fn fast_stop_during_a_motion(url: &str) {
    let rig = Rig::homed(url).await;
    let mut rounds = 0;
    let (mut running, stopped) = loop {
        let running = rig.start(move_to(10.0, 20.0)).await;
        rig.until("moving", SOON, |state| has(state, SystemState::MOVING) == Some(true)).await;
        // Another command still gets an answer.
        rig.exchange(Command::GetAcceleration).await.unwrap();
        let stopped = rig.handle.fast_stop(FastStopId::generate(), client(), Reason::truncated("light curtain")).await;
        if stopped.confirmed {
            break (running, stopped);
        }
        // A busy machine can exceed the limit.
        rounds += 1;
        assert!(rounds < 3, "not confirmed within 250 ms");
        rig.until("confirmed", SOON, |state| state.latch.as_ref().is_some_and(|latch| latch.fast_stop_confirmed)).await;
        rig.handle.acknowledge(stopped.id, client()).await.unwrap();
    };
    assert!(rig.switch.snapshot().await.unwrap().fast_stop);
    let command = running.wait(SOON).await;
    assert_eq!((command.outcome, command.fast_stop_id), (Some(Outcome::Aborted), Some(stopped.id)));
    assert!(rig.submit(Action::Motion(home())).await.is_err());
    rig.handle.acknowledge(stopped.id, client()).await.unwrap();
    assert_eq!(rig.run(move_to(50.0, 200.0)).await.outcome, Some(Outcome::Success));
    rig.drain().await;
}

/// The device restarts during a motion: the outcome is unknown, nothing moves by itself, and settings are restored.
pub async fn reboot_during_a_motion(url: &str) {
    let rig = Rig::homed(url).await;
    rig.exchange(Command::SetAcceleration(Acceleration::new(700.0).unwrap())).await.unwrap();
    let mut running = rig.start(move_to(10.0, 10.0)).await;
    rig.until("moving", SOON, |state| has(state, SystemState::MOVING) == Some(true)).await;
    rig.apply(Change::Reboot { ready_after_ms: 300, mid_frame: false }).await;
    rig.until("not referenced", SOON, |state| has(state, SystemState::REFERENCED) == Some(false)).await;
    rig.until("connected", SOON, |state| state.link == Link::Connected && state.command.is_none()).await;
    assert_eq!(running.wait(SOON).await.outcome, Some(Outcome::Unknown));
    let device = rig.switch.snapshot().await.unwrap();
    assert!((device.acceleration_mm_s2 - 700.0).abs() < 0.1, "{}", device.acceleration_mm_s2);
    assert!(!device.referenced && !device.moving);
    assert_eq!(rig.run(home()).await.outcome, Some(Outcome::Success));
    rig.drain().await;
}

/// A silent device is noticed within 1.5 s; motions are refused until it answers again.
pub async fn silence_and_recovery(url: &str) {
    let rig = Rig::homed(url).await;
    rig.apply(Change::Silent { on: true }).await;
    // A competing timer instead of a clock reading: an emulated machine can stand still for a second.
    tokio::select! {
        biased;
        _ = rig.link(Link::Unresponsive, SOON) => {}
        () = sleep(Duration::from_millis(1900)) => panic!("not noticed"),
    }
    assert!(rig.submit(Action::Motion(home())).await.is_err());
    rig.apply(Change::Silent { on: false }).await;
    rig.link(Link::Connected, SOON).await;
    assert_eq!(rig.run(move_to(50.0, 200.0)).await.outcome, Some(Outcome::Success));
    rig.drain().await;
}

pub async fn pulled_wire_and_recovery(url: &str) {
    let rig = Rig::homed(url).await;
    rig.apply(Change::RefuseConnections { on: true }).await;
    rig.apply(Change::CutConnection).await;
    rig.until("lost", SOON, |state| state.link != Link::Connected).await;
    sleep(Duration::from_millis(300)).await;
    assert_ne!(rig.handle.state().link, Link::Connected);
    rig.apply(Change::RefuseConnections { on: false }).await;
    rig.link(Link::Connected, SOON).await;
    if let Some(latch) = rig.handle.state().latch.clone() {
        assert!(rig.is_tcp, "only a TCP disconnect is a FAST STOP");
        rig.handle.acknowledge(latch.fast_stop_id, client()).await.unwrap();
    }
    assert_eq!(rig.run(move_to(50.0, 200.0)).await.outcome, Some(Outcome::Success));
    rig.drain().await;
}

/// A cut without a close is noticed on connectionless links too; a request sent into it stays lost.
pub async fn cut_without_a_connection(url: &str) {
    let rig = Rig::homed(url).await;
    rig.apply(Change::CutConnection).await;
    let lost = Acceleration::new(700.0).unwrap();
    assert!(rig.exchange(Command::SetAcceleration(lost)).await.is_err(), "nothing is heard");
    rig.link(Link::Unresponsive, SOON).await;
    rig.link(Link::Connected, SOON).await;
    assert_eq!(rig.run(move_to(50.0, 200.0)).await.outcome, Some(Outcome::Success));
    assert!(!rig.received().await.contains(&id::SET_ACCELERATION), "delivered late");
    rig.drain().await;
}

/// Draining during a motion: the motion is stopped in time, and the disconnect is announced on TCP.
pub async fn orderly_end(url: &str) {
    let rig = Rig::homed(url).await;
    let mut running = rig.start(move_to(10.0, 5.0)).await;
    rig.until("moving", SOON, |state| has(state, SystemState::MOVING) == Some(true)).await;
    let (switch, is_tcp) = (rig.switch.clone(), rig.is_tcp);
    rig.drain().await;
    assert_eq!(running.wait(SOON).await.outcome, Some(Outcome::Aborted));
    let device = switch.snapshot().await.unwrap();
    assert!(!device.moving && !device.fast_stop);
    let received: Vec<_> = switch.received().await.unwrap().iter().map(|frame| frame.id).collect();
    assert!(received.contains(&id::STOP));
    assert_eq!(received.contains(&id::DISCONNECT_ANNOUNCEMENT), is_tcp, "{received:02X?}");
    if !is_tcp {
        // The device sends no updates to a gateway that is gone. A second Stop can follow while the newest flags still
        // show the motion.
        let getters = [0x45, 0x44, 0x43, 0x41, 0x40];
        let last = received.strip_suffix(&[id::STOP]).unwrap_or(&received);
        assert!(last.ends_with(&getters), "{received:02X?}");
    }
}
