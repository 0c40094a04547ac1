//! The handle: what every door holds of a gripper. Cheap to clone; the actor behind it owns the state.

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, mpsc, oneshot, watch};

use super::clock;
use super::error::{Failure, Rejection};
use super::info::Info;
use super::lease::Keep;
use super::model::{
    Action, Client, Command, CommandId, CustomIds, FastStopCause, FastStopId, Frame, Lease, LeaseToken, Link, Name,
    Phase, Reason, State, Submission, TakeLease,
};
use crate::wsg;

/// Requests that may wait for the actor. It answers each within microseconds, so more than this many waiting means
/// that it can't keep up, and the next is told so rather than queued: but for what ends or keeps the right to move, and
/// what stops, which wait for a place. They get the next one that is free, in their order, and are as many at most as
/// the doors let their clients ask at a time.
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
    Exchange { command: wsg::Command, client: Client, lease: Option<LeaseToken>, answer: Steps },
    Acknowledge { id: FastStopId, client: Client, answer: Answer<()> },
    Lease { answer: oneshot::Sender<Lease> },
    TakeLease { take: TakeLease, token: LeaseToken, answer: Answer<Granted> },
    UseLease { token: LeaseToken, answer: oneshot::Sender<Option<Keep>> },
    RenewLease { token: Option<LeaseToken>, answer: Answer<Lease> },
    HandOver { token: Option<LeaseToken>, to: String, new: LeaseToken, answer: Answer<Lease> },
    ReleaseLease { token: Option<LeaseToken>, answer: oneshot::Sender<Lease> },
    LoseLease { token: LeaseToken, times_taken: Option<u64> },
    Drain { answer: oneshot::Sender<()> },
}

/// Where an answer or a rejection goes.
pub type Answer<T> = oneshot::Sender<Result<T, Rejection>>;

/// Where it is told that the device has accepted a request and takes its time for it, for who wants to know; and where
/// its last reply's data go.
pub type Steps = (Option<oneshot::Sender<()>>, Answer<wsg::Data>);

/// A FAST STOP on its way to the actor, on a lane of its own.
#[derive(Debug)]
pub struct FastStopRequest {
    /// What an acknowledge will have to name.
    pub id: FastStopId,
    /// Who asks.
    pub client: Client,
    /// Why, in the gateway's words.
    pub cause: FastStopCause,
    /// Why, in the client's.
    pub reason: Reason,
    /// Since when it is on its way.
    pub at: Instant,
    /// Takes the latch's epoch, by which the caller tells the confirmation of this FAST STOP, or of a later one, from
    /// that of an earlier one.
    pub epoch: Option<oneshot::Sender<u64>>,
}

/// What became of a FAST STOP so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FastStop {
    /// What an acknowledge has to name.
    pub id: FastStopId,
    /// Whether the device's flags have shown it.
    pub confirmed: bool,
}

/// A lease that was taken.
#[derive(Debug)]
pub struct Granted {
    /// The lease, with its token.
    pub lease: Lease,
    /// How often it was taken by now: who takes it again, on another connection, has it from then on.
    pub times_taken: u64,
    /// Keeps it from running out: for a door whose client's connection is as good as a use.
    pub keep: Option<Keep>,
}

/// A lease in use: it doesn't run out for as long as this lives.
#[derive(Debug)]
pub struct Using {
    _keep: oneshot::Receiver<Option<Keep>>,
}

/// A command that was admitted, and can be waited for: its client's lease doesn't run out meanwhile.
#[derive(Debug, Clone)]
pub struct Ticket {
    pub(super) record: watch::Receiver<Arc<Command>>,
    pub(super) replayed: bool,
    pub(super) _keep: Option<Arc<Keep>>,
}

impl Ticket {
    /// The command as it is now.
    #[must_use]
    pub fn now(&self) -> Command {
        let record = Command::clone(&self.record.borrow());
        Command { replayed: self.replayed, ..record }
    }

    /// The same, for who only watches: its client's lease does not wait for it.
    #[must_use]
    pub fn watched(&self) -> Self {
        Self { _keep: None, ..self.clone() }
    }

    /// Its id.
    #[must_use]
    pub fn id(&self) -> CommandId {
        self.record.borrow().id
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

    /// The command when the device has accepted it, or when it has ended without that.
    pub async fn accepted(&mut self) -> Command {
        // An actor that is gone accepts nothing any more: the record says how far the command came.
        let _ = self.record.wait_for(|command| command.accepted || command.phase == Phase::Done).await;
        self.now()
    }

    /// The command when it has ended, or as it is when its gripper is given up.
    pub async fn ended(&mut self) -> Command {
        // The actor's end is no error here: the record says how far the command came.
        let _ = self.record.wait_for(|command| command.phase == Phase::Done).await;
        self.now()
    }

    /// The command when it has ended, or as it is after `limit`.
    pub async fn wait(&mut self, limit: Duration) -> Command {
        // Neither a time-out nor the actor's end is an error here: the record says how far the command came.
        let _ = tokio::time::timeout(limit, self.ended()).await;
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
    pub(super) custom_ids: Arc<CustomIds>,
    pub(super) frames: broadcast::Sender<Arc<Frame>>,
    pub(super) update_period_ms: u16,
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

    /// The frames from now on, in both directions. Who is too slow misses some, and is told how many.
    #[must_use]
    pub fn frames(&self) -> broadcast::Receiver<Arc<Frame>> {
        self.frames.subscribe()
    }

    /// How often the device tells its state.
    #[must_use]
    pub fn update_period_ms(&self) -> u16 {
        self.update_period_ms
    }

    /// What is known of the device. Costs the device nothing.
    #[must_use]
    pub fn info(&self) -> Arc<Info> {
        self.info.borrow().clone()
    }

    /// Whether a custom command of this id only reads. Others count as motions.
    #[must_use]
    pub fn only_reads(&self, id: u8) -> bool {
        self.custom_ids.read.contains(&id)
    }

    /// What the ids of its scripts mean.
    #[must_use]
    pub fn custom_ids(&self) -> Arc<CustomIds> {
        self.custom_ids.clone()
    }

    /// Submits a command: admitted with an id and written down, or rejected before anything was sent.
    ///
    /// # Errors
    /// [`Rejection`]
    pub async fn submit(&self, submission: Submission) -> Result<Ticket, Rejection> {
        let id = CommandId::generate();
        let is_stop = matches!(submission.action, Action::Stop);
        let request = |answer| Request::Submit { submission, id, answer };
        let mut ticket = if is_stop { self.insist(request).await } else { self.ask(request).await }??;
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
        self.insist(|answer| Request::Cancel { id, client, answer }).await
    }

    /// One request to the device that moves nothing, and its reply's data. After a setter the value is read back, and
    /// the data are the getter's: what the device made of it.
    ///
    /// # Errors
    /// [`Rejection`]
    pub async fn exchange(
        &self,
        command: wsg::Command,
        client: Client,
        lease: Option<LeaseToken>,
    ) -> Result<wsg::Data, Rejection> {
        self.ask(|answer| Request::Exchange { command, client, lease, answer: (None, answer) }).await?
    }

    /// The same, and `accepted` is told when the device has answered `E_CMD_PENDING`, after which its last reply follows.
    ///
    /// # Errors
    /// [`Rejection`]
    pub async fn exchange_in_steps(
        &self,
        command: wsg::Command,
        client: Client,
        lease: Option<LeaseToken>,
        accepted: oneshot::Sender<()>,
    ) -> Result<wsg::Data, Rejection> {
        self.ask(|answer| Request::Exchange { command, client, lease, answer: (Some(accepted), answer) }).await?
    }

    /// The lease as it is.
    ///
    /// # Errors
    /// [`Failure`], where the actor can't be asked.
    pub async fn lease(&self) -> Result<Lease, Failure> {
        self.ask(|answer| Request::Lease { answer }).await
    }

    /// Takes the lease, or changes the terms of the one that is held already.
    ///
    /// # Errors
    /// [`Rejection`]
    pub async fn take_lease(&self, take: TakeLease) -> Result<Granted, Rejection> {
        let token = LeaseToken::generate();
        self.insist(|answer| Request::TakeLease { take, token, answer }).await?
    }

    /// Uses the lease of this token, where it is somebody's. Nobody waits for that, a FAST STOP least of all.
    #[must_use]
    pub fn use_lease(&self, token: LeaseToken) -> Using {
        let (answer, keep) = oneshot::channel();
        if let Err(mpsc::error::TrySendError::Full(request)) =
            self.requests.try_send(Request::UseLease { token, answer })
        {
            let requests = self.requests.clone();
            // As one that insists. An actor that is gone has no lease.
            tokio::spawn(async move { requests.send(request).await });
        }
        Using { _keep: keep }
    }

    /// Renews the lease of this token.
    ///
    /// # Errors
    /// [`Rejection`], where it is nobody's.
    pub async fn renew_lease(&self, token: Option<LeaseToken>) -> Result<Lease, Rejection> {
        self.insist(|answer| Request::RenewLease { token, answer }).await?
    }

    /// Gives the lease of this token to who has asked for it.
    ///
    /// # Errors
    /// [`Rejection`]
    pub async fn hand_over(&self, token: Option<LeaseToken>, to: String) -> Result<Lease, Rejection> {
        let new = LeaseToken::generate();
        self.insist(|answer| Request::HandOver { token, to, new, answer }).await?
    }

    /// Gives the lease of this token back: a running motion is stopped. Where the token is nobody's, nothing happens.
    ///
    /// # Errors
    /// [`Failure`], where the actor can't be asked.
    pub async fn release_lease(&self, token: Option<LeaseToken>) -> Result<Lease, Failure> {
        self.insist(|answer| Request::ReleaseLease { token, answer }).await
    }

    /// The client that holds the lease of this token was lost; where it says how often it had taken it, unless it has taken
    /// it again since.
    pub async fn lose_lease(&self, token: LeaseToken, times_taken: Option<u64>) {
        // An actor that is gone has given its device up.
        let _ = self.requests.send(Request::LoseLease { token, times_taken }).await;
    }

    /// FAST STOP: waits for nothing but the device's confirmation, and for that at most [`FAST_STOP_WAIT`].
    pub async fn fast_stop(&self, id: FastStopId, client: Client, reason: Reason) -> FastStop {
        let at = clock::instant();
        let mut states = self.states();
        let stop = async {
            let (epoch, latched) = oneshot::channel();
            let (cause, epoch) = (FastStopCause::Requested, Some(epoch));
            self.fast_stops.send(FastStopRequest { id, client, cause, reason, at, epoch }).await.ok()?;
            let epoch = latched.await.ok()?;
            let confirmed_by = |state: &Arc<State>| {
                state.latch.as_ref().is_some_and(|latch| latch.epoch >= epoch && latch.fast_stop_confirmed)
            };
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
        self.insist(|answer| Request::Acknowledge { id, client, answer }).await?
    }

    /// Gives the gripper up in order: no new commands, a running one may finish, the device is told, the link closed.
    pub async fn drain(&self) {
        // An actor that is gone already has nothing left to give up.
        if self.insist(|answer| Request::Drain { answer }).await.is_ok() {
            // Behind the answer come its last records.
            self.requests.closed().await;
        }
    }

    /// Asks what may be refused where too much waits already.
    async fn ask<T>(&self, request: impl FnOnce(oneshot::Sender<T>) -> Request) -> Result<T, Failure> {
        let (answer, answered) = oneshot::channel();
        self.requests.try_send(request(answer)).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => Failure::Overloaded { limit: MAX_WAITING_REQUESTS },
            mpsc::error::TrySendError::Closed(_) => Failure::Draining,
        })?;
        answered.await.map_err(|_| Failure::Draining)
    }

    /// Asks what has to get through: it waits for a place, before what others [`Handle::ask`] from now on.
    async fn insist<T>(&self, request: impl FnOnce(oneshot::Sender<T>) -> Request) -> Result<T, Failure> {
        let (answer, answered) = oneshot::channel();
        self.requests.send(request(answer)).await.map_err(|_| Failure::Draining)?;
        answered.await.map_err(|_| Failure::Draining)
    }
}

#[cfg(test)]
mod tests {
    use futures_util::FutureExt as _;

    use super::*;
    use crate::gripper::fake;
    use crate::gripper::model::Door;

    /// A handle whose actor takes nothing by itself.
    fn idle() -> (Handle, mpsc::Receiver<Request>) {
        let (requests, queue) = mpsc::channel(MAX_WAITING_REQUESTS);
        let (handle, _) = fake::gripper("left", fake::Script::default());
        (Handle { requests, ..handle }, queue)
    }

    #[tokio::test]
    async fn who_floods_a_gripper_refuses_nobody_a_stop_or_the_lease() {
        let (handle, mut queue) = idle();
        let client = Client { subject: "test".into(), door: Door::Http };
        let reads: Vec<_> = (0..MAX_WAITING_REQUESTS).map(|_| Box::pin(handle.lease())).collect();
        let mut reads: Vec<_> = reads.into_iter().map(|mut read| ((&mut read).now_or_never(), read)).collect();
        assert!(reads.iter().all(|(answered, _)| answered.is_none()), "each has a place");
        let refused = handle.lease().now_or_never();
        assert_eq!(refused, Some(Err(Failure::Overloaded { limit: MAX_WAITING_REQUESTS })));
        let token = LeaseToken::generate();
        let stop = Submission { client: client.clone(), action: Action::Stop, request_id: None, lease: None };
        let mut asked = [
            handle.submit(stop).map(drop).boxed(),
            handle.release_lease(Some(token.clone())).map(drop).boxed(),
            handle.renew_lease(Some(token.clone())).map(drop).boxed(),
            handle.take_lease(TakeLease::by(client.clone())).map(drop).boxed(),
            handle.hand_over(Some(token), "other".to_owned()).map(drop).boxed(),
            handle.acknowledge(FastStopId::generate(), client.clone()).map(drop).boxed(),
            handle.cancel(CommandId::generate(), client).map(drop).boxed(),
        ];
        tokio::task::yield_now().await;
        for asked in &mut asked {
            assert!(asked.now_or_never().is_none(), "it waits");
        }
        for _ in 0..asked.len() {
            // So that each may be polled as often as it is.
            tokio::task::yield_now().await;
            assert!(matches!(queue.try_recv(), Ok(Request::Lease { .. })));
            let refused = handle.lease().now_or_never();
            assert_eq!(refused, Some(Err(Failure::Overloaded { limit: MAX_WAITING_REQUESTS })), "others wait longer");
            for asked in &mut asked {
                assert!(asked.now_or_never().is_none(), "it is not answered yet");
            }
        }
        for _ in asked.len()..MAX_WAITING_REQUESTS {
            assert!(matches!(queue.try_recv(), Ok(Request::Lease { .. })));
        }
        reads.clear();
        let mut next = || queue.try_recv().unwrap();
        assert!(matches!(next(), Request::Submit { .. }));
        assert!(matches!(next(), Request::ReleaseLease { .. }));
        assert!(matches!(next(), Request::RenewLease { .. }));
        assert!(matches!(next(), Request::TakeLease { .. }));
        assert!(matches!(next(), Request::HandOver { .. }));
        assert!(matches!(next(), Request::Acknowledge { .. }));
        assert!(matches!(next(), Request::Cancel { .. }));
    }
}
