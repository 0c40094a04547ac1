//! Clients that take, use and lose the lease or use stale tokens, with an independent model of their rights.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use gripper::handle::ActorRequest;
use gripper::{Conflict, Rejection, Ticket};
use model::{
    Client, Door, HolderName, LeaseEvent, LeaseStep, LeaseToken, Link, LossCause, LossEffect, OnLossHolding,
    OnLossMoving, Phase, State, TakeLease,
};
use rand::RngExt;
use tokio::sync::oneshot;
use wsg::{Command, SystemState, Updates};

use model::lease::DEFAULT_TTL;

use super::servo::Servos;
use super::world::World;

/// A client's action on the lease.
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
    /// The client's connection ends.
    Lose,
}

/// Longest delay until an expired lease is reported.
const LATE: Duration = Duration::from_millis(50);

/// Time that the device must have moved or stood still before the gateway has to know.
const KNOWN_AFTER: Duration = Duration::from_secs(2);

/// Maximum age of the last update for the device to count as heard.
const HEARD_WITHIN: Duration = Duration::from_millis(300);

/// Time after a motion's end for which the gateway may count the fingers as moving.
const RESTS_AFTER: Duration = Duration::from_millis(300);

/// Time after a stream request during which a lost holder may count as steering. A stream is live for 1 s after its
/// last request, and a lease that expires counts as lost at its last use.
const STREAM_LASTS: Duration = Duration::from_secs(1).saturating_add(DEFAULT_TTL);

/// Subject of the client that speaks the device's protocol.
const DRIVER: &str = "wsg:10.0.0.1";

/// A client of Modbus, whose motions take a free lease, too.
const PLC: &str = "modbus:10.0.0.2";

/// Independent model of the leases.
#[derive(Default)]
pub struct Leases {
    /// All tokens ever given.
    given: Vec<LeaseToken>,
    current: Option<Current>,
    /// Open requests of the holder.
    open: Vec<Ticket>,
    /// Whether a request of the holder was answered at once, which is not reported to the gateway yet.
    is_answered: bool,
    /// Number of driver connections so far.
    drivers: usize,
    /// Tokens of the drivers that have used a script.
    scripted: Vec<LeaseToken>,
    /// `on_loss_moving` of each lease, by epoch.
    on_loss_moving: BTreeMap<u64, OnLossMoving>,
    fingers: Fingers,
}

/// Movement of the device, and the gateway's view after the last step.
#[derive(Default)]
struct Fingers {
    since: Option<(bool, Instant)>,
    reported_moving: Option<bool>,
    runs: bool,
    /// Time at which the end of the last command was noticed.
    ended: Option<Instant>,
    /// Time of the last stream request.
    streamed: Option<Instant>,
}

struct Current {
    token: LeaseToken,
    holder: &'static str,
    ttl: Duration,
    used: Instant,
}

/// Whether the gateway has a link to the device.
fn has_link(state: &State) -> bool {
    matches!(state.link, Link::Connected | Link::Unresponsive)
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
                    world.actor.request(
                        now,
                        ActorRequest::LoseLease {
                            token: current.token,
                            times_taken: None,
                            cause: LossCause::Disconnected,
                        },
                    );
                    assert_eq!(world.watches.state.borrow().lease_holder, None, "{}", world.tail());
                }
            }
        }
    }

    fn wish(world: &mut World, holder: &'static str, force: bool) -> TakeLease {
        let moving = [None, Some(OnLossMoving::FastStop), Some(OnLossMoving::Stop), Some(OnLossMoving::Finish)];
        let holding = [None, Some(OnLossHolding::Keep), Some(OnLossHolding::FastStop)];
        TakeLease {
            client: Client::new(holder, Door::Http),
            holder: HolderName::new(holder).ok(),
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
        world.actor.request(now, ActorRequest::TakeLease { take, token, answer });
        let result = answered.try_recv().expect("the decision takes no time");
        world.note(&format!("  {holder} takes the lease: {:?}", result.as_ref().map(|granted| &granted.lease)));
        let Ok(granted) = result else {
            assert!(!free || !wish.force, "force takes any free lease\n{}", world.tail());
            return;
        };
        let waited = world.leases.current.as_ref().is_some_and(|current| current.holder == holder);
        assert!(free || wish.force || waited, "held by another client\n{}", world.tail());
        assert!(granted.lease.epoch >= epoch, "the epoch decreased\n{}", world.tail());
        world.count("lease: taken", !wish.force);
        world.count("lease: forced", wish.force && !free);
        let terms = granted.lease.on_loss_moving.expect("the lease is held");
        assert!(wish.on_loss_moving.is_none_or(|wished| wished == terms), "{}", world.tail());
        world.leases.on_loss_moving.insert(granted.lease.epoch, terms);
        let token = granted.lease.token.clone().expect("the taker gets the token");
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
        world.actor.request(now, ActorRequest::TakeLease { take: wish.clone(), token: unused, answer });
        let new = LeaseToken::from(format!("token {}", world.leases.given.len()).as_str());
        let (answer, mut answered) = oneshot::channel();
        let request = ActorRequest::HandOver { token: Some(token), to: to.to_owned(), new: new.clone(), answer };
        world.actor.request(now, request);
        if answered.try_recv().expect("the decision takes no time").is_err() {
            // A failed hand-over still renews the lease.
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
        let (token, alive) = (current.token.clone(), Self::is_alive(world));
        let renewed = Self::is_renewed(world, &token);
        assert_eq!(renewed, alive, "renewal does not match the lease's life\n{}", world.tail());
        if let Some(current) = world.leases.current.as_mut().filter(|_| renewed) {
            current.used = world.now;
        }
    }

    /// Renews the lease with this token, if it holds the lease.
    fn is_renewed(world: &mut World, token: &LeaseToken) -> bool {
        let (answer, mut answered) = oneshot::channel();
        let now = world.clock();
        world.actor.request(now, ActorRequest::RenewLease { token: Some(token.clone()), answer });
        answered.try_recv().expect("the decision takes no time").is_ok()
    }

    fn release(world: &mut World, stale: bool) {
        let current = world.leases.current.as_ref().map(|current| current.token.clone());
        let token = if stale { world.leases.given.first().cloned() } else { current.clone() };
        let held = world.watches.state.borrow().lease_holder.clone();
        let (answer, mut answered) = oneshot::channel();
        let now = world.clock();
        world.actor.request(now, ActorRequest::ReleaseLease { token: token.clone(), answer });
        let lease = answered.try_recv().expect("the decision takes no time");
        if token.is_some() && token == current {
            assert!(!lease.held, "{}", world.tail());
            (world.leases.current, world.leases.open) = (None, Vec::new());
            world.count("lease: released", held.is_some());
        } else {
            assert_eq!(lease.holder, held, "a stale release changed the lease\n{}", world.tail());
        }
    }

    /// Whether the lease must still be held.
    fn is_alive(world: &World) -> bool {
        let alive = |current: &Current| !world.leases.open.is_empty() || world.now < current.used + current.ttl;
        world.leases.current.as_ref().is_some_and(alive)
    }

    /// Returns a token for a motion request: none, the current one or an old one.
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

    /// Returns a driver client with its connection's token.
    pub fn driver(world: &mut World) -> (Client, LeaseToken) {
        Self::bound(world, DRIVER, Door::Wsg)
    }

    /// Returns in turn a driver and a client of Modbus, with its connection's token.
    pub fn driver_or_plc(world: &mut World) -> (Client, LeaseToken) {
        if world.leases.drivers.is_multiple_of(2) { Self::driver(world) } else { Self::bound(world, PLC, Door::Modbus) }
    }

    /// Returns a client whose lease ends with its connection: the current holder, or a new connection.
    fn bound(world: &mut World, subject: &'static str, door: Door) -> (Client, LeaseToken) {
        let holder = world.leases.current.as_ref().filter(|current| current.holder == subject);
        let token = holder.map_or_else(
            || LeaseToken::from(format!("driver {}", world.leases.drivers).as_str()),
            |current| current.token.clone(),
        );
        world.leases.drivers += 1;
        (Client::new(subject, door), token)
    }

    /// Records that a driver has used a script, which renews the lease if the driver holds it.
    pub fn scripted(world: &mut World, token: LeaseToken) {
        Self::renewed(world, &token);
        world.leases.scripted.push(token);
    }

    /// Records a request that renews the lease if its client holds it.
    pub fn renewed(world: &mut World, token: &LeaseToken) {
        // A lease can have expired since the last step.
        let is_held = world.watches.state.borrow().lease_holder.is_some();
        if let Some(current) = world.leases.current.as_mut().filter(|current| is_held && current.token == *token) {
            current.used = world.now;
        }
    }

    /// Notices that a driver has taken the free lease, because its script has moved the fingers.
    fn notice_claim(world: &mut World) {
        let (epoch, holder) = {
            let state = world.watches.state.borrow();
            (state.lease_epoch, state.lease_holder.clone())
        };
        let is_new = !world.leases.on_loss_moving.contains_key(&epoch);
        // Tests of single steps keep no account of their drivers.
        if is_new && holder.as_deref() == Some(DRIVER) && world.leases.drivers > 0 {
            assert!(!Self::is_alive(world), "a script took a held lease\n{}", world.tail());
            // Which of several scripts has moved the fingers follows from the rights of their drivers.
            let scripted = world.leases.scripted.clone();
            let token = scripted.into_iter().find(|token| Self::is_renewed(world, token));
            world.count("lease: taken by a script", true);
            Self::claimed(world, DRIVER, &token.expect("a driver with a script holds the lease"));
        }
    }

    /// Records that a motion took the free lease.
    fn claimed(world: &mut World, holder: &'static str, token: &LeaseToken) {
        let epoch = world.watches.state.borrow().lease_epoch;
        world.leases.on_loss_moving.insert(epoch, OnLossMoving::FastStop);
        world.leases.given.push(token.clone());
        world.leases.open.clear();
        let (token, ttl) = (token.clone(), DEFAULT_TTL);
        world.leases.current = Some(Current { token, holder, ttl, used: world.now });
    }

    /// Checks the answer to a motion request.
    pub fn asked(world: &mut World, door: Door, token: Option<&LeaseToken>, result: Result<&Ticket, &Rejection>) {
        let is_new = result.is_ok_and(|ticket| !ticket.now().replayed);
        let holder = match door {
            Door::Wsg => Some(DRIVER),
            Door::Modbus => Some(PLC),
            _ => None,
        };
        if let (Some(holder), Some(token), true) = (holder, token, is_new && !Self::is_alive(world)) {
            world.count(&format!("lease: taken by a motion of {holder}"), true);
            Self::claimed(world, holder, token);
        }
        let alive = Self::is_alive(world);
        let current = world.leases.current.as_ref().map(|current| &current.token).filter(|_| alive);
        let right = token == current;
        match result {
            Ok(ticket) if !ticket.now().replayed => {
                assert!(right, "stale_lease_moves_nothing: {token:?} is not {current:?}\n{}", world.tail());
            }
            Err(Rejection::Conflict(Conflict::StaleLease { .. })) => {
                assert!(!right, "current token refused: {token:?}\n{}", world.tail());
                world.count("lease: stale token refused", true);
            }
            Err(Rejection::Conflict(Conflict::Reserved { .. })) => {
                world.count("lease: reserved", true);
            }
            Err(Rejection::Conflict(Conflict::LeaseHeld { .. })) => {
                assert!(alive, "LEASE_HELD without a holder\n{}", world.tail());
            }
            _ => {}
        }
        if let (Some(used), true) = (world.leases.current.as_mut(), right && token.is_some()) {
            used.used = world.now;
            if let Ok(ticket) = result {
                let stays_open = world.rng.random_bool(0.5);
                world.leases.open.extend(stays_open.then(|| ticket.clone()));
                world.leases.is_answered |= !stays_open;
            }
        }
    }

    /// Whether a motion admitted with this token can still be sent, because no other client holds the lease.
    pub fn may_leave(world: &World, token: Option<&LeaseToken>) -> bool {
        match (token, &world.leases.current) {
            (Some(token), Some(current)) => current.token == *token,
            _ => true,
        }
    }

    /// Ends open requests and expired leases; runs after every step.
    pub fn check(world: &mut World) {
        Self::notice_claim(world);
        let before = world.leases.open.len();
        world.leases.open.retain(|ticket| ticket.now().phase == Phase::Running);
        let is_answered = std::mem::take(&mut world.leases.is_answered);
        if world.leases.open.len() < before || is_answered {
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
            assert_eq!(holder, None, "expired lease still held\n{}", world.tail());
            world.leases.current = None;
        }
    }

    /// Reports the end of a request that kept the lease.
    fn closed<T>(world: &mut World, open: T) {
        drop(open);
        let now = world.clock();
        if world.rng.random_bool(0.2) {
            // Other work comes before the notice.
            world.actor.handle_timeout(now);
        }
        world.actor.lease_request_closed(now);
    }

    /// Checks a lease event in the journal.
    pub fn recorded(world: &mut World, event: &LeaseEvent) {
        if event.event != LeaseStep::Lost {
            return;
        }
        for (name, effect) in [
            ("FAST STOP", LossEffect::FastStop),
            ("Stop", LossEffect::Stop),
            ("motion finishes", LossEffect::Finish),
            ("part kept", LossEffect::Keep),
            ("no effect", LossEffect::None),
        ] {
            world.count(&format!("lease: holder lost, {name}"), event.effect == Some(effect));
        }
        if event.effect == Some(LossEffect::Keep) {
            Servos::keeps(world);
        }
        if event.effect == Some(LossEffect::FastStop) {
            assert!(
                world.watches.state.borrow().latch.is_some(),
                "no latch after the loss of a holder\n{}",
                world.tail()
            );
        }
        let chosen = match world.leases.on_loss_moving.get(&event.epoch) {
            Some(OnLossMoving::FastStop) => LossEffect::FastStop,
            Some(OnLossMoving::Stop) => LossEffect::Stop,
            Some(OnLossMoving::Finish) => LossEffect::Finish,
            None => return,
        };
        let moved = Self::moved(world);
        if moved == Some(true) {
            // A Stop needs a link that works.
            let may_be_harder = chosen == LossEffect::Stop && world.watches.state.borrow().link != Link::Connected;
            let chosen = if may_be_harder { event.effect } else { Some(chosen) };
            assert!(!may_be_harder || matches!(chosen, Some(LossEffect::Stop | LossEffect::FastStop)), "{chosen:?}");
            assert_eq!(event.effect, chosen, "wrong effect for moving fingers\n{}", world.tail());
        }
        if moved == Some(false) {
            // A held part can still mean a FAST STOP.
            let moving = matches!(event.effect, Some(LossEffect::Stop | LossEffect::Finish));
            assert!(!moving, "wrong effect for standing fingers: {:?}\n{}", event.effect, world.tail());
        }
        world.count("lease: holder lost, fingers moving", moved == Some(true));
        world.count("lease: holder lost, fingers standing", moved == Some(false));
    }

    /// Whether the fingers move, if the gateway must know: from the device, if it has moved for long and is heard, or
    /// from equal gateway reports before and after. `None` if unclear.
    fn moved(world: &World) -> Option<bool> {
        let state = world.watches.state.borrow();
        let fingers = &world.leases.fingers;
        let (moves, since) = fingers.since?;
        let is_long = world.now >= since + KNOWN_AFTER;
        // A device that refuses 40h still sends its other values.
        let sends_flags = world.device.snapshot().updates.contains(&Command::GetSystemState(Updates::Off).id());
        let is_heard = sends_flags && state.values.newest(world.now).is_some_and(|at| world.now < at + HEARD_WITHIN);
        let moving = state.values.has(SystemState::MOVING, world.now);
        let reported = moving.filter(|_| moving == fingers.reported_moving);
        // If the link was lost or the device is silent, the last motion may continue.
        // Just after a motion's end, the flags can be older than the end.
        let has_rested = fingers.ended.is_none_or(|at| world.now >= at + RESTS_AFTER);
        let stands = !fingers.runs && has_rested && state.command.is_none() && has_link(&state) && is_heard;
        let is_steered = fingers.streamed.is_some_and(|at| world.now < at + STREAM_LASTS);
        match (moves && is_long && is_heard, reported) {
            (true, _) => Some(true),
            (_, Some(true)) if moves || !is_steered => Some(true),
            (_, Some(false)) if stands && !is_steered => Some(false),
            _ => None,
        }
    }

    /// Records a stream request: a holder lost from now on may count as steering.
    pub fn streamed(world: &mut World) {
        world.leases.fingers.streamed = Some(world.now);
    }

    /// Updates the view of the fingers; runs after every step.
    pub fn look(world: &mut World) {
        let moves = world.device.flags().contains(SystemState::MOVING);
        let state = world.watches.state.borrow();
        let fingers = &mut world.leases.fingers;
        fingers.reported_moving = state.values.has(SystemState::MOVING, world.now);
        if fingers.runs && state.command.is_none() {
            fingers.ended = Some(world.now);
        }
        fingers.runs = state.command.is_some();
        if fingers.since.is_none_or(|(before, _)| before != moves) {
            fingers.since = Some((moves, world.now));
        }
    }
}
