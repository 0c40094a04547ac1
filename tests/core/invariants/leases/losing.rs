//! The loss of a lease holder while the fingers move.

use std::time::Duration;

use model::{FastStopCause, Link, LossCause, OnLossMoving, Outcome, TakeLease};
use sim::{FaultKind, Interface};
use wsg::id;

use super::super::steps::*;
use super::*;

#[test]
fn holder_lost_during_a_motion_is_a_fast_stop_within_the_ttl() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    let running = submit_with(&mut world, move_to(5.0, 10.0), a).unwrap();
    let from = mark(&world);
    close(&mut world, running);
    let lost = world.now;
    world.advance(Duration::from_millis(490));
    assert_eq!(fast_stops(&world, from), 0);
    world.advance(Duration::from_millis(60));
    let sent = world.device.received()[from..].iter().find(|frame| frame.id == id::FAST_STOP).unwrap().at;
    assert!(sent <= lost + TTL + Duration::from_millis(50), "{:?}", sent - lost);
    assert_eq!(fast_stops(&world, from), 1, "no repeat after the confirmation");
    let latch = latch(&world);
    assert_eq!((latch.fast_stop_cause, &*latch.fast_stop_by), (FastStopCause::ClientLost, "http:a"));
    assert_eq!(latch.fast_stop_reason.as_str(), "lease holder a lost");
    assert!(latch.fast_stop_confirmed && !lease(&mut world).held);
}

/// Loses the holder with this token.
fn lose(world: &mut World, token: LeaseToken) {
    drop(request(world, |_: oneshot::Sender<()>| ActorRequest::LoseLease {
        token,
        times_taken: None,
        cause: LossCause::Disconnected,
    }));
}

/// Loses the link right after a motion has begun, and then its holder. A serial line has no connection whose end would
/// stop the fingers.
fn lose_link_and_holder(on_loss_moving: OnLossMoving) -> (World, usize) {
    let mut world = World::calm_on(Interface::Serial, device(), Some(11_520));
    run(&mut world, home());
    let a = token(&mut world, TakeLease { on_loss_moving: Some(on_loss_moving), ..wish("a") }).unwrap();
    let from = mark(&world);
    let running = submit_with(&mut world, move_to(5.0, 20.0), Some(a.clone())).unwrap();
    while !received(&world, from).contains(&id::PRE_POSITION) {
        world.advance(Duration::from_millis(1));
    }
    assert_eq!(values(&world).moving, Some(false), "the flags have not shown the motion yet");
    world.disconnected("pulled");
    assert_eq!(running.now().outcome, Some(Outcome::Unknown));
    let now = world.clock();
    world.actor.request(now, ActorRequest::LoseLease { token: a, times_taken: None, cause: LossCause::Disconnected });
    assert!(!lease(&mut world).held && world.device.snapshot().moving);
    world.advance(Duration::from_secs(1));
    (world, from)
}

#[test]
fn holder_lost_after_the_link_is_a_fast_stop() {
    // A Stop can't wait for the link.
    for on_loss_moving in [OnLossMoving::FastStop, OnLossMoving::Stop] {
        let (world, from) = lose_link_and_holder(on_loss_moving);
        assert_eq!(latch(&world).fast_stop_cause, FastStopCause::ClientLost);
        assert_eq!(fast_stops(&world, from), 1);
        assert!(!world.device.snapshot().moving && latch(&world).fast_stop_confirmed);
    }
}

#[test]
fn motion_of_a_holder_lost_after_the_link_can_finish() {
    let (mut world, from) = lose_link_and_holder(OnLossMoving::Finish);
    assert!(world.device.snapshot().moving);
    world.advance(Duration::from_secs(10));
    assert_eq!((fast_stops(&world, from), state(&world).fast_stop), (0, Some(false)));
    assert_eq!(state(&world).reserved_for, None, "no part is held");
}

#[test]
fn holder_lost_during_an_unknown_motion_is_a_fast_stop() {
    let mut world = World::calm_on(Interface::Udp, device(), None);
    run(&mut world, home());
    let a = token(&mut world, TakeLease { ttl: Some(Duration::from_mins(1)), ..wish("a") });
    let running = submit_with(&mut world, move_to(5.0, 5.0), a.clone()).unwrap();
    world.advance(Duration::from_millis(300));
    // UDP has no connection to end, so the fingers keep moving.
    world.disconnected("unplugged");
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Unknown));
    world.advance(Duration::from_secs(1));
    assert_eq!((values(&world).moving, state(&world).command), (Some(true), None));
    let from = mark(&world);
    lose(&mut world, a.unwrap());
    world.advance(Duration::from_millis(200));
    assert_eq!(received(&world, from), [id::FAST_STOP]);
    assert!(!world.device.snapshot().moving);
}

#[test]
fn loss_of_the_holder_aborts_a_waiting_motion() {
    for choice in [OnLossMoving::Stop, OnLossMoving::Finish] {
        let mut world = homed();
        let a = token(&mut world, TakeLease { on_loss_moving: Some(choice), ..wish("a") });
        // A motion waits in the pause after the one before.
        let first = submit_with(&mut world, move_to(80.0, 200.0), a.clone()).unwrap();
        finish(&mut world, &first);
        let from = mark(&world);
        let waiting = submit_with(&mut world, move_to(5.0, 10.0), a.clone()).unwrap();
        lose(&mut world, a.unwrap());
        assert_eq!(finish(&mut world, &waiting).outcome, Some(Outcome::Aborted), "{choice:?}");
        world.advance(Duration::from_secs(1));
        assert!(!received(&world, from).contains(&id::PRE_POSITION), "{choice:?}");
    }
}

/// A serial device that moves its fingers, but sends nothing any more, and the holder's token.
fn silent_motion(on_loss_moving: OnLossMoving) -> (World, LeaseToken, Ticket) {
    let mut world = World::calm_on(Interface::Serial, device(), Some(11_520));
    run(&mut world, home());
    let terms = TakeLease { on_loss_moving: Some(on_loss_moving), ttl: Some(Duration::from_mins(1)), ..wish("a") };
    let a = token(&mut world, terms).unwrap();
    world.device.apply(world.now, Change::Silent { on: true });
    let running = submit_with(&mut world, move_to(5.0, 5.0), Some(a.clone())).unwrap();
    (world, a, running)
}

#[test]
fn holder_lost_around_the_end_of_an_unanswered_motion_is_a_fast_stop() {
    // The motion ends as UNKNOWN a second after its request, and then values at rest are awaited.
    for delay_ms in (900..1200).step_by(10) {
        let (mut world, a, running) = silent_motion(OnLossMoving::FastStop);
        world.advance(Duration::from_millis(delay_ms));
        let moves = world.device.snapshot().moving;
        assert!(moves || delay_ms > 1000, "only the gateway's Stop ends the motion, after {delay_ms} ms");
        lose(&mut world, a);
        assert!(!moves || state(&world).latch.is_some(), "{delay_ms} ms: {:?}", running.now().outcome);
        let causes = state(&world).latch.map(|latch| latch.fast_stop_cause);
        assert!(causes.is_none_or(|cause| cause == FastStopCause::ClientLost), "{causes:?}");
        world.advance(Duration::from_millis(300));
        assert!(!world.device.snapshot().moving, "{delay_ms} ms");
    }
}

#[test]
fn lost_stop_of_an_unanswered_motion_is_repeated() {
    for delay_ms in [500, 1100] {
        let (mut world, a, running) = silent_motion(OnLossMoving::Stop);
        world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::STOP), times: 1 });
        world.advance(Duration::from_millis(delay_ms));
        let from = mark(&world);
        lose(&mut world, a);
        world.advance(Duration::from_millis(500));
        assert!(world.device.snapshot().moving, "the first Stop was lost");
        world.advance(Duration::from_millis(1500));
        assert!(!world.device.snapshot().moving, "{delay_ms} ms");
        assert_eq!(running.now().outcome, Some(Outcome::Unknown));
        assert!(received(&world, from).starts_with(&[id::STOP, id::STOP]), "{delay_ms} ms");
    }
}

#[test]
fn failed_stop_for_a_lost_holder_becomes_a_fast_stop() {
    for is_pulled in [true, false] {
        let mut world = World::calm_on(Interface::Serial, device(), Some(11_520));
        run(&mut world, home());
        let a = token(&mut world, TakeLease { on_loss_moving: Some(OnLossMoving::Stop), ..wish("a") });
        submit_with(&mut world, move_to(5.0, 5.0), a.clone()).unwrap();
        world.advance(Duration::from_millis(300));
        world.device.apply(world.now, Change::Fault { kind: FaultKind::NoReply, id: Some(id::STOP), times: 3 });
        let from = mark(&world);
        lose(&mut world, a.unwrap());
        world.advance(Duration::from_millis(50));
        assert!(received(&world, from).contains(&id::STOP) && world.device.snapshot().moving);
        assert!(state(&world).latch.is_none());
        if is_pulled {
            world.disconnected("pulled");
        }
        world.advance(Duration::from_secs(4));
        assert!(!world.device.snapshot().moving, "{is_pulled}");
        assert_eq!(latch(&world).fast_stop_cause, FastStopCause::ClientLost);
        assert!(latch(&world).fast_stop_confirmed);
    }
}

#[test]
fn lease_released_on_a_lost_link_stops_the_motion_afterwards() {
    let mut world = World::calm_on(Interface::Serial, device(), Some(11_520));
    run(&mut world, home());
    let a = token(&mut world, wish("a"));
    submit_with(&mut world, move_to(5.0, 5.0), a.clone()).unwrap();
    world.advance(Duration::from_millis(300));
    let from = mark(&world);
    world.disconnected("pulled");
    assert!(!release(&mut world, a).held && world.device.snapshot().moving);
    world.advance(Duration::from_secs(1));
    let mut sent = received(&world, from);
    sent.retain(|frame_id| *frame_id == id::STOP);
    assert_eq!(sent, [id::STOP]);
    assert!(!world.device.snapshot().moving && state(&world).latch.is_none());
}

#[test]
fn holder_lost_on_an_unresponsive_link_triggers_a_fast_stop() {
    let (mut world, a, _) = silent_motion(OnLossMoving::Stop);
    world.advance(Duration::from_secs(2));
    assert_eq!(state(&world).link, Link::Unresponsive);
    lose(&mut world, a);
    assert_eq!(latch(&world).fast_stop_cause, FastStopCause::ClientLost);
}

#[test]
fn holder_chooses_the_fate_of_its_motion() {
    for (choice, sent, outcome) in [
        (OnLossMoving::Stop, vec![id::STOP], Outcome::Aborted),
        (OnLossMoving::Finish, NOTHING.to_vec(), Outcome::Success),
        (OnLossMoving::FastStop, vec![id::FAST_STOP], Outcome::Aborted),
    ] {
        let mut world = homed();
        let a = token(&mut world, TakeLease { on_loss_moving: Some(choice), ..wish("a") });
        let running = submit_with(&mut world, move_to(80.0, 20.0), a.clone()).unwrap();
        world.advance(Duration::from_millis(300));
        let from = mark(&world);
        lose(&mut world, a.unwrap());
        assert_eq!(finish(&mut world, &running).outcome, Some(outcome), "{choice:?}");
        world.advance(Duration::from_secs(1));
        assert_eq!(received(&world, from), sent, "{choice:?}");
        assert_eq!(lease(&mut world).reserved_for, None, "nothing is held: {choice:?}");
    }
}
