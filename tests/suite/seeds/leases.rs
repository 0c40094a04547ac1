//! Clients that take the lease, use it, lose it and use old ones: what they may do is known here independently.

use std::time::{Duration, Instant};

use rand::RngExt;
use tokio::sync::oneshot;
use wsg_gateway::gripper::handle::Request;
use wsg_gateway::gripper::model::{
    Client, Door, HolderName, LeaseEvent, LeaseStep, LeaseToken, LossEffect, OnLossHolding, OnLossMoving, Phase,
    TakeLease,
};
use wsg_gateway::gripper::{Conflict, Rejection, Ticket};

use super::world::World;

/// What a client does about the lease.
#[derive(Debug, Clone, Copy)]
pub enum LeaseAsk {
    Take {
        force: bool,
    },
    HandOver,
    Renew,
    Release {
        stale: bool,
    },
    /// Its connection ends.
    Lose,
}

/// How late a lease may run out.
const LATE: Duration = Duration::from_millis(50);

/// What is known of the leases.
#[derive(Default)]
pub struct Leases {
    /// All that were ever given.
    given: Vec<LeaseToken>,
    current: Option<Current>,
    /// The open requests of its holder.
    open: Vec<Ticket>,
}

struct Current {
    token: LeaseToken,
    holder: &'static str,
    ttl: Duration,
    used: Instant,
}

impl Leases {
    pub fn act(world: &mut World, ask: LeaseAsk) {
        match ask {
            LeaseAsk::Take { force } => Self::take(world, force),
            LeaseAsk::HandOver => Self::hand_over(world),
            LeaseAsk::Renew => Self::renew(world),
            LeaseAsk::Release { stale } => Self::release(world, stale),
            LeaseAsk::Lose => {
                if let Some(current) = world.leases.current.take() {
                    world.leases.open.clear();
                    let now = world.clock();
                    world.actor.request(now, Request::LoseLease { token: current.token });
                    assert_eq!(world.watches.state.borrow().lease_holder, None, "{}", world.tail());
                }
            }
        }
    }

    fn wish(world: &mut World, holder: &'static str, force: bool) -> TakeLease {
        let moving = [None, Some(OnLossMoving::FastStop), Some(OnLossMoving::Stop), Some(OnLossMoving::Finish)];
        let holding = [None, Some(OnLossHolding::Keep), Some(OnLossHolding::FastStop)];
        TakeLease {
            client: Client { subject: holder.into(), door: Door::Http },
            holder: HolderName::new(holder),
            ttl: Some(Duration::from_millis(world.rng.random_range(100..3000))),
            on_loss_moving: moving[world.rng.random_range(0..moving.len())],
            on_loss_holding: holding[world.rng.random_range(0..holding.len())],
            force,
            request: world.rng.random_bool(0.5),
            token: None,
        }
    }

    fn take(world: &mut World, force: bool) {
        let holder = ["a", "b", "c"][world.rng.random_range(0..3)];
        let wish = Self::wish(world, holder, force);
        Self::try_take(world, holder, &wish);
    }

    fn try_take(world: &mut World, holder: &'static str, wish: &TakeLease) {
        let free = !Self::is_alive(world);
        let token = LeaseToken::from(format!("token {}", world.leases.given.len()).as_str());
        let ttl = wish.ttl.unwrap();
        let (answer, mut answered) = oneshot::channel();
        let (now, take) = (world.clock(), wish.clone());
        let epoch = world.watches.state.borrow().lease_epoch;
        world.actor.request(now, Request::TakeLease { take, token, answer });
        let result = answered.try_recv().expect("it is decided at once");
        world.note(&format!("  {holder} takes the lease: {:?}", result.as_ref().map(|granted| &granted.lease)));
        let Ok(granted) = result else {
            assert!(!free || !wish.force, "a supervisor takes any\n{}", world.tail());
            return;
        };
        let waited = world.leases.current.as_ref().is_some_and(|current| current.holder == holder);
        assert!(free || wish.force || waited, "it was held by somebody else\n{}", world.tail());
        assert!(granted.lease.epoch >= epoch, "epochs only grow\n{}", world.tail());
        world.count("lease: taken", !wish.force);
        world.count("lease: forced", wish.force && !free);
        let token = granted.lease.token.clone().expect("its taker is told");
        world.leases.given.push(token.clone());
        world.leases.open.clear();
        world.leases.current = Some(Current { token, holder, ttl, used: world.now });
        Self::closed(world, granted);
    }

    fn hand_over(world: &mut World) {
        let alive = Self::is_alive(world);
        let Some(current) = world.leases.current.as_ref().filter(|_| alive) else { return };
        let (token, from) = (current.token.clone(), current.holder);
        let to = ["a", "b", "c"].into_iter().find(|name| *name != from).unwrap();
        let mut wish = Self::wish(world, to, false);
        wish.request = true;
        let (answer, _) = oneshot::channel();
        let (now, unused) = (world.clock(), LeaseToken::from("not given"));
        world.actor.request(now, Request::TakeLease { take: wish.clone(), token: unused, answer });
        let new = LeaseToken::from(format!("token {}", world.leases.given.len()).as_str());
        let (answer, mut answered) = oneshot::channel();
        let request = Request::HandOver { token: Some(token), to: to.to_owned(), new: new.clone(), answer };
        world.actor.request(now, request);
        if answered.try_recv().expect("it is decided at once").is_err() {
            // It was a use all the same.
            if let Some(current) = &mut world.leases.current {
                current.used = world.now;
            }
            return;
        }
        world.count("lease: handed over", true);
        world.leases.given.push(new.clone());
        let ttl = wish.ttl.unwrap();
        world.leases.open.clear();
        world.leases.current = Some(Current { token: new, holder: to, ttl, used: world.now });
        Self::try_take(world, to, &wish);
    }

    fn renew(world: &mut World) {
        let Some(current) = &world.leases.current else { return };
        let (token, alive) = (Some(current.token.clone()), Self::is_alive(world));
        let (answer, mut answered) = oneshot::channel();
        let now = world.clock();
        world.actor.request(now, Request::RenewLease { token, answer });
        let renewed = answered.try_recv().expect("it is decided at once").is_ok();
        assert_eq!(renewed, alive, "a lease is renewed for as long as it lives\n{}", world.tail());
        if let Some(current) = world.leases.current.as_mut().filter(|_| renewed) {
            current.used = world.now;
        }
    }

    fn release(world: &mut World, stale: bool) {
        let current = world.leases.current.as_ref().map(|current| current.token.clone());
        let token = if stale { world.leases.given.first().cloned() } else { current.clone() };
        let held = world.watches.state.borrow().lease_holder.clone();
        let (answer, mut answered) = oneshot::channel();
        let now = world.clock();
        world.actor.request(now, Request::ReleaseLease { token: token.clone(), answer });
        let lease = answered.try_recv().expect("it is decided at once");
        if token.is_some() && token == current {
            assert!(!lease.held, "{}", world.tail());
            (world.leases.current, world.leases.open) = (None, Vec::new());
            world.count("lease: released", held.is_some());
        } else {
            assert_eq!(lease.holder, held, "releasing what isn't its any more does nothing\n{}", world.tail());
        }
    }

    /// Whether the lease must be held still.
    fn is_alive(world: &World) -> bool {
        let alive = |current: &Current| !world.leases.open.is_empty() || world.now < current.used + current.ttl;
        world.leases.current.as_ref().is_some_and(alive)
    }

    /// The token that a request for a motion comes with: none, the right one, or an old one.
    pub fn any_token(world: &mut World) -> Option<LeaseToken> {
        let current = world.leases.current.as_ref().map(|current| current.token.clone());
        match world.rng.random_range(0..10) {
            0..3 => None,
            3 if !world.leases.given.is_empty() => {
                let index = world.rng.random_range(0..world.leases.given.len());
                Some(world.leases.given[index].clone())
            }
            _ => current,
        }
    }

    /// A request for a motion was admitted, or not.
    pub fn asked(world: &mut World, token: Option<&LeaseToken>, result: Result<&Ticket, &Rejection>) {
        let alive = Self::is_alive(world);
        let current = world.leases.current.as_ref().map(|current| &current.token).filter(|_| alive);
        let right = token == current;
        match result {
            Ok(ticket) if !ticket.now().replayed => {
                assert!(right, "stale_lease_moves_nothing: {token:?} is not {current:?}\n{}", world.tail());
            }
            Err(Rejection::Conflict(Conflict::StaleLease { .. })) => {
                assert!(!right, "{token:?} is the newest\n{}", world.tail());
                world.count("lease: a stale one was refused", true);
            }
            Err(Rejection::Conflict(Conflict::LeaseHeld { expires_in_ms: None, .. })) => {
                world.count("lease: reserved", true);
            }
            Err(Rejection::Conflict(Conflict::LeaseHeld { .. })) => assert!(alive, "nobody does\n{}", world.tail()),
            _ => {}
        }
        if let (Some(used), true) = (world.leases.current.as_mut(), right && token.is_some()) {
            used.used = world.now;
            if let Ok(ticket) = result
                && world.rng.random_bool(0.5)
            {
                world.leases.open.push(ticket.clone());
            }
        }
    }

    /// Whether a motion that was admitted with this token may leave: nobody else has the lease.
    pub fn may_leave(world: &World, token: Option<&LeaseToken>) -> bool {
        match (token, &world.leases.current) {
            (Some(token), Some(current)) => current.token == *token,
            _ => true,
        }
    }

    /// After every step: requests end, and leases run out.
    pub fn check(world: &mut World) {
        let before = world.leases.open.len();
        world.leases.open.retain(|ticket| ticket.now().phase == Phase::Running);
        if world.leases.open.len() < before {
            if let Some(current) = &mut world.leases.current {
                current.used = world.now;
            }
            Self::closed(world, ());
        }
        if let Some(current) = &world.leases.current
            && world.leases.open.is_empty()
            && world.now >= current.used + current.ttl + LATE
        {
            let holder = world.watches.state.borrow().lease_holder.clone();
            assert_eq!(holder, None, "a lease runs out\n{}", world.tail());
            world.leases.current = None;
        }
    }

    /// What kept a lease is gone.
    fn closed<T>(world: &mut World, open: T) {
        drop(open);
        let now = world.clock();
        world.actor.lease_request_closed(now);
    }

    /// A lease's change was written down.
    pub fn recorded(world: &mut World, event: &LeaseEvent) {
        if event.event != LeaseStep::Lost {
            return;
        }
        for (name, effect) in [
            ("a FAST STOP", LossEffect::FastStop),
            ("a Stop", LossEffect::Stop),
            ("a motion that goes on", LossEffect::Finish),
            ("a part that is kept", LossEffect::Keep),
            ("nothing", LossEffect::None),
        ] {
            world.count(&format!("lease: a lost holder is {name}"), event.effect == Some(effect));
        }
        if event.effect == Some(LossEffect::FastStop) {
            assert!(world.watches.state.borrow().latch.is_some(), "a lost holder is a FAST STOP\n{}", world.tail());
        }
    }
}
