//! Requests in quick succession: the next motion after one, and repeated requests and faults.

use std::time::Duration;

use gripper::Conflict;
use model::{Action, Detail, DeviceEvent, FastStopStep, Link, Outcome, Phase};
use sim::{Change, FaultKind};
use wsg::{SystemState, id};

use super::steps::*;
use crate::seeds::world::World;

#[test]
fn finished_motion_does_not_block_the_next() {
    // At this rate the update with the end of the motion is 50 ms late.
    let mut world = World::calm(device(), Some(960));
    run(&mut world, home());
    let from = mark(&world);
    let first = start(&mut world, move_to(80.0, 100.0));
    let next = loop {
        world.advance(Duration::from_millis(1));
        let before = first.now();
        assert_eq!(before.phase, Phase::Running, "still running");
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
    assert!(motions[1].at >= taken + Duration::from_millis(45), "the pause is kept");
}

#[test]
fn repeated_fast_stops_are_journaled_once_a_second() {
    let mut world = homed();
    let (events, from) = (world.journal.events.len(), mark(&world));
    let mut newest = None;
    for _ in 0..500 {
        newest = Some(fast_stop(&mut world));
        submit(&mut world, Action::Stop, None).unwrap();
        world.advance(Duration::from_millis(10));
    }
    world.advance(Duration::from_secs(2));
    let newest = newest.unwrap();
    assert!(received(&world, from).len() > 500, "each is still sent");
    assert_eq!(latch(&world).fast_stop_id, newest, "each has its own id");
    let mut cleared = acknowledge(&mut world, newest);
    world.advance(Duration::from_millis(200));
    assert_eq!(cleared.try_recv().unwrap(), Ok(()));
    let events = &world.journal.events[events..];
    assert!(events.len() < 60, "{} in 5 s", events.len());
    let latched = events.iter().filter_map(|detail| match detail {
        Detail::FastStop(fast_stop) if fast_stop.event == FastStopStep::Latched => Some(fast_stop),
        _ => None,
    });
    let latched: Vec<_> = latched.collect();
    assert_eq!(latched.iter().map(|fast_stop| fast_stop.count).sum::<u64>(), 500);
    assert_eq!(latched.last().unwrap().fast_stop_id, newest);
    let confirmed = |detail: &&Detail| matches!(detail, Detail::FastStop(step) if step.event == FastStopStep::Confirmed && step.fast_stop_id == newest);
    assert_eq!(events.iter().filter(confirmed).count(), 1);
    // After an acknowledge a FAST STOP gets its own event.
    let again = fast_stop(&mut world);
    assert!(matches!(world.journal.events.last(), Some(Detail::FastStop(step)) if step.fast_stop_id == again));
}

#[test]
fn stop_of_a_running_motion_is_a_new_command() {
    let mut world = homed();
    let first = submit(&mut world, Action::Stop, None).unwrap();
    world.advance(Duration::from_millis(100));
    let repeated = submit(&mut world, Action::Stop, None).unwrap();
    assert_eq!((repeated.id(), repeated.now().replayed), (first.id(), true));
    // Repeats take no slot from other clients.
    let from = mark(&world);
    for _ in 0..1000 {
        assert!(submit(&mut world, Action::Stop, None).is_ok());
    }
    assert!(submit(&mut world, Action::Stop, Some("another")).is_ok());
    world.advance(Duration::from_millis(100));
    // One was written at once, and one waited for its reply. A repeat can follow a script that moves the fingers.
    assert_eq!(received(&world, from), [id::STOP; 3]);
    let running = start(&mut world, move_to(5.0, 10.0));
    world.advance(Duration::from_millis(200));
    let stopped = submit(&mut world, Action::Stop, None).unwrap();
    assert_ne!(stopped.id(), first.id());
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Aborted));
}

#[test]
fn stop_is_sent_whatever_its_request_id_stands_for() {
    let mut world = homed();
    let first = submit(&mut world, Action::Stop, Some("a")).unwrap();
    world.advance(Duration::from_millis(100));
    let again = submit(&mut world, Action::Stop, Some("a")).unwrap();
    assert_eq!((again.id(), again.now().replayed), (first.id(), true));
    // A motion starts while the reply to a Stop is lost.
    world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::STOP), times: 1 });
    let unanswered = submit(&mut world, Action::Stop, Some("d")).unwrap();
    let running = start(&mut world, move_to(80.0, 10.0));
    world.advance(Duration::from_millis(100));
    let again = submit(&mut world, Action::Stop, Some("d")).unwrap();
    assert_eq!((again.id(), again.now().outcome), (unanswered.id(), None));
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Aborted));
    for (motion_id, stop_id) in [("b", "a"), ("c", "c")] {
        let from = mark(&world);
        let running = submit(&mut world, Action::Motion(move_to(5.0, 10.0)), Some(motion_id)).unwrap();
        world.advance(Duration::from_millis(300));
        let stop = submit(&mut world, Action::Stop, Some(stop_id)).unwrap();
        assert!(!stop.now().replayed && stop.id() != first.id(), "{stop_id}");
        assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Aborted));
        assert_eq!(received(&world, from), [id::PRE_POSITION, id::STOP], "{stop_id}");
    }
}

#[test]
fn flickering_faults_are_journaled_once_a_second() {
    let mut world = homed();
    let events = world.journal.events.len();
    let flags = world.device.snapshot().flags;
    let mut changes = 0;
    for _ in 0..250 {
        for flags in [flags | SystemState::FINGER_FAULT, flags] {
            let mut update = vec![0, 0];
            update.extend(flags.bits().to_le_bytes());
            let mut frame = Vec::new();
            wsg::frame::encode(id::GET_SYSTEM_STATE, &update, &mut frame);
            let now = world.clock();
            world.actor.receive(now, &frame);
            world.settle();
            changes += 1;
        }
        world.advance(Duration::from_millis(20));
    }
    world.advance(Duration::from_secs(2));
    let events = &world.journal.events[events..];
    assert!(events.len() < 40, "{} in 5 s", events.len());
    let count = |detail: &Detail| match detail {
        Detail::Device(DeviceEvent::Fault { .. } | DeviceEvent::FaultCleared { .. }) => 1,
        Detail::Device(DeviceEvent::Flickering { count, .. }) => *count,
        other => panic!("{other:?}"),
    };
    assert_eq!(events.iter().map(count).sum::<u64>(), changes, "every change is counted");
    assert_eq!(events.last(), Some(&Detail::Device(DeviceEvent::FaultCleared { flags: vec!["FINGER_FAULT"] })));
    // After a quiet second the next fault gets its own event.
    world.device.apply(world.now, Change::PowerFault { on: true });
    world.advance(Duration::from_millis(50));
    let is_fault = |detail: &&Detail| matches!(detail, Detail::Device(DeviceEvent::Fault { .. }));
    assert!(world.journal.events.iter().rev().take(3).any(|detail| is_fault(&detail)));
}

#[test]
fn flickering_link_is_journaled_once_a_second() {
    let mut world = homed();
    let events = world.journal.events.len();
    for _ in 0..100 {
        world.device.apply(world.now, Change::CutConnection);
        world.advance(Duration::from_millis(150));
    }
    world.advance(Duration::from_secs(3));
    assert_eq!(state(&world).link, Link::Connected);
    let events = &world.journal.events[events..];
    assert!(events.len() < 80, "{} in 15 s", events.len());
    let newest = events.iter().rev().find_map(|detail| match detail {
        Detail::Link(link) => Some(link.link),
        _ => None,
    });
    assert_eq!(newest, Some(Link::Connected), "the last event is the final state");
    let latched = |detail: &&Detail| matches!(detail, Detail::FastStop(step) if step.event == FastStopStep::Latched);
    assert_eq!(events.iter().filter(latched).count(), 1, "the connection's end is a FAST STOP");
}
