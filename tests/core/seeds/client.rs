//! The simulated clients: their requests, and checks of the answers.

use gripper::handle::{ActorRequest, FastStopRequest};
use gripper::{Failure, Rejection, Ticket};
use model::{
    Action, Client, Door, FastStopCause, FastStopId, LeaseToken, Motion, PartId, Reason, RequestId, Submission,
};
use rand::RngExt;
use tokio::sync::oneshot;
use wsg::{Acceleration, Command, CustomCommand, Data, Force, HomingDirection, LoopData, MoveFlags, Speed, Width, id};

use super::leases::Leases;
use super::own_changes::{Followed, OwnChanges};
use super::schedule::Ask;
use super::servo::Servos;
use super::world::{PORT_SCRIPT_ID, READ_ID, SCRIPT_ID, STREAM_ID, World};

/// An admitted command. `motion` is the only motion frame that it can cause.
pub struct Admitted {
    pub ticket: Ticket,
    pub motion: Option<Command>,
    /// Lease token of the request.
    pub lease: Option<LeaseToken>,
}

/// A request without motion, and the data that must come back, if known.
struct Exchange {
    answered: oneshot::Receiver<Result<Data, Rejection>>,
    expected: Option<Data>,
}

/// All clients of one world.
#[derive(Default)]
pub struct Clients {
    pub admitted: Vec<Admitted>,
    exchanges: Vec<Exchange>,
    acknowledges: Vec<oneshot::Receiver<Result<(), Rejection>>>,
    pub fast_stops: Vec<FastStopId>,
    last: Option<Submission>,
    submitted: u32,
    drained: Option<oneshot::Receiver<()>>,
}

fn client() -> Client {
    Client::new("test", Door::Http)
}

impl Clients {
    pub fn tickets(&self) -> impl Iterator<Item = &Ticket> {
        self.admitted.iter().map(|admitted| &admitted.ticket)
    }

    pub fn act(world: &mut World, ask: Ask) {
        world.note(&format!("ask {ask:?}"));
        match ask {
            Ask::Home => Self::submit_motion(world, Motion::Home(HomingDirection::Default)),
            Ask::Move | Ask::MoveRelative => {
                let relative = matches!(ask, Ask::MoveRelative);
                let flags = MoveFlags { relative, stop_on_block: world.rng.random_bool(0.5) };
                let range = if relative { -20.0..20.0 } else { 0.0..70.0 };
                let width = Width::new(world.rng.random_range(range)).unwrap();
                let speed = Self::next_speed(world);
                Self::submit_motion(world, Motion::Move { flags, width, speed });
            }
            Ask::Grip { with_force } => {
                let force = with_force.then(|| Force::new(world.rng.random_range(10.0..30.0)).unwrap());
                let part_id = PartId::new("4711");
                let speed = Self::next_speed(world);
                let width = Width::new(20.0).unwrap();
                Self::submit_motion(
                    world,
                    Motion::Grip { width, speed, force, part_id, recipe: None, is_reference: false },
                );
            }
            Ask::Release => {
                let speed = Self::next_speed(world);
                Self::submit_motion(world, Motion::Release { width: Width::new(60.0).unwrap(), speed });
            }
            Ask::Repeat => {
                if let Some(submission) = world.clients.last.clone() {
                    Self::submit(world, submission);
                }
            }
            Ask::Stop => Self::submit(world, submission(Action::Stop, None)),
            Ask::Cancel => Self::cancel(world),
            Ask::FastStop => Self::fast_stop(world),
            Ask::Acknowledge { stale } => Self::acknowledge(world, stale),
            Ask::Set => {
                let acceleration = Acceleration::new(world.rng.random_range(200.0..1000.0)).unwrap();
                Self::exchange(world, Command::SetAcceleration(acceleration));
            }
            Ask::Lease(ask) => Leases::act(world, ask),
            Ask::Read => Self::exchange(world, Command::GetStatistics { reset: false }),
            Ask::Loop => {
                world.clients.submitted += 1;
                let data = world.clients.submitted.to_le_bytes().to_vec();
                Self::exchange(world, Command::Loop(LoopData::new(data).unwrap()));
            }
            Ask::Custom => match world.rng.random_range(0..4) {
                0..2 => {
                    let custom = Self::next_custom(world, READ_ID);
                    Self::exchange(world, Command::Custom(custom));
                }
                2 => {
                    let custom = Self::next_custom(world, SCRIPT_ID);
                    Self::submit_motion(world, Motion::Custom(custom));
                }
                _ => {
                    let custom = Self::next_custom(world, PORT_SCRIPT_ID);
                    let (client, token) = Leases::driver(world);
                    let refused = Self::exchange_as(world, Command::Custom(custom), client, Some(token.clone())).err();
                    world.count("command: script of a driver", refused.is_none());
                    match refused {
                        None => Leases::scripted(world, token),
                        Some(Rejection::Failure(Failure::NotSent { .. })) => Leases::renewed(world, &token),
                        Some(_) => {}
                    }
                }
            },
            Ask::Servo(ask) => Servos::act(world, ask),
            Ask::Stream => {
                let custom = Self::next_custom(world, STREAM_ID);
                Self::submit_motion(world, Motion::Custom(custom));
            }
        }
    }

    /// Returns a script command with a unique payload.
    fn next_custom(world: &mut World, id: u8) -> CustomCommand {
        world.clients.submitted += 1;
        CustomCommand::new(id, world.clients.submitted.to_le_bytes().to_vec()).unwrap()
    }

    /// Returns a unique speed, so that a frame identifies its request.
    fn next_speed(world: &mut World) -> Speed {
        world.clients.submitted += 1;
        Speed::new(30.0 + world.clients.submitted as f32 / 8.0).unwrap()
    }

    fn submit_motion(world: &mut World, motion: Motion) {
        let number = world.clients.submitted;
        let request_id = world.rng.random_bool(0.5).then(|| format!("r{number}-{}", motion.kind()));
        let submission = if world.rng.random_bool(0.2) && is_never_clamped(&motion) {
            let (client, token) = Leases::driver_or_plc(world);
            Submission { client, lease: Some(token), ..submission(Action::Motion(motion), None) }
        } else {
            let lease = Leases::any_token(world);
            Submission { lease, ..submission(Action::Motion(motion), request_id) }
        };
        world.clients.last = Some(submission.clone());
        Self::submit(world, submission);
    }

    fn submit(world: &mut World, submission: Submission) {
        let motion = match &submission.action {
            Action::Motion(motion) => Some(motion.request()),
            Action::Stop => None,
        };
        let latched = world.watches.state.borrow().latch.is_some();
        let (lease, door) = (submission.lease.clone(), submission.client.door);
        let (answer, mut answered) = oneshot::channel();
        let now = world.clock();
        let id = world.ids.command_id(now.wall);
        world.actor.request(now, ActorRequest::Submit { submission, id, answer });
        let result = answered.try_recv().expect("admission takes no time");
        world.note(&format!("  {:?}", result.as_ref().map(|ticket| ticket.now().id)));
        match &result {
            _ if motion.is_some() => Leases::asked(world, door, lease.as_ref(), result.as_ref()),
            Ok(_) => Servos::stopped(world),
            Err(_) => Servos::stop_asked(world),
        }
        if let Ok(ticket) = result {
            let replayed = ticket.now().replayed;
            world.count("command: replayed", replayed);
            if !replayed {
                assert!(!latched || motion.is_none(), "a latch blocks admission\n{}", world.tail());
                let is_streamed = motion.as_ref().is_some_and(is_streamed);
                world.count("command: streamed", is_streamed);
                if is_streamed {
                    Leases::streamed(world);
                }
                let ticket = ticket.watched();
                if !is_streamed {
                    let id = motion.as_ref().map_or(id::STOP, Command::id);
                    OwnChanges::follow(world, id, Followed::Command(ticket.clone()));
                }
                world.clients.admitted.push(Admitted { ticket, motion, lease });
            }
        }
    }

    fn cancel(world: &mut World) {
        // A person also cancels what the gripper shows as its command, which can be a target of a servo session.
        let shown = world.watches.state.borrow().command.filter(|_| world.rng.random_bool(0.5));
        let newest = world.clients.admitted.last().map(|admitted| admitted.ticket.now().id);
        let Some(id) = shown.or(newest) else { return };
        Servos::stop_asked(world);
        let (answer, _) = oneshot::channel();
        let now = world.clock();
        world.actor.request(now, ActorRequest::Cancel { id, client: client(), answer });
    }

    fn fast_stop(world: &mut World) {
        if world.rng.random_bool(0.5) {
            // On a slow line these wait, and the FAST STOP must overtake them.
            Self::exchange(world, Command::GetForceLimit);
            Self::exchange(world, Command::GetSystemLimits);
            Self::exchange(world, Command::GetDeviceTag);
        }
        let now = world.clock();
        let id = world.ids.fast_stop_id(now.wall);
        world.clients.fast_stops.push(id);
        OwnChanges::follow(world, id::FAST_STOP, Followed::FastStop(id));
        world.invariants.fast_stop_requested();
        Servos::stopped(world);
        world.actor.fast_stop(
            now,
            FastStopRequest {
                id,
                client: client(),
                cause: FastStopCause::Requested,
                reason: Reason::truncated("test"),
                at: now.instant,
                epoch: None,
            },
        );
    }

    fn acknowledge(world: &mut World, stale: bool) {
        let current = world.watches.state.borrow().latch.as_ref().map(|latch| latch.fast_stop_id);
        let id = if stale { world.clients.fast_stops.first().copied() } else { current };
        let Some(id) = id else { return };
        let (answer, mut answered) = oneshot::channel();
        let now = world.clock();
        world.actor.request(now, ActorRequest::Acknowledge { id, client: client(), answer });
        if let Ok(result) = answered.try_recv() {
            assert!(result.is_err(), "an acknowledge needs the device");
        } else {
            assert_eq!(Some(id), current, "acknowledge_names_its_latch\n{}", world.tail());
            world.invariants.acknowledge_taken();
            world.clients.acknowledges.push(answered);
        }
    }

    fn exchange(world: &mut World, command: Command) {
        // A refusal is one of the outcomes.
        let _ = Self::exchange_as(world, command, client(), None);
    }

    /// Returns the rejection of a request that was refused at once.
    fn exchange_as(
        world: &mut World,
        command: Command,
        client: Client,
        lease: Option<LeaseToken>,
    ) -> Result<(), Rejection> {
        let expected = match &command {
            Command::Loop(data) => Some(Data::Loop(data.as_bytes().to_vec())),
            // The script echoes its payload.
            Command::Custom(custom) => Some(Data::Custom(custom.payload().to_vec())),
            _ => None,
        };
        let (answer, mut answered) = oneshot::channel();
        let now = world.clock();
        world.actor.request(now, ActorRequest::Exchange { command, client, lease, answer: (None, answer) });
        if let Ok(Err(rejection)) = answered.try_recv() {
            world.note(&format!("  {rejection}"));
            return Err(rejection);
        }
        world.clients.exchanges.push(Exchange { answered, expected });
        Ok(())
    }

    /// Collects the answers that have arrived.
    pub fn collect(world: &mut World) {
        let mut cleared = 0;
        world.clients.acknowledges.retain_mut(|answered| match answered.try_recv() {
            Ok(result) => {
                cleared += u64::from(result.is_ok());
                false
            }
            Err(_) => true,
        });
        *world.counts.entry("FAST STOP: acknowledged".to_owned()).or_default() += cleared;
        let (mut wrong, mut late) = (None, 0);
        world.clients.exchanges.retain_mut(|exchange| match (exchange.answered.try_recv(), &exchange.expected) {
            (Err(oneshot::error::TryRecvError::Empty), _) => true,
            // An injected fault can make the device answer a bare E_SUCCESS without data.
            (Ok(Ok(Data::Custom(nothing))), Some(_)) if nothing.is_empty() => false,
            (Ok(Ok(Data::Custom(echo))), Some(_)) if world.invariants.is_excused(&echo) => false,
            (Ok(Ok(data)), Some(expected)) if data != *expected => {
                wrong = Some((data, expected.clone()));
                false
            }
            (Ok(Err(Rejection::Failure(Failure::DeviceTimeout { .. } | Failure::NotSent { .. }))), _) => {
                late += 1;
                false
            }
            _ => false,
        });
        *world.counts.entry("request: timed out".to_owned()).or_default() += late;
        assert_eq!(wrong, None, "a late reply must not answer the next request\n{}", world.tail());
    }

    /// Whether every request has its answer.
    pub fn all_answered(&self) -> bool {
        self.exchanges.is_empty() && self.acknowledges.is_empty()
    }

    pub fn drain(world: &mut World) {
        let (answer, drained) = oneshot::channel();
        let now = world.clock();
        world.actor.request(now, ActorRequest::Drain { answer });
        world.clients.drained = Some(drained);
    }
}

/// Whether the request belongs to a stream of custom commands that steers the fingers.
pub fn is_streamed(motion: &Command) -> bool {
    motion.id() == STREAM_ID
}

/// Whether the motion is within the limits of every model, so that the frame is sent unclamped.
fn is_never_clamped(motion: &Motion) -> bool {
    match motion {
        Motion::Home(_) | Motion::Custom(_) | Motion::Release { .. } => true,
        Motion::Move { flags, width, .. } => !flags.relative && width.mm() <= 60.0,
        Motion::Grip { force, .. } => force.is_none(),
    }
}

fn submission(action: Action, request_id: Option<String>) -> Submission {
    let request_id = request_id.map(|id| RequestId::new(&id).unwrap());
    Submission { client: client(), action, request_id, lease: None }
}
