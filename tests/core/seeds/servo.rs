//! A client that steers the fingers by servo sessions, with an independent model of the targets that may be sent and of
//! the Stops that have to follow.

use std::sync::Arc;
use std::time::{Duration, Instant};

use gripper::handle::ActorRequest;
use gripper::{Conflict, Rejection};
use model::{
    Client, Detail, DeviceEvent, Door, LeaseToken, ServoAdapter, ServoAim, ServoEnd, ServoReport, ServoTarget,
    ServoTerms, State, Steer,
};
use rand::RngExt;
use sim::Change;
use tokio::sync::oneshot;
use wsg::{Force, GripperState, Speed, Width, frame, id};

use super::leases::Leases;
use super::world::{STREAM_ID, World};

/// A request of the client that steers.
#[derive(Debug, Clone, Copy)]
pub enum ServoAsk {
    Start,
    Aim,
    Follow,
    Stop,
    /// A target of a client that has not begun the session.
    AimByAnother,
}

/// Speeds of sessions in mm/s. All other motions of a schedule are faster.
const SPEEDS: std::ops::Range<f32> = 10.0..30.0;

/// Time from the end of a session to its Stop, beside that of the frame on the line.
const STOPS_WITHIN: Duration = Duration::from_millis(20);

/// Delay with which an exact timer may be noticed.
const TIMER_STEP: Duration = Duration::from_millis(1);

/// Error that rounding causes in an interpolated width, in mm.
const ROUNDING_MM: f32 = 0.01;

/// Sessions of one world.
#[derive(Default)]
pub struct Servos {
    open: Option<Session>,
    /// Number of sessions so far, and of the targets that were accepted and refused in them.
    started: u64,
    accepted: u64,
    refused: u64,
    /// Time of the newest target that left and that no Stop has followed yet.
    unstopped: Option<Instant>,
    /// Whether a target moves the fingers of the device.
    moves: bool,
    /// Time until which a Stop has to leave.
    owed_until: Option<Instant>,
    /// Time of the newest Stop or cancellation, and of the newest own end of a session.
    stop_asked: Option<Instant>,
    end_asked: Option<Instant>,
    /// Time at which a part was kept for a lost holder.
    keeps: Option<Instant>,
}

/// An open session, as its client knows it.
struct Session {
    token: Option<LeaseToken>,
    timeout: Duration,
    /// Lease when the session began: its epoch and its holder.
    lease: (u64, Option<Arc<str>>),
    /// Time until which the session is not silent.
    heard_until: Instant,
    /// Lowest and highest width of each accepted target.
    targets: Vec<(f32, f32)>,
    /// Number of targets that can no longer leave, because a newer one has left.
    passed: usize,
    /// Whether widths on the way to a target are sent.
    is_ramped: bool,
}

fn client() -> Client {
    Client::new("steers", Door::Http)
}

fn lease_of(state: &State) -> (u64, Option<Arc<str>>) {
    (state.lease_epoch, state.lease_holder.clone())
}

impl Servos {
    pub fn act(world: &mut World, ask: ServoAsk) {
        match ask {
            ServoAsk::Start => Self::start(world),
            ServoAsk::Aim => {
                let aim = ServoAim::Width(Self::next_width(world));
                Self::aim(world, aim);
            }
            ServoAsk::Follow => {
                let count = world.rng.random_range(1..10);
                let widths: Vec<_> = (0..count).map(|_| Self::next_width(world)).collect();
                let step = Duration::from_millis(world.rng.random_range(1..2000) / count);
                Self::aim(world, ServoAim::Widths(widths.into(), step.max(Duration::from_millis(1))));
            }
            ServoAsk::Stop => {
                let token = Self::token(world);
                world.servos.end_asked = Some(world.now);
                let is_open = world.servos.open.is_some();
                let ended = Self::steer(world, Steer::Stop, client(), token);
                assert!(!is_open || ended.is_ok(), "the client cannot end its session: {ended:?}\n{}", world.tail());
            }
            ServoAsk::AimByAnother => {
                let token = Self::token(world);
                let width = Self::next_width(world);
                let target = ServoTarget { aim: ServoAim::Width(width), speed: None, at: None };
                let refused = Self::steer(world, Steer::Aim(target), Client::new("another", Door::Http), token);
                let is_right = matches!(refused, Err(Rejection::Conflict(Conflict::NoServo { ended: None })));
                assert!(is_right, "another client steers: {refused:?}\n{}", world.tail());
            }
        }
    }

    fn next_width(world: &mut World) -> Width {
        Width::new(world.rng.random_range(5.0..60.0)).unwrap()
    }

    fn token(world: &World) -> Option<LeaseToken> {
        world.servos.open.as_ref().and_then(|session| session.token.clone())
    }

    fn steer(
        world: &mut World,
        request: Steer,
        client: Client,
        token: Option<LeaseToken>,
    ) -> Result<ServoReport, Rejection> {
        let (answer, mut answered) = oneshot::channel();
        let now = world.clock();
        let lease = token.clone();
        world.actor.request(now, ActorRequest::Steer { request, client, lease, answer });
        if let Some(token) = token {
            Leases::renewed(world, &token);
        }
        let result = answered.try_recv().expect("the decision takes no time");
        if let Err(rejection) = &result {
            world.note(&format!("  {rejection}"));
        }
        result
    }

    fn start(world: &mut World) {
        let token = Leases::any_token(world);
        let adapters = [ServoAdapter::WidthSpeed, ServoAdapter::PositionPd, ServoAdapter::Moves];
        let adapter = adapters[world.rng.random_range(0..adapters.len())];
        let has_force = adapter == ServoAdapter::PositionPd || world.rng.random_bool(0.2);
        let terms = ServoTerms {
            adapter: Some(adapter),
            timeout: Duration::from_millis(world.rng.random_range(20..500)),
            max_speed: Speed::new(world.rng.random_range(SPEEDS)).unwrap(),
            force: has_force.then(|| Force::new(world.rng.random_range(10.0..30.0)).unwrap()),
        };
        let timeout = terms.timeout;
        world.note(&format!("  {terms:?}"));
        let was_open = world.servos.open.is_some();
        let started = Self::steer(world, Steer::Start(terms), client(), token.clone());
        world.count("servo: refused to start", started.is_err());
        if started.is_err() {
            return;
        }
        assert!(!was_open, "two sessions at once\n{}", world.tail());
        let state = world.watches.state.borrow().clone();
        assert!(state.latch.is_none(), "latch_blocks_motion\n{}", world.tail());
        Leases::streamed(world);
        world.count(&format!("servo: started with {}", adapter.name()), true);
        world.servos.started += 1;
        // From now on, targets may move the fingers.
        world.servos.owed_until = None;
        world.servos.open = Some(Session {
            token,
            timeout,
            lease: lease_of(&state),
            heard_until: world.now,
            targets: Vec::new(),
            passed: 0,
            is_ramped: adapter == ServoAdapter::PositionPd,
        });
    }

    fn aim(world: &mut World, aim: ServoAim) {
        let token = Self::token(world);
        let offset_ms = world.rng.random_range(-300..300);
        let now = world.clock();
        let at = world.rng.random_bool(0.3).then(|| now.wall + jiff::SignedDuration::from_millis(offset_ms));
        let begins = match (&aim, at) {
            (ServoAim::Widths(..), Some(_)) if offset_ms >= 0 => now.instant + Duration::from_millis(offset_ms as u64),
            (ServoAim::Widths(..), Some(_)) => {
                now.instant.checked_sub(Duration::from_millis(offset_ms.unsigned_abs())).unwrap()
            }
            _ => now.instant,
        };
        let (range, ends) = match &aim {
            ServoAim::Width(width) => ((width.mm(), width.mm()), now.instant),
            ServoAim::Widths(widths, step) => {
                let lowest = widths.iter().map(|width| width.mm()).fold(f32::MAX, f32::min);
                let highest = widths.iter().map(|width| width.mm()).fold(f32::MIN, f32::max);
                ((lowest, highest), begins + *step * (widths.len() as u32 - 1))
            }
        };
        let is_series = matches!(aim, ServoAim::Widths(..));
        let target = ServoTarget { aim, speed: None, at };
        let result = Self::steer(world, Steer::Aim(target), client(), token);
        let tail = if result.is_ok() && world.servos.open.is_none() { world.tail() } else { String::new() };
        world.count("servo: series accepted", result.is_ok() && is_series);
        let servos = &mut world.servos;
        match (&result, &mut servos.open) {
            (Ok(_), Some(session)) => {
                session.heard_until = now.instant.max(ends);
                session.targets.push(range);
                servos.accepted += 1;
                Leases::streamed(world);
            }
            (Ok(_), None) => panic!("a target was accepted without a session\n{tail}"),
            (Err(Rejection::Conflict(Conflict::NoServo { .. })), _) => {}
            (Err(_), _) => servos.refused += 1,
        }
    }

    /// Notes a Stop that a client has sent with success, or a FAST STOP: the session is over.
    pub fn stopped(world: &mut World) {
        world.servos.stop_asked = Some(world.now);
        Self::ended(world);
    }

    /// Notes a request that may end the session.
    pub fn stop_asked(world: &mut World) {
        world.servos.stop_asked = Some(world.now);
    }

    /// Notes that a part is kept for a lost holder.
    pub fn keeps(world: &mut World) {
        world.servos.keeps = Some(world.now);
    }

    /// Notes the end of the connection, which ends the session.
    pub fn disconnected(world: &mut World) {
        Self::ended(world);
        (world.servos.unstopped, world.servos.owed_until) = (None, None);
    }

    /// Notes a frame that moves or stops the fingers in another way.
    pub fn superseded(&mut self) {
        (self.unstopped, self.owed_until) = (None, None);
    }

    fn ended(world: &mut World) {
        if world.servos.open.take().is_some() && world.servos.unstopped.is_some() {
            world.servos.owed_until = Some(world.now + STOPS_WITHIN + world.longest_frame());
        }
    }

    /// Width and speed in the frame of a target.
    fn target_of(&self, id: u8, payload: &[u8]) -> Option<(f32, f32)> {
        let float = |from: usize| Some(f32::from_le_bytes(payload.get(from..from + 4)?.try_into().ok()?));
        let (width, speed) = (float(1)?, float(5)?);
        let is_target = match id {
            STREAM_ID => self.started > 0,
            id::PRE_POSITION => self.started > 0 && SPEEDS.contains(&speed),
            _ => false,
        };
        is_target.then_some((width, speed))
    }

    /// Checks a frame that leaves. Returns whether it has a target of a session.
    pub fn sent(world: &mut World, bytes: &[u8]) -> bool {
        let payload = &bytes[frame::HEADER_BYTES..bytes.len() - 2];
        let Some((width, _)) = world.servos.target_of(bytes[3], payload) else { return false };
        let tail = world.tail();
        let Some(session) = &mut world.servos.open else { panic!("no_target_without_a_session\n{tail}") };
        let is_ramped = session.is_ramped;
        let matches = |(lowest, highest): &(f32, f32)| {
            is_ramped || (lowest - ROUNDING_MM..=highest + ROUNDING_MM).contains(&width)
        };
        let found = session.targets[session.passed..].iter().position(matches);
        let Some(found) = found else { panic!("newest_target_wins: {width} mm was overtaken\n{tail}") };
        session.passed += if is_ramped { 0 } else { found };
        world.servos.unstopped = Some(world.now);
        world.count("servo: target sent", true);
        true
    }

    /// Carries out the targets that the device has received since it had received this number of frames.
    pub fn carry_out(world: &mut World, received_before: u64) {
        let new = (world.device.snapshot().received_frames - received_before) as usize;
        let all = world.device.received();
        let frames = &all[all.len() - new.min(all.len())..];
        let targets: Vec<_> = frames
            .iter()
            .filter_map(|frame| Some((frame.id, world.servos.target_of(frame.id, &frame.payload)?)))
            .collect();
        for (id, (width, speed)) in targets {
            let was_moving = world.device.snapshot().moving;
            if id == STREAM_ID && !was_moving {
                let change =
                    Change::MoveBySomebody { width_mm: width.into(), speed_mm_s: speed.max(SPEEDS.start).into() };
                world.device.apply(world.now, change);
                world.servos.moves = true;
            }
            world.servos.moves |= id == id::PRE_POSITION;
        }
    }

    /// Checks the session after every step.
    pub fn check(world: &mut World) {
        world.servos.moves &= world.device.snapshot().moving;
        let state = world.watches.state.borrow().clone();
        let is_open = state.servo.as_ref().is_some_and(|servo| servo.open);
        if let Some(session) = &world.servos.open {
            let silent_at = session.heard_until + session.timeout;
            assert!(!is_open || world.now <= silent_at + TIMER_STEP, "silence_stops\n{}", world.tail());
            let has_lease = session.lease == lease_of(&state);
            assert!(!is_open || has_lease, "the session outlives its lease\n{}", world.tail());
            if !is_open {
                Self::check_end(world, &state);
            }
        } else {
            assert!(!is_open, "stop_ends_the_session\n{}", world.tail());
        }
        Self::check_owed(world, &state);
    }

    /// Checks the reason of an end that the client's model does not know yet.
    fn check_end(world: &mut World, state: &State) {
        let Some(session) = &world.servos.open else { return };
        let now = Some(world.now);
        let why = state.servo.as_ref().and_then(|servo| servo.ended).expect("an ended session has a reason");
        let is_right = match why {
            ServoEnd::Ended => now == world.servos.end_asked,
            ServoEnd::Silence => world.now >= session.heard_until + session.timeout,
            ServoEnd::Stop => now == world.servos.stop_asked,
            ServoEnd::FastStop => state.latch.is_some(),
            ServoEnd::Lease => session.lease != lease_of(state),
            ServoEnd::Device => true,
            ServoEnd::Link => !world.is_connected(),
        };
        assert!(is_right, "the session ended by {why:?}\n{}", world.tail());
        world.note(&format!("  the session ended by {why:?}"));
        world.count(&format!("servo: ended by {}", why.name()), true);
        Self::ended(world);
        if now == world.servos.keeps {
            world.servos.superseded();
        }
    }

    fn check_owed(world: &mut World, state: &State) {
        let holds = state.values.state(world.now) == Some(GripperState::Holding);
        if state.latch.is_some() || holds {
            world.servos.owed_until = None;
        }
        if world.servos.owed_until.is_some_and(|until| world.now > until) {
            assert!(!world.servos.moves, "silence_stops: fingers move without a session\n{}", world.tail());
            world.servos.owed_until = None;
        }
    }

    /// Checks the records of all sessions, once everything has come to rest.
    pub fn at_rest(world: &World) {
        let mut begun = 0;
        let mut over = 0;
        let mut all_accepted = 0;
        let mut all_refused = 0;
        for event in &world.journal.events {
            match event {
                Detail::Device(DeviceEvent::ServoStarted { .. }) => begun += 1,
                Detail::Device(DeviceEvent::ServoEnded { accepted, refused, .. }) => {
                    over += 1;
                    all_accepted += accepted;
                    all_refused += refused;
                }
                _ => {}
            }
        }
        let servos = &world.servos;
        assert_eq!(begun, servos.started, "each session has a record of its beginning\n{}", world.tail());
        assert_eq!(over, servos.started, "each session has a record of its end\n{}", world.tail());
        assert_eq!(all_accepted, servos.accepted, "each accepted target is counted\n{}", world.tail());
        assert_eq!(all_refused, servos.refused, "each refused target is counted\n{}", world.tail());
    }
}
