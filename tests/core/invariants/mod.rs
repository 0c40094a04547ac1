//! Tests of the gripper's invariants, each under the invariant's name, and of the actor's other promises. They run on a
//! virtual clock and check the frames that the device received.

mod bounds;
mod device_faults;
mod drain;
mod drivers;
mod faults;
mod late;
mod leases;
mod own_changes;
mod repeats;
mod restarts;
mod slow_updates;
pub mod steps;
mod streams;
mod values;

use std::time::Duration;

use gripper::handle::ActorRequest;
use gripper::{Conflict, Failure, Rejection};
use model::{Action, Client, FastStopCause, Link, Motion, Outcome, Submission};
use sim::{Change, FaultKind, Interface};
use wsg::{self, Acceleration, Force, LoopData, Speed, Status, Width, id};

use super::seeds::world::World;

use steps::*;

#[test]
fn frame_sent_at_most_once() {
    let mut world = homed();
    world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::GRIP), times: 9 });
    let from = mark(&world);
    let command = run(&mut world, grip(None));
    assert_eq!(command.outcome, Some(Outcome::Unknown));
    world.advance(Duration::from_secs(30));
    assert_eq!(received(&world, from), [id::GRIP, id::STOP], "the Stop follows the unknown result");
}

#[test]
fn nothing_moves_unasked() {
    let mut world = world();
    world.device.apply(world.now, Change::Reboot { ready_after_ms: 500, mid_frame: false });
    world.advance(Duration::from_secs(5));
    world.device.apply(world.now, Change::SetFastStop);
    world.advance(Duration::from_secs(1));
    let id = latch(&world).fast_stop_id;
    let mut answered = acknowledge(&mut world, id);
    world.advance(Duration::from_secs(1));
    assert_eq!(answered.try_recv().unwrap(), Ok(()));
    world.device.apply(world.now, Change::CutConnection);
    world.advance(Duration::from_secs(5));
    assert!(!received(&world, 0).iter().any(|&id| id::is_motion(id)));
    assert_eq!(state(&world).link, Link::Connected);
}

#[test]
fn fast_stop_overtakes() {
    let mut world = World::calm(device(), Some(960));
    let from = mark(&world);
    for _ in 0..5 {
        let long = wsg::Command::Loop(LoopData::new(vec![0; 60]).unwrap());
        drop(exchange(&mut world, long));
        drop(exchange(&mut world, wsg::Command::GetAcceleration));
    }
    fast_stop(&mut world);
    world.advance(Duration::from_millis(300));
    let all: Vec<_> = world.device.received()[from..].iter().map(|frame| frame.id).collect();
    assert_eq!(all[1], id::FAST_STOP, "after the frame in progress, before all others: {all:02X?}");
}

#[test]
fn latch_blocks_motion() {
    let mut world = homed();
    // A motion waits in the pause after the homing.
    let waiting = start(&mut world, move_to(50.0, 50.0));
    let from = mark(&world);
    let id = fast_stop(&mut world);
    let command = waiting.now();
    assert_eq!((command.outcome, command.fast_stop_id), (Some(Outcome::Aborted), Some(id)));
    world.advance(Duration::from_secs(1));
    assert_eq!(refused(&mut world, home()), Conflict::FastStop { id }.into());
    world.advance(Duration::from_secs(1));
    assert_eq!(received(&world, from), [id::FAST_STOP]);
}

#[test]
fn fast_stop_aborts_a_running_motion_with_its_id() {
    let mut world = homed();
    let running = start(&mut world, move_to(10.0, 20.0));
    world.advance(Duration::from_millis(500));
    let id = fast_stop(&mut world);
    let command = finish(&mut world, &running);
    assert_eq!((command.outcome, command.fast_stop_id), (Some(Outcome::Aborted), Some(id)));
    assert!(latch(&world).fast_stop_confirmed);
    assert_eq!(latch(&world).fast_stop_cause, FastStopCause::Requested);
}

#[test]
fn acknowledge_names_its_latch() {
    let mut world = homed();
    let first = fast_stop(&mut world);
    world.advance(Duration::from_millis(100));
    let second = fast_stop(&mut world);
    world.advance(Duration::from_millis(100));
    let from = mark(&world);
    let mut stale = acknowledge(&mut world, first);
    let expected = Conflict::StaleFastStop { given: first, current: Some(second) };
    assert_eq!(stale.try_recv().unwrap(), Err(expected.into()));
    assert_eq!(received(&world, from), NOTHING);
    let mut right = acknowledge(&mut world, second);
    world.advance(Duration::from_millis(100));
    assert_eq!(right.try_recv().unwrap(), Ok(()));
    assert_eq!(state(&world).fast_stop, Some(false));
    assert_eq!(received(&world, from), [id::ACKNOWLEDGE_FAST_STOP]);
    assert_eq!(run(&mut world, move_to(50.0, 100.0)).outcome, Some(Outcome::Success));
}

const NOTHING: [u8; 0] = [];

#[test]
fn acknowledge_counts_only_once_the_flag_is_clear() {
    let mut world = homed();
    world.device.apply(world.now, Change::Overheat { temperature_c: 120.0 });
    world.advance(Duration::from_millis(200));
    assert_eq!(latch(&world).fast_stop_cause, FastStopCause::TemperatureFault);
    let id = latch(&world).fast_stop_id;
    let mut early = acknowledge(&mut world, id);
    world.advance(Duration::from_secs(1));
    let rejection = early.try_recv().unwrap().unwrap_err();
    assert!(matches!(rejection, Rejection::Conflict(Conflict::FastStopPersists { .. })), "{rejection:?}");
    assert!(rejection.to_string().contains("TEMP_FAULT"), "{rejection}");
    world.device.apply(world.now, Change::Cool);
    world.advance(Duration::from_millis(200));
    let mut late = acknowledge(&mut world, id);
    world.advance(Duration::from_secs(1));
    assert_eq!(late.try_recv().unwrap(), Ok(()));
}

#[test]
fn latch_survives_a_device_reboot() {
    let mut world = homed();
    let id = fast_stop(&mut world);
    world.advance(Duration::from_millis(100));
    world.device.apply(world.now, Change::Reboot { ready_after_ms: 200, mid_frame: false });
    world.advance(Duration::from_secs(5));
    assert_eq!((state(&world).link, latch(&world).fast_stop_id), (Link::Connected, id));
    assert_eq!(refused(&mut world, home()), Conflict::FastStop { id }.into());
    let mut answered = acknowledge(&mut world, id);
    world.advance(Duration::from_millis(200));
    assert_eq!(answered.try_recv().unwrap(), Ok(()));
}

#[test]
fn fast_stop_without_a_link_is_sent_first_after_reconnect() {
    let mut world = homed();
    world.device.apply(world.now, Change::RefuseConnections { on: true });
    world.device.apply(world.now, Change::CutConnection);
    world.advance(Duration::from_secs(1));
    let id = fast_stop(&mut world);
    assert!(!latch(&world).fast_stop_confirmed);
    let mut early = acknowledge(&mut world, id);
    assert_eq!(early.try_recv().unwrap(), Err(Conflict::FastStopUnconfirmed { id }.into()));
    let from = mark(&world);
    world.device.apply(world.now, Change::RefuseConnections { on: false });
    world.advance(Duration::from_secs(3));
    assert_eq!(world.device.received()[from].id, id::FAST_STOP);
    assert!(latch(&world).fast_stop_confirmed);
}

#[test]
fn unknown_is_said() {
    let mut world = homed();
    let running = start(&mut world, move_to(10.0, 20.0));
    world.advance(Duration::from_millis(500));
    world.device.apply(world.now, Change::CutConnection);
    let command = finish(&mut world, &running);
    assert_eq!((command.outcome, command.reached_goal, command.width_mm), (Some(Outcome::Unknown), None, None));
    assert_eq!(state(&world).link, Link::Reconnecting);
    assert!(state(&world).link_cause.is_some());
}

#[test]
fn unsent_motion_is_refused_rather_than_unknown() {
    let mut world = homed();
    // A motion waits in the pause after the homing.
    let waiting = start(&mut world, move_to(50.0, 50.0));
    world.device.apply(world.now, Change::CutConnection);
    let command = finish(&mut world, &waiting);
    assert_eq!(command.outcome, Some(Outcome::Refused));
    assert!(matches!(command.rejection, Some(Rejection::Failure(Failure::LinkDown { .. }))));
}

#[test]
fn device_refusal_is_not_our_error() {
    let mut world = homed();
    let status = FaultKind::Status { code: 4711 };
    world.device.apply(world.now, Change::Fault { kind: status, id: Some(id::GRIP), times: 1 });
    let ticket = submit(&mut world, Action::Motion(grip(None)), Some("r1")).unwrap();
    let command = finish(&mut world, &ticket);
    assert_eq!((command.outcome, command.status_code), (Some(Outcome::Refused), Some(4711)));
    let Some(Rejection::Device(refusal)) = command.rejection else { panic!("{:?}", command.rejection) };
    assert_eq!((refusal.command, refusal.status), ("Grip", Status::from_code(4711)));
    // A refused request does not bind its request id.
    let again = submit(&mut world, Action::Motion(grip(None)), Some("r1")).unwrap();
    assert!(!again.now().replayed);
    assert_eq!(finish(&mut world, &again).outcome, Some(Outcome::PartHeld));
}

#[test]
fn repeated_request_id_is_one_motion() {
    let mut world = homed();
    let from = mark(&world);
    let first = submit(&mut world, Action::Motion(grip(None)), Some("r1")).unwrap();
    let second = submit(&mut world, Action::Motion(grip(None)), Some("r1")).unwrap();
    assert_eq!((second.now().id, second.now().replayed), (first.now().id, true));
    let other = submit(&mut world, Action::Motion(home()), Some("r1")).unwrap_err();
    assert_eq!(other, Conflict::RequestIdReused.into());
    finish(&mut world, &first);
    assert_eq!(received(&world, from), [id::GRIP]);
}

#[test]
fn grip_with_a_refused_force_moves_nothing() {
    let mut world = homed();
    let status = FaultKind::Status { code: Status::E_ACCESS_DENIED.code() };
    world.device.apply(world.now, Change::Fault { kind: status, id: Some(id::SET_FORCE_LIMIT), times: 1 });
    let from = mark(&world);
    let command = run(&mut world, grip(Some(30.0)));
    assert_eq!((command.outcome, command.status.as_deref()), (Some(Outcome::Refused), Some("E_ACCESS_DENIED")));
    assert_eq!(received(&world, from), [id::SET_FORCE_LIMIT]);
    assert_eq!(run(&mut world, grip(Some(30.0))).outcome, Some(Outcome::PartHeld));
    assert_eq!(received(&world, from), [id::SET_FORCE_LIMIT, id::SET_FORCE_LIMIT, id::GRIP, id::GET_FORCE_LIMIT]);
}

#[test]
fn motions_are_50_ms_apart() {
    let mut world = homed();
    run(&mut world, move_to(50.0, 200.0));
    let from = mark(&world);
    let ended = world.now;
    start(&mut world, move_to(60.0, 200.0));
    world.advance(Duration::from_millis(200));
    let next = world.device.received()[from..].iter().find(|frame| frame.id == id::PRE_POSITION).unwrap();
    // The end of a command waits for fresh values, so part of the pause is already over.
    assert!(next.at >= ended + Duration::from_millis(35), "{:?}", next.at - ended);
}

#[test]
fn result_has_the_values_after_the_motion() {
    let mut world = homed();
    assert_eq!(values(&world).width_mm.map(f32::round), Some(109.0), "value after homing");
    let held = run(&mut world, grip(Some(30.0)));
    assert_eq!(held.outcome, Some(Outcome::PartHeld));
    assert_eq!(values(&world).state, Some("HOLDING"));
    assert_eq!((held.width_mm, held.force_n), (values(&world).width_mm, values(&world).force_n));
}

#[test]
fn restarted_device_gets_its_settings_before_any_motion() {
    let mut world = homed();
    let acceleration = Acceleration::new(2000.0).unwrap();
    let mut set = exchange(&mut world, wsg::Command::SetAcceleration(acceleration));
    world.advance(Duration::from_millis(100));
    assert_eq!(set.try_recv().unwrap(), Ok(wsg::Data::Acceleration(acceleration)), "the value read back");
    assert_eq!(run(&mut world, grip(Some(30.0))).outcome, Some(Outcome::PartHeld));
    world.device.apply(world.now, Change::Reboot { ready_after_ms: 500, mid_frame: false });
    world.advance(Duration::from_secs(5));
    let snapshot = world.device.snapshot();
    assert!((snapshot.acceleration_mm_s2 - 2000.0).abs() < 0.1, "{snapshot:?}");
    assert!((snapshot.force_limit_n - 30.0).abs() < 0.1, "{snapshot:?}");
    assert_eq!((state(&world).link, values(&world).referenced), (Link::Connected, Some(false)));
    assert_eq!(values(&world).width_mm, None, "null until referenced");
    assert_eq!(refused(&mut world, grip(None)), Conflict::NotReferenced.into());
}

#[test]
fn silence_is_noticed_within_1500_ms_and_closes_the_link_5_s_later() {
    let mut world = homed();
    world.device.apply(world.now, Change::Silent { on: true });
    world.advance(Duration::from_millis(1400));
    assert_eq!(state(&world).link, Link::Connected);
    world.advance(Duration::from_millis(200));
    assert_eq!(state(&world).link, Link::Unresponsive);
    let rejection = refused(&mut world, move_to(50.0, 50.0));
    assert!(matches!(rejection, Rejection::Failure(Failure::LinkDown { link: Link::Unresponsive, .. })));
    world.advance(Duration::from_secs(4));
    assert_eq!(state(&world).link, Link::Unresponsive);
    let from = mark(&world);
    world.advance(Duration::from_millis(1100));
    assert_eq!(state(&world).link, Link::Reconnecting);
    assert!(received(&world, from).contains(&id::DISCONNECT_ANNOUNCEMENT), "a plain close is a FAST STOP");
}

#[test]
fn thousand_reads_cost_the_device_one_frame() {
    let mut world = homed();
    let from = mark(&world);
    let mut answers: Vec<_> =
        (0..1000).map(|_| exchange(&mut world, wsg::Command::GetStatistics { reset: false })).collect();
    world.advance(Duration::from_millis(100));
    answers.extend((0..1000).map(|_| exchange(&mut world, wsg::Command::GetStatistics { reset: false })));
    assert!(answers.iter_mut().all(|answer| answer.try_recv().unwrap().is_ok()));
    assert_eq!(received(&world, from), [id::GET_STATISTICS]);
    run(&mut world, grip(None));
    let mut after = exchange(&mut world, wsg::Command::GetStatistics { reset: false });
    world.advance(Duration::from_millis(100));
    let Ok(wsg::Data::Statistics(statistics)) = after.try_recv().unwrap() else { panic!() };
    assert_eq!(statistics.total, 1, "a motion invalidates earlier readings");
}

#[test]
fn stop_ends_a_motion_and_latches_nothing() {
    let mut world = homed();
    let running = start(&mut world, move_to(10.0, 20.0));
    world.advance(Duration::from_millis(500));
    let stop = submit(&mut world, Action::Stop, None).unwrap();
    assert_eq!(finish(&mut world, &stop).outcome, Some(Outcome::Success));
    let stopped = finish(&mut world, &running);
    assert_eq!((stopped.outcome, stopped.fast_stop_id), (Some(Outcome::Aborted), None));
    assert_eq!(state(&world).fast_stop, Some(false));
}

#[test]
fn unannounced_disconnect_is_the_cause_of_the_latch() {
    let mut world = homed();
    world.disconnected("pulled");
    world.advance(Duration::from_secs(3));
    assert_eq!(latch(&world).fast_stop_cause, FastStopCause::UnannouncedDisconnect);
    assert_eq!(&*latch(&world).fast_stop_by, "device");
}

#[test]
fn every_command_ends_once() {
    let mut world = homed();
    let ticket = start(&mut world, move_to(10.0, 20.0));
    // A cancel, a Stop, a FAST STOP and a lost link, each of which would end the command.
    let id = ticket.now().id;
    drop(request(&mut world, |answer| ActorRequest::Cancel { id, client: client(), answer }));
    submit(&mut world, Action::Stop, None).unwrap();
    fast_stop(&mut world);
    for _ in 0..2000 {
        world.advance(Duration::from_millis(1));
        if world.now > world.start + Duration::from_secs(4) {
            world.disconnected("pulled");
        }
    }
    assert_eq!(ticket.now().outcome, Some(Outcome::Aborted));
    assert_eq!(world.journal.ends_of(id), [Outcome::Aborted]);
}

#[test]
fn lost_setting_blocks_motion() {
    let mut world = homed();
    drop(exchange(&mut world, wsg::Command::SetForceLimit(Force::new(10.0).unwrap())));
    world.advance(Duration::from_millis(100));
    let refusal = FaultKind::Status { code: Status::E_INSUFFICIENT_RESOURCES.code() };
    world.device.apply(world.now, Change::Fault { kind: refusal, id: Some(id::SET_FORCE_LIMIT), times: 1 });
    world.device.apply(world.now, Change::Reboot { ready_after_ms: 100, mid_frame: false });
    world.advance(Duration::from_secs(3));
    assert_eq!(state(&world).link, Link::Connected);
    let expected = Conflict::SettingsLost { settings: "force limit".to_owned() };
    assert_eq!(refused(&mut world, home()), expected.into());
    drop(exchange(&mut world, wsg::Command::SetForceLimit(Force::new(10.0).unwrap())));
    world.advance(Duration::from_millis(100));
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
}

#[test]
fn stop_on_a_lost_link_is_unknown() {
    let mut world = homed();
    world.device.apply(world.now, Change::Silent { on: true });
    let stop = submit(&mut world, Action::Stop, None).unwrap();
    world.disconnected("pulled");
    let command = stop.now();
    assert_eq!((command.outcome, command.rejection), (Some(Outcome::Unknown), None));
}

#[test]
fn flags_confirm_a_fast_stop_without_replies() {
    let mut world = homed();
    world.device.apply(world.now, Change::SetFastStop);
    world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::FAST_STOP), times: 200 });
    world.advance(Duration::from_millis(100));
    let id = fast_stop(&mut world);
    world.advance(Duration::from_millis(100));
    assert_eq!((latch(&world).fast_stop_id, latch(&world).fast_stop_confirmed), (id, true));
}

#[test]
fn refused_updates_are_switched_on_later() {
    let mut world = World::calm(device(), None);
    let refusal = FaultKind::Status { code: Status::E_NOT_AVAILABLE.code() };
    world.device.apply(world.now, Change::Fault { kind: refusal, id: Some(id::GET_WIDTH), times: 2 });
    world.device.apply(world.now, Change::Reboot { ready_after_ms: 100, mid_frame: false });
    world.advance(Duration::from_secs(3));
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    world.advance(Duration::from_secs(3));
    assert_eq!(values(&world).width_mm, Some(109.0));
}

#[test]
fn stop_before_homing_has_no_width() {
    let mut world = world();
    let stop = submit(&mut world, Action::Stop, None).unwrap();
    assert_eq!(finish(&mut world, &stop).width_mm, None);
}

#[test]
fn cancelled_grip_keeps_its_force_limit() {
    let mut world = World::calm(device(), Some(960));
    run(&mut world, home());
    world.advance(Duration::from_millis(100));
    let ticket = start(&mut world, grip(Some(20.0)));
    drop(request(&mut world, |answer| ActorRequest::Cancel { id: ticket.now().id, client: client(), answer }));
    world.advance(Duration::from_millis(200));
    assert_eq!(ticket.now().outcome, Some(Outcome::Aborted));
    let mut limit = exchange(&mut world, wsg::Command::GetForceLimit);
    world.advance(Duration::from_millis(200));
    assert_eq!(limit.try_recv().unwrap(), Ok(wsg::Data::ForceLimit(Force::new(20.0).unwrap())));
    world.device.apply(world.now, Change::Reboot { ready_after_ms: 100, mid_frame: false });
    world.advance(Duration::from_secs(5));
    assert!((world.device.snapshot().force_limit_n - 20.0).abs() < 0.1);
}

#[test]
fn no_force_limit_slips_between_a_grip_and_its_force() {
    let mut world = homed();
    let ticket = start(&mut world, grip(Some(20.0)));
    let mut other = exchange(&mut world, wsg::Command::SetForceLimit(Force::new(80.0).unwrap()));
    let expected = Conflict::AlreadyRunning { id: ticket.now().id };
    assert_eq!(other.try_recv().unwrap(), Err(expected.into()));
    assert_eq!(finish(&mut world, &ticket).outcome, Some(Outcome::PartHeld));
    assert!((world.device.snapshot().force_limit_n - 20.0).abs() < 0.1);
}

#[test]
fn foreign_motion_is_noticed_once() {
    let mut world = homed();
    run(&mut world, move_to(60.0, 200.0));
    world.advance(Duration::from_secs(1));
    assert_eq!(world.journal.foreign_motions, 0);
    world.device.apply(world.now, Change::MoveBySomebody { width_mm: 50.0, speed_mm_s: 20.0 });
    world.advance(Duration::from_secs(2));
    assert_eq!(world.journal.foreign_motions, 1);
}

#[test]
fn stop_ignores_a_stale_lease() {
    let mut world = homed();
    let running = start(&mut world, move_to(10.0, 20.0));
    world.advance(Duration::from_millis(300));
    let now = world.clock();
    let id = world.ids.command_id(now.wall);
    let submission = Submission { client: client(), action: Action::Stop, request_id: None, lease: Some("old".into()) };
    let mut answered = request(&mut world, |answer| ActorRequest::Submit { submission, id, answer });
    assert!(answered.try_recv().unwrap().is_ok());
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Aborted));
}

#[test]
fn lost_part_names_its_grip_after_a_refusal_and_a_restart() {
    // Over TCP, killing the gateway would be a FAST STOP.
    let mut world = World::calm_on(Interface::Udp, device(), None);
    run(&mut world, home());
    let grip = run(&mut world, grip(None));
    let status = FaultKind::Status { code: Status::E_ACCESS_DENIED.code() };
    world.device.apply(world.now, Change::Fault { kind: status, id: Some(id::RELEASE), times: 1 });
    let release = Motion::Release { width: Width::new(60.0).unwrap(), speed: Speed::new(50.0).unwrap() };
    assert_eq!(run(&mut world, release).outcome, Some(Outcome::Refused));
    world.restart();
    world.advance(Duration::from_secs(2));
    assert_eq!(values(&world).state, Some("HOLDING"));
    world.device.apply(world.now, Change::SlipPart);
    world.advance(Duration::from_secs(1));
    assert_eq!(world.journal.lost_parts, [Some(grip.id)]);
    // The next run does not report a known loss again.
    world.restart();
    world.advance(Duration::from_secs(2));
    assert_eq!((values(&world).state, world.journal.lost_parts.len()), (Some("PART_LOST"), 1));
}

#[test]
fn cancelled_command_names_the_canceller() {
    let mut world = homed();
    let running = start(&mut world, move_to(10.0, 20.0));
    world.advance(Duration::from_millis(300));
    let id = running.now().id;
    let somebody = Client { subject: "somebody".into(), ..client() };
    drop(request(&mut world, |answer| ActorRequest::Cancel { id, client: somebody, answer }));
    let ended = finish(&mut world, &running);
    assert_eq!((ended.outcome, ended.cancelled_by.as_deref()), (Some(Outcome::Aborted), Some("somebody")));
}
