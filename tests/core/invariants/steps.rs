//! Steps of the invariant tests: client requests, and views of their effects.

use std::time::Duration;

use gripper::handle::{ActorRequest, FastStopRequest, ResultSender};
use gripper::{Rejection, Ticket};
use model::{
    Action, Client, CommandReport, Door, FastStopCause, FastStopId, LatchFields, MeasuredFields, Motion, Outcome,
    Phase, Reason, RequestId, State, Submission,
};
use sim::{DeviceConfig, Part};
use tokio::sync::oneshot;
use wsg::{self, Force, HomingDirection, MoveFlags, Speed, Width, id};

use crate::seeds::world::World;

pub fn client() -> Client {
    Client::new("test", Door::Http)
}

/// A WSG 50 with a part of 20 mm.
pub fn device() -> DeviceConfig {
    DeviceConfig::wsg50().with_part(Part::outside(20.0))
}

pub fn world() -> World {
    World::calm(device(), None)
}

pub fn homed() -> World {
    let mut world = world();
    assert_eq!(run(&mut world, home()).outcome, Some(Outcome::Success));
    world
}

pub fn home() -> Motion {
    Motion::Home(HomingDirection::Default)
}

pub fn grip(force_n: Option<f32>) -> Motion {
    let force = force_n.map(|n| Force::new(n).unwrap());
    Motion::Grip {
        width: Width::new(20.0).unwrap(),
        speed: Speed::new(50.0).unwrap(),
        force,
        part_id: None,
        recipe: None,
        is_reference: false,
    }
}

pub fn move_to(mm: f32, mm_s: f32) -> Motion {
    let flags = MoveFlags { relative: false, stop_on_block: true };
    Motion::Move { flags, width: Width::new(mm).unwrap(), speed: Speed::new(mm_s).unwrap() }
}

pub fn request<T>(world: &mut World, make: impl FnOnce(oneshot::Sender<T>) -> ActorRequest) -> oneshot::Receiver<T> {
    let (answer, answered) = oneshot::channel();
    let now = world.clock();
    world.actor.request(now, make(answer));
    world.settle();
    answered
}

pub fn submit(world: &mut World, action: Action, request_id: Option<&str>) -> Result<Ticket, Rejection> {
    let request_id = request_id.map(|id| RequestId::new(id).unwrap());
    let now = world.clock();
    let id = world.ids.command_id(now.wall);
    let motion = match &action {
        Action::Motion(motion) => Some(motion.request()),
        Action::Stop => None,
    };
    let submission = Submission { client: client(), action, request_id, lease: None };
    let (answer, mut answered) = oneshot::channel();
    world.actor.request(now, ActorRequest::Submit { submission, id, answer });
    let ticket = answered.try_recv().unwrap()?;
    world.clients.admitted.push(crate::seeds::client::Admitted { ticket: ticket.clone(), motion, lease: None });
    world.settle();
    Ok(ticket)
}

pub fn start(world: &mut World, motion: Motion) -> Ticket {
    submit(world, Action::Motion(motion), None).unwrap()
}

pub fn refused(world: &mut World, motion: Motion) -> Rejection {
    submit(world, Action::Motion(motion), None).unwrap_err()
}

pub fn run(world: &mut World, motion: Motion) -> CommandReport {
    let ticket = start(world, motion);
    finish(world, &ticket)
}

pub fn finish(world: &mut World, ticket: &Ticket) -> CommandReport {
    for _ in 0..9000 {
        if ticket.now().phase == Phase::Done {
            return ticket.now();
        }
        world.advance(Duration::from_millis(10));
    }
    panic!("the command does not end: {:#?}", ticket.now());
}

pub fn fast_stop(world: &mut World) -> FastStopId {
    let now = world.clock();
    let id = world.ids.fast_stop_id(now.wall);
    world.actor.fast_stop(
        now,
        FastStopRequest {
            id,
            client: client(),
            cause: FastStopCause::Requested,
            reason: Reason::truncated("light curtain"),
            at: now.instant,
            epoch: None,
        },
    );
    world.settle();
    id
}

pub fn acknowledge(world: &mut World, id: FastStopId) -> oneshot::Receiver<Result<(), Rejection>> {
    // The only acknowledge in these tests; any other is a violation.
    world.invariants.acknowledge_taken();
    request(world, |answer: ResultSender<()>| ActorRequest::Acknowledge { id, client: client(), answer })
}

pub fn exchange(world: &mut World, command: wsg::Command) -> oneshot::Receiver<Result<wsg::Data, Rejection>> {
    request(world, |answer| ActorRequest::Exchange { command, client: client(), lease: None, answer: (None, answer) })
}

pub fn state(world: &World) -> State {
    State::clone(&world.watches.state.borrow())
}

/// The measured values that clients see.
pub fn values(world: &World) -> MeasuredFields {
    MeasuredFields::at(&world.watches.state.borrow().values, world.now)
}

pub fn latch(world: &World) -> LatchFields {
    state(world).latch.unwrap()
}

/// Ids of the frames that the device received since `from`, except updates, Loops and temperatures.
pub fn received(world: &World, from: usize) -> Vec<u8> {
    let upkeep = [id::LOOP, id::GET_TEMPERATURE];
    let ids = world.device.received()[from..].iter().map(|frame| frame.id);
    ids.filter(|id| !upkeep.contains(id) && !id::has_updates(*id)).collect()
}

pub fn mark(world: &World) -> usize {
    world.device.received().len()
}
