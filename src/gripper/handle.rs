//! The handle: what every door holds of a gripper. Cheap to clone; the actor behind it owns the state.

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};

use super::error::{Failure, Rejection};
use super::info::Info;
use super::model::{Client, Command, CommandId, FastStopId, Link, Name, Phase, Reason, State, Submission};
use crate::wsg;

/// Requests that may wait for the actor. It answers each within microseconds, so more than this many waiting means
/// that it can't keep up, and the next is told so rather than queued.
pub const MAX_WAITING_REQUESTS: usize = 64;

/// FAST STOPs that may wait for the actor, on a lane of their own. A sender waits for a place, which the actor frees
/// before it does anything else.
pub const MAX_WAITING_FAST_STOPS: usize = 64;

/// How long a client waits for a FAST STOP's confirmation before it is told that there is none yet.
pub const FAST_STOP_WAIT: Duration = Duration::from_millis(250);

/// What the actor is asked, with the channel for its answer. [`Handle`] has a method for each.
#[derive(Debug)]
#[allow(missing_docs, reason = "said at the handle's methods")]
pub enum Request {
    Submit { submission: Submission, id: CommandId, answer: Answer<Ticket> },
    Find { id: CommandId, answer: oneshot::Sender<Option<Ticket>> },
    Cancel { id: CommandId, client: Client, answer: oneshot::Sender<Option<Ticket>> },
    Exchange { command: wsg::Command, client: Client, answer: Answer<wsg::Data> },
    Acknowledge { id: FastStopId, client: Client, answer: Answer<()> },
    Drain { answer: oneshot::Sender<()> },
}

/// Where an answer or a rejection goes.
pub type Answer<T> = oneshot::Sender<Result<T, Rejection>>;

/// A FAST STOP on its way to the actor, on a lane of its own.
#[derive(Debug)]
pub struct FastStopRequest {
    /// What an acknowledge will have to name.
    pub id: FastStopId,
    /// Who asks.
    pub client: Client,
    /// Why.
    pub reason: Reason,
}

/// What became of a FAST STOP so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FastStop {
    /// What an acknowledge has to name.
    pub id: FastStopId,
    /// Whether the device's flags have shown it.
    pub confirmed: bool,
}

/// A command that was admitted, and can be waited for.
#[derive(Debug, Clone)]
pub struct Ticket {
    pub(super) record: watch::Receiver<Arc<Command>>,
    pub(super) replayed: bool,
}

impl Ticket {
    /// The command as it is now.
    #[must_use]
    pub fn now(&self) -> Command {
        let record = Command::clone(&self.record.borrow());
        Command { replayed: self.replayed, ..record }
    }

    /// Waits until it is written down, which the actor bounds.
    async fn recorded(&mut self) {
        // An actor that is gone records nothing any more.
        let _ = self.record.wait_for(|command| command.recorded).await;
    }

    /// Whether it has changed since this was asked last.
    pub fn has_changed(&mut self) -> bool {
        let changed = self.record.has_changed().unwrap_or_default();
        self.record.mark_unchanged();
        changed
    }

    /// The command when it has ended, or as it is after `limit`.
    pub async fn wait(&mut self, limit: Duration) -> Command {
        // Neither a time-out nor the actor's end is an error here: the record says how far the command came.
        let _ = tokio::time::timeout(limit, self.record.wait_for(|command| command.phase == Phase::Done)).await;
        self.now()
    }
}

/// One gripper, for everyone but its actor.
#[derive(Debug, Clone)]
pub struct Handle {
    pub(super) name: Name,
    pub(super) requests: mpsc::Sender<Request>,
    pub(super) fast_stops: mpsc::Sender<FastStopRequest>,
    pub(super) state: watch::Receiver<Arc<State>>,
    pub(super) info: watch::Receiver<Arc<Info>>,
}

impl Handle {
    /// The gripper's name.
    #[must_use]
    pub fn name(&self) -> &Name {
        &self.name
    }

    /// The newest state. Costs the device nothing.
    #[must_use]
    pub fn state(&self) -> Arc<State> {
        let state = self.state.borrow().clone();
        if self.requests.is_closed() {
            // Its last state must not look like news.
            let link_cause = Some("the gateway has given this gripper up".to_owned());
            return Arc::new(State { link: Link::Reconnecting, link_cause, ..State::clone(&state) });
        }
        state
    }

    /// The states from now on, newest wins.
    #[must_use]
    pub fn states(&self) -> watch::Receiver<Arc<State>> {
        self.state.clone()
    }

    /// What is known of the device. Costs the device nothing.
    #[must_use]
    pub fn info(&self) -> Arc<Info> {
        self.info.borrow().clone()
    }

    /// Submits a command: admitted with an id and written down, or rejected before anything was sent.
    ///
    /// # Errors
    /// [`Rejection`]
    pub async fn submit(&self, submission: Submission) -> Result<Ticket, Rejection> {
        let id = CommandId::generate();
        let mut ticket = self.ask(|answer| Request::Submit { submission, id, answer }).await??;
        ticket.recorded().await;
        Ok(ticket)
    }

    /// A command of the last hour, by its id.
    ///
    /// # Errors
    /// [`Failure`], where the actor can't be asked.
    pub async fn find(&self, id: CommandId) -> Result<Option<Ticket>, Failure> {
        self.ask(|answer| Request::Find { id, answer }).await
    }

    /// Stops a command if it still runs.
    ///
    /// # Errors
    /// [`Failure`], where the actor can't be asked.
    pub async fn cancel(&self, id: CommandId, client: Client) -> Result<Option<Ticket>, Failure> {
        self.ask(|answer| Request::Cancel { id, client, answer }).await
    }

    /// One request to the device that moves nothing, and its reply's data. After a setter the value is read back, and
    /// the data are the getter's: what the device made of it.
    ///
    /// # Errors
    /// [`Rejection`]
    pub async fn exchange(&self, command: wsg::Command, client: Client) -> Result<wsg::Data, Rejection> {
        self.ask(|answer| Request::Exchange { command, client, answer }).await?
    }

    /// FAST STOP: waits for nothing but the device's confirmation, and for that at most [`FAST_STOP_WAIT`].
    pub async fn fast_stop(&self, id: FastStopId, client: Client, reason: Reason) -> FastStop {
        let mut states = self.states();
        let confirmed_by = |state: &Arc<State>| {
            state.latch.as_ref().is_some_and(|latch| latch.fast_stop_id >= id && latch.fast_stop_confirmed)
        };
        let stop = async {
            self.fast_stops.send(FastStopRequest { id, client, reason }).await.ok()?;
            states.wait_for(confirmed_by).await.ok().map(drop)
        };
        let confirmed = tokio::time::timeout(FAST_STOP_WAIT, stop).await.is_ok_and(|confirmed| confirmed.is_some());
        FastStop { id, confirmed }
    }

    /// Acknowledges the FAST STOP of this id, and returns when the device's flags show that it is gone.
    ///
    /// # Errors
    /// [`Rejection`]
    pub async fn acknowledge(&self, id: FastStopId, client: Client) -> Result<(), Rejection> {
        self.ask(|answer| Request::Acknowledge { id, client, answer }).await?
    }

    /// Gives the gripper up in order: no new commands, a running one may finish, the device is told, the link closed.
    pub async fn drain(&self) {
        // An actor that is gone already has nothing left to give up.
        let _ = self.ask(|answer| Request::Drain { answer }).await;
    }

    async fn ask<T>(&self, request: impl FnOnce(oneshot::Sender<T>) -> Request) -> Result<T, Failure> {
        let (answer, answered) = oneshot::channel();
        self.requests.try_send(request(answer)).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => Failure::Overloaded { limit: MAX_WAITING_REQUESTS },
            mpsc::error::TrySendError::Closed(_) => Failure::Draining,
        })?;
        answered.await.map_err(|_| Failure::Draining)
    }
}
