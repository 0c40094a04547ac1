//! The lease: the right to move the gripper, and the effects of losing its holder.

mod losing;
mod returning;

use std::pin::Pin;
use std::sync::{Arc, OnceLock};
use std::task::{Context, Wake};
use std::time::Duration;

use gripper::handle::ActorRequest;
use gripper::{AcquiredLease, Conflict, Rejection, Ticket};
use model::{
    Action, Client, Door, FastStopCause, HolderName, Lease, LeaseToken, LossCause, Motion, OnLossHolding, OnLossMoving,
    Outcome, State, Submission, TakeLease,
};
use sim::Change;
use tokio::sync::{oneshot, watch};
use wsg::{self, Acceleration, Speed, Width, id};

use super::NOTHING;
use super::steps::*;
use crate::seeds::world::World;

const TTL: Duration = Duration::from_millis(500);

fn wish(holder: &str) -> TakeLease {
    let client = Client::new(format!("http:{holder}"), Door::Http);
    TakeLease { holder: HolderName::new(holder).ok(), ttl: Some(TTL), ..TakeLease::by(client) }
}

/// Lets a motion finish when the holder is lost.
fn finish_moving(wish: TakeLease) -> TakeLease {
    TakeLease { on_loss_moving: Some(OnLossMoving::Finish), ..wish }
}

fn take(world: &mut World, take: TakeLease) -> Result<AcquiredLease, Rejection> {
    let token = LeaseToken::generate();
    request(world, |answer| ActorRequest::TakeLease { take, token, answer }).try_recv().unwrap()
}

/// Takes the lease and closes the request, so that only the time to live keeps it.
fn token(world: &mut World, wish: TakeLease) -> Option<LeaseToken> {
    let granted = take(world, wish).unwrap();
    close(world, granted.keep);
    granted.lease.token
}

/// Keeps the state that was published when a client was woken by its answer.
struct WokenIn {
    published: watch::Receiver<Arc<State>>,
    state: OnceLock<Arc<State>>,
}

impl Wake for WokenIn {
    fn wake(self: Arc<Self>) {
        let state = Arc::clone(&self.published.borrow());
        self.state.set(state).unwrap();
    }
}

#[test]
fn answer_follows_the_published_state() {
    let mut world = world();
    let client = Arc::new(WokenIn { published: world.watches.state.clone(), state: OnceLock::new() });
    let (answer, mut answered) = oneshot::channel();
    let waker = Arc::clone(&client).into();
    assert!(Pin::new(&mut answered).poll(&mut Context::from_waker(&waker)).is_pending());
    let now = world.clock();
    let take = ActorRequest::TakeLease { take: wish("plc"), token: LeaseToken::generate(), answer };
    world.actor.request(now, take);
    answered.try_recv().unwrap().unwrap();
    assert_eq!(client.state.get().unwrap().lease_holder.as_deref(), Some("plc"));
}

/// Closes a request that kept the lease.
fn close<T>(world: &mut World, open: T) {
    drop(open);
    let now = world.clock();
    world.actor.lease_request_closed(now);
    world.settle();
}

fn lease(world: &mut World) -> Lease {
    request(world, |answer| ActorRequest::Lease { answer }).try_recv().unwrap()
}

fn submit_with(world: &mut World, motion: Motion, lease: Option<LeaseToken>) -> Result<Ticket, Rejection> {
    let now = world.clock();
    let id = world.ids.command_id(now.wall);
    let frame = motion.request();
    let submission =
        Submission { client: client(), action: Action::Motion(motion), request_id: None, lease: lease.clone() };
    let (answer, mut answered) = oneshot::channel();
    world.actor.request(now, ActorRequest::Submit { submission, id, answer });
    let ticket = answered.try_recv().unwrap()?;
    world.clients.admitted.push(crate::seeds::client::Admitted {
        ticket: ticket.watched(),
        motion: Some(frame),
        lease,
    });
    world.settle();
    Ok(ticket)
}

fn release(world: &mut World, token: Option<LeaseToken>) -> Lease {
    request(world, |answer| ActorRequest::ReleaseLease { token, answer }).try_recv().unwrap()
}

/// Lets a holder grip the part, then loses the holder.
fn lose_while_holding(world: &mut World, wish: TakeLease) {
    let token = token(world, wish);
    let held = submit_with(world, grip(None), token).unwrap();
    finish(world, &held);
    close(world, held);
    world.advance(TTL * 2);
}

fn fast_stops(world: &World, from: usize) -> usize {
    received(world, from).into_iter().filter(|id| *id == id::FAST_STOP).count()
}

#[test]
fn stale_lease_moves_nothing() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    world.advance(TTL + Duration::from_millis(10));
    let b = token(&mut world, wish("b"));
    let from = mark(&world);
    let rejection = submit_with(&mut world, move_to(50.0, 50.0), a.clone()).unwrap_err();
    assert_eq!(rejection, Conflict::StaleLease { epoch: 2, holder: Some("b".into()) }.into());
    let acceleration = wsg::Command::SetAcceleration(Acceleration::new(500.0).unwrap());
    let mut set = request(&mut world, |answer| ActorRequest::Exchange {
        command: acceleration,
        client: client(),
        lease: a,
        answer: (None, answer),
    });
    assert!(matches!(set.try_recv().unwrap(), Err(Rejection::Conflict(Conflict::StaleLease { .. }))));
    world.advance(Duration::from_millis(200));
    assert_eq!(received(&world, from), NOTHING);
    assert!(submit_with(&mut world, move_to(50.0, 50.0), b).is_ok());
}

#[test]
fn lease_held_names_the_holder_and_its_remaining_time() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    world.advance(Duration::from_millis(100));
    let held = Conflict::LeaseHeld { holder: "a".into(), expires_in_ms: 400 };
    assert_eq!(refused(&mut world, move_to(50.0, 50.0)), held.clone().into());
    assert_eq!(take(&mut world, wish("b")).unwrap_err(), held.into());
    let current = lease(&mut world);
    assert_eq!((current.held, current.holder.as_deref(), current.epoch, current.token), (true, Some("a"), 1, None));
    assert_eq!((current.ttl_ms, current.expires_in_ms), (Some(500), Some(400)));
    assert_eq!((state(&world).lease_holder.as_deref(), state(&world).lease_epoch), (Some("a"), 1));
    // Reads need no lease.
    let mut read = exchange(&mut world, wsg::Command::GetAcceleration);
    world.advance(Duration::from_millis(100));
    assert!(read.try_recv().unwrap().is_ok());
    assert!(submit_with(&mut world, move_to(50.0, 50.0), a).is_ok());
}

#[test]
fn holder_lost_with_a_part_leaves_it_held_and_reserved() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    let held = submit_with(&mut world, grip(None), a).unwrap();
    assert_eq!(finish(&mut world, &held).outcome, Some(Outcome::PartHeld));
    close(&mut world, held);
    let from = mark(&world);
    world.advance(TTL * 4);
    assert_eq!((received(&world, from), state(&world).fast_stop), (NOTHING.to_vec(), Some(false)));
    let current = lease(&mut world);
    assert_eq!((current.held, current.reserved_for.as_deref()), (false, Some("a")));
    let reserved = Conflict::Reserved { holder: "a".into() };
    assert_eq!(refused(&mut world, move_to(50.0, 50.0)), reserved.clone().into());
    assert_eq!(take(&mut world, wish("b")).unwrap_err(), reserved.into());
    // The same holder name from another peer is a different client.
    let elsewhere = TakeLease { client: client(), ..wish("a") };
    assert!(take(&mut world, elsewhere).is_err());
    assert!(take(&mut world, wish("a")).is_ok());
}

#[test]
fn supervisor_can_take_a_reserved_gripper() {
    let mut world = homed();
    lose_while_holding(&mut world, wish("a"));
    assert!(take(&mut world, TakeLease { force: true, ..wish("b") }).is_ok());
}

#[test]
fn removed_part_ends_the_reservation() {
    let mut world = homed();
    lose_while_holding(&mut world, wish("a"));
    world.device.apply(world.now, Change::TakePart);
    world.advance(Duration::from_secs(1));
    assert_eq!(lease(&mut world).reserved_for, None);
    assert!(take(&mut world, wish("b")).is_ok());
}

#[test]
fn acknowledged_fast_stop_ends_the_reservation_of_a_held_part() {
    for (device, stopped_first) in
        [(device(), true), (device(), false), (device().fw2(), true), (device().fw2(), false)]
    {
        let mut world = World::calm(device, None);
        run(&mut world, home());
        let a = token(&mut world, wish("a"));
        let held = submit_with(&mut world, grip(None), a.clone()).unwrap();
        assert_eq!(finish(&mut world, &held).outcome, Some(Outcome::PartHeld));
        let lose = |world: &mut World| {
            let token = a.clone().unwrap();
            drop(request(world, |_: oneshot::Sender<()>| ActorRequest::LoseLease {
                token,
                times_taken: None,
                cause: LossCause::Disconnected,
            }));
        };
        if !stopped_first {
            lose(&mut world);
        }
        let stopped = fast_stop(&mut world);
        world.advance(Duration::from_millis(200));
        if stopped_first {
            lose(&mut world);
        }
        assert_eq!(lease(&mut world).reserved_for.as_deref(), Some("a"), "{stopped_first}");
        let release = Motion::Release { width: Width::new(60.0).unwrap(), speed: Speed::new(50.0).unwrap() };
        assert!(matches!(refused(&mut world, release), Rejection::Conflict(Conflict::FastStop { .. })));
        let mut cleared = acknowledge(&mut world, stopped);
        world.advance(Duration::from_millis(200));
        assert_eq!(cleared.try_recv().unwrap(), Ok(()));
        assert_eq!(lease(&mut world).reserved_for, None, "no force holds the part");
        world.restart();
        world.advance(Duration::from_secs(1));
        let latched = state(&world).latch.map(|latch| latch.fast_stop_id);
        if let Some(id) = latched {
            let mut cleared = acknowledge(&mut world, id);
            world.advance(Duration::from_millis(200));
            assert_eq!(cleared.try_recv().unwrap(), Ok(()));
        }
        assert!(take(&mut world, wish("b")).is_ok());
    }
}

#[test]
fn release_stops_a_running_motion_and_latches_nothing() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    let running = submit_with(&mut world, move_to(5.0, 10.0), a.clone()).unwrap();
    world.advance(Duration::from_millis(300));
    let from = mark(&world);
    let stale = release(&mut world, Some("another".into()));
    assert!(stale.held, "a stale token releases nothing");
    assert!(!release(&mut world, a.clone()).held);
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Aborted));
    world.advance(TTL * 2);
    assert_eq!((received(&world, from), state(&world).fast_stop), (vec![id::STOP], Some(false)));
    assert!(!release(&mut world, a).held);
}

#[test]
fn open_request_keeps_the_lease_during_a_long_motion() {
    let mut world = homed();
    let a = token(&mut world, wish("plc"));
    let running = submit_with(&mut world, move_to(85.0, 5.0), a).unwrap();
    world.advance(Duration::from_secs(3));
    assert_eq!(lease(&mut world).expires_in_ms, Some(500));
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Success));
    assert!(running.now().duration_ms.unwrap() > 4000);
    // The time to live runs from the answer.
    close(&mut world, running);
    world.advance(Duration::from_millis(480));
    assert!(lease(&mut world).held);
    world.advance(Duration::from_millis(30));
    assert!(!lease(&mut world).held);
    assert_eq!(state(&world).fast_stop, Some(false));
}

#[test]
fn time_to_live_begins_with_the_end_of_a_request_whose_notice_is_late() {
    let mut world = homed();
    let a = token(&mut world, wish("plc"));
    let running = submit_with(&mut world, move_to(85.0, 5.0), a).unwrap();
    world.advance(TTL + Duration::from_millis(500));
    drop(running);
    let now = world.clock();
    world.actor.handle_timeout(now);
    assert_eq!(lease(&mut world).expires_in_ms, Some(500));
    assert_eq!(state(&world).fast_stop, Some(false));
}

#[test]
fn stall_of_the_gateway_extends_the_lease_once() {
    let mut world = homed();
    token(&mut world, wish("a"));
    let oversleep = |world: &mut World| {
        let now = world.clock();
        world.actor.after_stall(now);
    };
    world.advance(TTL * 9 / 10);
    oversleep(&mut world);
    world.advance(Duration::from_millis(190));
    assert!(lease(&mut world).held, "a renewal may be on its way");
    oversleep(&mut world);
    world.advance(Duration::from_millis(20));
    assert!(!lease(&mut world).held, "the grace applies once");
}

#[test]
fn holder_chooses_the_fate_of_a_held_part() {
    let mut world = homed();
    lose_while_holding(&mut world, TakeLease { on_loss_holding: Some(OnLossHolding::FastStop), ..wish("a") });
    assert_eq!(latch(&world).fast_stop_cause, FastStopCause::ClientLost);
    assert_eq!(lease(&mut world).reserved_for, None);
}

#[test]
fn lease_is_handed_over_to_the_first_requester() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    for (holder, place) in [("b", 1), ("c", 2), ("b", 1)] {
        let waiting = take(&mut world, TakeLease { request: true, ..wish(holder) }).unwrap_err();
        assert_eq!(waiting, Conflict::LeaseRequested { holder: "a".into(), place }.into());
    }
    assert_eq!(lease(&mut world).requested_by.as_deref(), Some("b"), "the first request wins");
    let hand_over = |to: &str, token: Option<LeaseToken>| {
        let to = to.to_owned();
        move |answer| ActorRequest::HandOver { token, to, new: LeaseToken::generate(), answer }
    };
    let mut wrong = request(&mut world, hand_over("c", a.clone()));
    assert!(matches!(wrong.try_recv().unwrap(), Err(Rejection::Invalid(_))));
    let mut right = request(&mut world, hand_over("b", a.clone()));
    let current = right.try_recv().unwrap().unwrap();
    assert_eq!((current.holder.as_deref(), current.epoch, current.token), (Some("b"), 2, None));
    assert!(submit_with(&mut world, move_to(50.0, 50.0), a).is_err());
    assert!(take(&mut world, wish("c")).is_err());
    let b = token(&mut world, TakeLease { request: true, ..wish("b") });
    assert_eq!(lease(&mut world).epoch, 2);
    assert!(submit_with(&mut world, move_to(50.0, 50.0), b).is_ok());
}

#[test]
fn hand_over_aborts_a_waiting_motion() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    let first = submit_with(&mut world, move_to(80.0, 200.0), a.clone()).unwrap();
    finish(&mut world, &first);
    // A motion waits in the pause after the one before.
    let waiting = submit_with(&mut world, move_to(5.0, 10.0), a.clone()).unwrap();
    assert!(take(&mut world, TakeLease { request: true, ..wish("b") }).is_err());
    let from = mark(&world);
    let (to, new) = ("b".to_owned(), LeaseToken::generate());
    let mut given = request(&mut world, |answer| ActorRequest::HandOver { token: a, to, new, answer });
    assert!(given.try_recv().unwrap().is_ok());
    assert_eq!(waiting.now().outcome, Some(Outcome::Aborted));
    world.advance(Duration::from_secs(1));
    assert_eq!(received(&world, from), NOTHING);
}

#[test]
fn motion_that_has_not_started_does_not_start_under_anothers_lease() {
    for (holder, outcome) in [(client(), None), (Client::new("other", Door::Http), Some(Outcome::Aborted))] {
        let mut world = homed();
        let first = start(&mut world, move_to(80.0, 200.0));
        finish(&mut world, &first);
        // A motion waits in the pause after the one before.
        let waiting = start(&mut world, move_to(5.0, 10.0));
        take(&mut world, TakeLease { client: holder, ..wish("a") }).unwrap();
        assert_eq!(waiting.now().outcome, outcome);
    }
}

#[test]
fn grip_that_ends_after_the_loss_reserves_the_part() {
    let mut world = homed();
    let a = token(&mut world, finish_moving(wish("a")));
    let gripping = submit_with(&mut world, grip(None), a.clone()).unwrap();
    world.advance(Duration::from_millis(200));
    let lost = a.unwrap();
    drop(request(&mut world, |_: oneshot::Sender<()>| ActorRequest::LoseLease {
        token: lost,
        times_taken: None,
        cause: LossCause::Disconnected,
    }));
    assert_eq!(finish(&mut world, &gripping).outcome, Some(Outcome::PartHeld));
    let reserved = Conflict::Reserved { holder: "a".into() };
    assert_eq!(refused(&mut world, move_to(50.0, 50.0)), reserved.clone().into());
    assert_eq!(take(&mut world, wish("b")).unwrap_err(), reserved.into());
}

#[test]
fn forced_take_stops_the_motion_of_the_old_holder() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    let running = submit_with(&mut world, move_to(5.0, 10.0), a.clone()).unwrap();
    world.advance(Duration::from_millis(300));
    let from = mark(&world);
    assert!(take(&mut world, TakeLease { force: true, ..wish("b") }).is_ok());
    assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Aborted));
    assert_eq!((received(&world, from), state(&world).fast_stop), (vec![id::STOP], Some(false)));
    assert!(submit_with(&mut world, move_to(50.0, 50.0), a).is_err());
}

#[test]
fn forced_take_stops_a_motion_without_a_holder() {
    for with_holder in [true, false] {
        let mut world = homed();
        let lost = with_holder.then(|| token(&mut world, finish_moving(wish("a"))).unwrap());
        let running = submit_with(&mut world, move_to(5.0, 10.0), lost.clone()).unwrap();
        world.advance(Duration::from_millis(300));
        if let Some(token) = lost {
            drop(request(&mut world, |_: oneshot::Sender<()>| ActorRequest::LoseLease {
                token,
                times_taken: None,
                cause: LossCause::Disconnected,
            }));
        }
        assert_eq!(lease(&mut world).reserved_for.as_deref(), with_holder.then_some("a"));
        let from = mark(&world);
        assert!(take(&mut world, TakeLease { force: true, ..wish("b") }).is_ok());
        assert_eq!(finish(&mut world, &running).outcome, Some(Outcome::Aborted));
        assert_eq!((received(&world, from), state(&world).fast_stop), (vec![id::STOP], Some(false)));
    }
}

#[test]
fn epoch_and_latch_survive_a_gateway_restart() {
    let mut world = homed();
    let a = token(&mut world, wish("a"));
    let running = submit_with(&mut world, move_to(5.0, 10.0), a.clone()).unwrap();
    close(&mut world, running);
    world.advance(TTL * 2);
    let stopped = latch(&world);
    world.restart();
    assert_eq!(latch(&world).fast_stop_id, stopped.fast_stop_id);
    assert!(!latch(&world).fast_stop_confirmed);
    assert_eq!(lease(&mut world).epoch, 1);
    let from = mark(&world);
    world.advance(Duration::from_secs(1));
    assert_eq!(received(&world, from).first(), Some(&id::FAST_STOP), "the device may have lost its latch");
    let again = latch(&world);
    assert_eq!((again.fast_stop_id, again.fast_stop_cause), (stopped.fast_stop_id, FastStopCause::ClientLost));
    assert!(again.fast_stop_confirmed);
    take(&mut world, wish("b")).unwrap();
    assert_eq!(lease(&mut world).epoch, 2);
    assert!(submit_with(&mut world, home(), a).is_err());
    let mut cleared = acknowledge(&mut world, stopped.fast_stop_id);
    world.advance(Duration::from_millis(200));
    assert_eq!(cleared.try_recv().unwrap(), Ok(()));
}
