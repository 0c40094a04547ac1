//! Clients that speak the device's own protocol: a motion takes the lease, and values are clamped as on the device.

use std::time::Duration;

use gripper::handle::ActorRequest;
use gripper::{Conflict, Failure, Invalid, Rejection, Ticket};
use model::{Action, Client, Door, FastStopCause, LeaseToken, LossCause, Motion, Outcome, Submission, TakeLease};
use sim::{Change, FaultKind, Script, ScriptAnswer};
use tokio::sync::oneshot;
use wsg::{self, Acceleration, Data, MoveFlags, SoftLimits, Speed, Width, id};

use super::NOTHING;
use super::steps::*;
use crate::seeds::world::World;

fn driver(host: &str) -> (Client, LeaseToken) {
    (Client::new(format!("wsg:{host}"), Door::Wsg), LeaseToken::generate())
}

fn moves(world: &mut World, driver: &(Client, LeaseToken), motion: Motion) -> Result<Ticket, Rejection> {
    let frame = motion.request();
    moves_as(world, driver, motion, frame)
}

/// Submits a motion that must reach the device as `frame`.
fn moves_as(
    world: &mut World,
    (client, token): &(Client, LeaseToken),
    motion: Motion,
    frame: wsg::Command,
) -> Result<Ticket, Rejection> {
    let now = world.clock();
    let id = world.ids.command_id(now.wall);
    let (client, lease) = (client.clone(), Some(token.clone()));
    let submission = Submission { client, action: Action::Motion(motion), request_id: None, lease };
    let (answer, mut answered) = oneshot::channel();
    world.actor.request(now, ActorRequest::Submit { submission, id, answer });
    let ticket = answered.try_recv().unwrap();
    if let Ok(ticket) = &ticket {
        world.clients.admitted.push(crate::seeds::client::Admitted {
            ticket: ticket.watched(),
            motion: Some(frame),
            lease: Some(token.clone()),
        });
    }
    world.settle();
    ticket
}

fn sets(world: &mut World, (client, token): &(Client, LeaseToken), command: wsg::Command) -> Result<Data, Rejection> {
    let (client, lease) = (client.clone(), Some(token.clone()));
    let mut answered =
        request(world, |answer| ActorRequest::Exchange { command, client, lease, answer: (None, answer) });
    world.advance(Duration::from_millis(100));
    answered.try_recv().unwrap()
}

fn holder(world: &World) -> Option<String> {
    state(world).lease_holder.as_deref().map(ToOwned::to_owned)
}

#[test]
fn driver_takes_the_free_lease_only_by_an_admitted_motion() {
    let mut world = world();
    let (one, other) = (driver("10.0.0.1"), driver("10.0.0.2"));
    assert_eq!(moves(&mut world, &one, move_to(50.0, 50.0)).unwrap_err(), Conflict::NotReferenced.into());
    assert!(sets(&mut world, &one, wsg::Command::SetAcceleration(Acceleration::new(500.0).unwrap())).is_ok());
    assert_eq!(holder(&world), None);
    let homing = moves(&mut world, &one, home()).unwrap();
    assert_eq!(holder(&world).as_deref(), Some("wsg:10.0.0.1"));
    let held = |rejection: Rejection| matches!(rejection, Rejection::Conflict(Conflict::LeaseHeld { .. }));
    assert!(held(moves(&mut world, &other, home()).unwrap_err()), "LEASE_HELD comes before ALREADY_RUNNING");
    let set = wsg::Command::SetAcceleration(Acceleration::new(500.0).unwrap());
    assert!(held(sets(&mut world, &other, set).unwrap_err()));
    assert_eq!(finish(&mut world, &homing).outcome, Some(Outcome::Success));
    assert!(homing.now().accepted);
    drop(request(&mut world, |answer| ActorRequest::ReleaseLease { token: Some(one.1.clone()), answer }));
    assert!(moves(&mut world, &other, move_to(50.0, 50.0)).is_ok());
}

#[test]
fn motion_script_takes_the_lease_and_read_script_does_not() {
    let mut world = homed();
    let one = driver("10.0.0.1");
    let custom = |id| wsg::Command::parse(id, &[1]).unwrap();
    let _ = sets(&mut world, &one, custom(0xB0));
    assert_eq!(holder(&world), None, "configured as a read");
    let Some(wsg::Command::Custom(script)) = Some(custom(0xB1)) else { panic!("no script") };
    let _ = moves(&mut world, &one, Motion::Custom(script));
    assert_eq!(holder(&world).as_deref(), Some("wsg:10.0.0.1"));
}

/// Script that no configuration declares.
const SCRIPT_ID: u8 = 0xB7;

fn homed_with_script() -> World {
    let mut device = device();
    device.scripts.push(Script { id: SCRIPT_ID, answer: ScriptAnswer::Echo });
    let mut world = World::calm(device, None);
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    world.advance(Duration::from_secs(1));
    world
}

fn script(world: &mut World, driver: &(Client, LeaseToken)) -> Result<Data, Rejection> {
    let mut answered = send_script(world, driver);
    world.advance(Duration::from_millis(20));
    answered.try_recv().unwrap()
}

fn send_script(
    world: &mut World,
    (client, token): &(Client, LeaseToken),
) -> oneshot::Receiver<Result<Data, Rejection>> {
    let (client, lease) = (client.clone(), Some(token.clone()));
    let command = wsg::Command::parse(SCRIPT_ID, &[1]).unwrap();
    request(world, |answer| ActorRequest::Exchange { command, client, lease, answer: (None, answer) })
}

fn announces_end(world: &mut World, (_, token): &(Client, LeaseToken)) {
    let token = Some(token.clone());
    drop(request(world, |answer| ActorRequest::ReleaseLease { token, answer }));
}

fn leaves(world: &mut World, (_, token): &(Client, LeaseToken)) {
    let token = token.clone();
    drop(request(world, |_: oneshot::Sender<()>| ActorRequest::LoseLease {
        token,
        times_taken: None,
        cause: LossCause::Disconnected,
    }));
}

fn somebody_moves(world: &mut World, width_mm: f64) {
    world.device.apply(world.now, Change::MoveBySomebody { width_mm, speed_mm_s: 20.0 });
    world.advance(Duration::from_millis(30));
}

#[test]
fn script_takes_the_lease_only_if_the_fingers_move_after_it() {
    let mut world = homed_with_script();
    let (one, other) = (driver("10.0.0.1"), driver("10.0.0.2"));
    assert!(script(&mut world, &one).is_ok());
    assert_eq!(holder(&world), None, "nothing moves");
    // The motion begins too late to be caused by the script.
    world.advance(Duration::from_millis(300));
    somebody_moves(&mut world, 80.0);
    assert_eq!((holder(&world), world.journal.foreign_motions), (None, 1));
    world.advance(Duration::from_secs(5));
    assert!(script(&mut world, &one).is_ok());
    somebody_moves(&mut world, 50.0);
    assert_eq!((holder(&world).as_deref(), world.journal.foreign_motions), (Some("wsg:10.0.0.1"), 1));
    let refused = script(&mut world, &other).unwrap_err();
    assert!(matches!(refused, Rejection::Conflict(Conflict::LeaseHeld { .. })), "{refused:?}");
}

#[test]
fn script_runs_during_a_motion_but_not_in_fast_stop() {
    let mut world = homed_with_script();
    let one = driver("10.0.0.1");
    moves(&mut world, &one, move_to(50.0, 50.0)).unwrap();
    world.advance(Duration::from_millis(300));
    assert!(script(&mut world, &one).is_ok(), "during a motion");
    let from = mark(&world);
    fast_stop(&mut world);
    let refused = script(&mut world, &one).unwrap_err();
    assert!(matches!(refused, Rejection::Conflict(Conflict::FastStop { .. })), "{refused:?}");
    assert!(!received(&world, from).contains(&SCRIPT_ID));
}

/// Lets a script time out. Its reply comes 3 s after the request.
fn time_out_a_script(world: &mut World, driver: &(Client, LeaseToken)) {
    let late = FaultKind::FinalLate { by_ms: 3000 };
    world.device.apply(world.now, Change::Fault { kind: late, id: Some(SCRIPT_ID), times: 1 });
    let mut answered = send_script(world, driver);
    world.advance(Duration::from_millis(1200));
    let timed_out = answered.try_recv().unwrap().unwrap_err();
    assert!(matches!(timed_out, Rejection::Failure(Failure::DeviceTimeout { .. })), "{timed_out:?}");
}

#[test]
fn script_is_not_sent_while_its_late_reply_is_awaited() {
    let mut world = homed_with_script();
    let one = driver("10.0.0.1");
    let from = mark(&world);
    time_out_a_script(&mut world, &one);
    let unsent = send_script(&mut world, &one).try_recv().unwrap().unwrap_err();
    assert_eq!(
        unsent.to_string(),
        "the custom command was not sent, because an earlier request still had no reply: try again later"
    );
    assert_eq!(received(&world, from), [SCRIPT_ID, id::STOP], "the Stop follows the unanswered script");
    world.advance(Duration::from_millis(1900));
    assert!(script(&mut world, &one).is_ok());
    assert_eq!(received(&world, from), [SCRIPT_ID, id::STOP, SCRIPT_ID]);
}

#[test]
fn only_an_unanswered_script_takes_the_lease_and_not_a_refused_one() {
    let mut world = homed_with_script();
    let (one, other) = (driver("10.0.0.1"), driver("10.0.0.2"));
    time_out_a_script(&mut world, &one);
    assert!(script(&mut world, &other).is_err());
    world.advance(Duration::from_millis(800));
    somebody_moves(&mut world, 50.0);
    assert_eq!(holder(&world).as_deref(), Some("wsg:10.0.0.1"));
}

#[test]
fn motion_of_an_unanswered_script_is_stopped_after_its_loss() {
    for (leaves_after_ms, moves_after_ms) in [(100, 600), (1500, 500), (1500, 3000)] {
        let mut world = homed_with_script();
        let one = driver("10.0.0.1");
        let hangs = Change::Fault { kind: FaultKind::NoReply, id: Some(SCRIPT_ID), times: 1 };
        world.device.apply(world.now, hangs);
        drop(send_script(&mut world, &one));
        world.advance(Duration::from_millis(leaves_after_ms));
        leaves(&mut world, &one);
        world.advance(Duration::from_millis(moves_after_ms));
        assert_eq!(state(&world).fast_stop, Some(false));
        somebody_moves(&mut world, 50.0);
        assert_eq!(state(&world).fast_stop, Some(true), "{leaves_after_ms} ms, then {moves_after_ms} ms");
    }
}

#[test]
fn fingers_that_move_after_the_loss_of_a_script_are_stopped() {
    for (delay_ms, is_stopped) in [(100, true), (250, false)] {
        let mut world = homed_with_script();
        let one = driver("10.0.0.1");
        assert!(script(&mut world, &one).is_ok());
        leaves(&mut world, &one);
        world.advance(Duration::from_millis(delay_ms));
        assert_eq!(state(&world).fast_stop, Some(false));
        somebody_moves(&mut world, 50.0);
        assert_eq!(state(&world).fast_stop, Some(is_stopped), "after {delay_ms} ms");
        if is_stopped {
            assert_eq!(latch(&world).fast_stop_cause, FastStopCause::ClientLost);
            assert_eq!(holder(&world), None);
        }
    }
}

#[test]
fn lost_script_stops_fingers_that_held_a_part_or_still_push() {
    let clamp = Motion::Move {
        flags: MoveFlags { relative: false, stop_on_block: false },
        width: Width::new(80.0).unwrap(),
        speed: Speed::new(50.0).unwrap(),
    };
    for (motion, outcome) in [(grip(None), Outcome::PartHeld), (clamp, Outcome::Success)] {
        let mut world = homed_with_script();
        assert_eq!(run(&mut world, motion.clone()).outcome, Some(outcome));
        world.advance(Duration::from_secs(2));
        let one = driver("10.0.0.1");
        assert!(script(&mut world, &one).is_ok());
        somebody_moves(&mut world, 50.0);
        assert_eq!(holder(&world).as_deref(), Some("wsg:10.0.0.1"), "after {motion:?}");
        leaves(&mut world, &one);
        assert_eq!(latch(&world).fast_stop_cause, FastStopCause::ClientLost, "after {motion:?}");
    }
}

#[test]
fn lost_script_stops_fingers_that_moved_before_it() {
    let mut world = homed_with_script();
    somebody_moves(&mut world, 50.0);
    let one = driver("10.0.0.1");
    assert!(script(&mut world, &one).is_ok());
    leaves(&mut world, &one);
    assert_eq!(latch(&world).fast_stop_cause, FastStopCause::ClientLost);
    assert_eq!(holder(&world), None);
}

#[test]
fn motion_of_one_of_two_scripts_is_stopped_by_the_loss_of_either() {
    for lost in 0..2 {
        let mut world = homed_with_script();
        let drivers = [driver("10.0.0.1"), driver("10.0.0.2")];
        for one in &drivers {
            assert!(script(&mut world, one).is_ok());
        }
        somebody_moves(&mut world, 50.0);
        assert_eq!((holder(&world), world.journal.foreign_motions), (None, 1));
        // Longer than a script counts after its reply.
        world.advance(Duration::from_millis(500));
        leaves(&mut world, &drivers[lost]);
        assert_eq!(latch(&world).fast_stop_cause, FastStopCause::ClientLost, "loss of {lost}");
        assert_eq!(holder(&world), None);
    }
}

#[test]
fn waiting_script_ends_with_its_client_and_with_a_new_lease() {
    type End = fn(&mut World, &(Client, LeaseToken));

    let take = |world: &mut World, _: &(Client, LeaseToken)| {
        let (take, token) = (TakeLease::by(client()), LeaseToken::generate());
        drop(request(world, |answer| ActorRequest::TakeLease { take, token, answer }));
    };
    let ends: [End; 3] = [announces_end, leaves, take];
    for (index, end) in ends.into_iter().enumerate() {
        let mut world = homed_with_script();
        let (one, other) = (driver("10.0.0.1"), driver("10.0.0.2"));
        let from = mark(&world);
        // While the first script's reply is awaited, the second one is not written.
        let _answered = send_script(&mut world, &one);
        let mut waiting = send_script(&mut world, &other);
        end(&mut world, &other);
        world.advance(Duration::from_millis(100));
        assert_eq!(received(&world, from), [SCRIPT_ID], "end {index}");
        let rejected = waiting.try_recv().unwrap().unwrap_err();
        assert!(matches!(rejected, Rejection::Conflict(Conflict::StaleLease { .. })), "{rejected:?}");
    }
}

#[test]
fn stop_withdraws_the_scripts_before_it() {
    let mut world = homed_with_script();
    let (one, other) = (driver("10.0.0.1"), driver("10.0.0.2"));
    let from = mark(&world);
    // While the first script's reply is awaited, the second one is not written.
    let _answered = send_script(&mut world, &one);
    let mut waiting = send_script(&mut world, &other);
    submit(&mut world, Action::Stop, None).unwrap();
    world.advance(Duration::from_secs(1));
    assert_eq!(received(&world, from), [SCRIPT_ID, id::STOP]);
    let rejected = waiting.try_recv().unwrap().unwrap_err();
    assert!(matches!(rejected, Rejection::Failure(Failure::StoppedFirst { .. })), "{rejected:?}");
}

#[test]
fn motion_of_a_script_after_07h_is_stopped() {
    let mut world = homed_with_script();
    let one = driver("10.0.0.1");
    assert!(script(&mut world, &one).is_ok());
    announces_end(&mut world, &one);
    leaves(&mut world, &one);
    let from = mark(&world);
    somebody_moves(&mut world, 50.0);
    world.advance(Duration::from_millis(20));
    assert_eq!(received(&world, from), [id::STOP]);
    assert_eq!((holder(&world), state(&world).fast_stop), (None, Some(false)));
}

#[test]
fn lost_driver_returns_from_the_same_host_with_a_new_token() {
    let mut world = homed();
    let (one, other) = (driver("10.0.0.1"), driver("10.0.0.2"));
    let held = moves(&mut world, &one, grip(None)).unwrap();
    assert_eq!(finish(&mut world, &held).outcome, Some(Outcome::PartHeld));
    let from = mark(&world);
    let lost = one.1.clone();
    drop(request(&mut world, |_: oneshot::Sender<()>| ActorRequest::LoseLease {
        token: lost,
        times_taken: None,
        cause: LossCause::Disconnected,
    }));
    world.advance(Duration::from_secs(1));
    assert_eq!(received(&world, from), NOTHING);
    assert!(moves(&mut world, &other, move_to(50.0, 50.0)).is_err());
    let take = TakeLease::by(other.0.clone());
    let taken = request(&mut world, |answer| ActorRequest::TakeLease { take, token: LeaseToken::generate(), answer });
    assert!({ taken }.try_recv().unwrap().is_err());
    assert!(moves(&mut world, &driver("10.0.0.1"), move_to(50.0, 50.0)).is_ok());
}

#[test]
fn driver_is_clamped_and_other_clients_are_refused() {
    let mut world = homed();
    let one = driver("10.0.0.1");
    assert!(matches!(refused(&mut world, move_to(5000.0, 1e6)), Rejection::Invalid(Invalid::OutOfRange { .. })));
    let from = mark(&world);
    let clamped = move_to(110.0, 420.0).request();
    let ticket = moves_as(&mut world, &one, move_to(5000.0, 1e6), clamped.clone()).unwrap();
    assert_eq!(finish(&mut world, &ticket).outcome, Some(Outcome::Success));
    let sent = world.device.received()[from..].iter().find(|frame| frame.id == id::PRE_POSITION).unwrap();
    assert_eq!(wsg::Command::parse(sent.id, &sent.payload), Ok(clamped));
    let acceleration = wsg::Command::SetAcceleration(Acceleration::new(1e6).unwrap());
    assert_eq!(sets(&mut world, &one, acceleration), Ok(Data::Acceleration(Acceleration::new(5000.0).unwrap())));
    let width = |mm| Width::new(mm).unwrap();
    let limits = SoftLimits::new(width(-5.0), width(60.0)).unwrap();
    let limits_set = sets(&mut world, &one, wsg::Command::SetSoftLimits(limits));
    assert_eq!(limits_set, Ok(Data::SoftLimits(SoftLimits::new(width(0.0), width(60.0)).unwrap())));
    let inside = moves(&mut world, &one, move_to(50.0, 400.0)).unwrap();
    finish(&mut world, &inside);
    let forbidden = moves(&mut world, &one, move_to(70.0, 50.0)).unwrap_err();
    assert!(matches!(forbidden, Rejection::Invalid(Invalid::OutOfRange { field: "width_mm", .. })));
}

#[test]
fn lost_driver_does_not_hide_a_requested_fast_stop() {
    let mut world = homed();
    let driver = driver("10.0.0.1");
    moves(&mut world, &driver, move_to(5.0, 10.0)).unwrap();
    world.advance(Duration::from_millis(200));
    let requested = fast_stop(&mut world);
    leaves(&mut world, &driver);
    world.advance(Duration::from_millis(200));
    let latch = latch(&world);
    assert_eq!((latch.fast_stop_cause, &*latch.fast_stop_by), (FastStopCause::Requested, "test"));
    assert_ne!(latch.fast_stop_id, requested, "the loss is a further FAST STOP");
}
