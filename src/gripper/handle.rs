//! The handle through which every interface uses a gripper. It is cheap to clone; the actor behind it owns the state.

use std::fmt;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, mpsc, oneshot, watch};

use super::actor::ActorConfig;
use super::connector::Connector;
use super::info::Info;
use super::lease::LeaseKeepAlive;
use model::clock;
use model::error::{Failure, Rejection};
use model::{
    Action, Client, CommandId, CommandReport, CustomIds, FastStopCause, FastStopId, Fault, Lease, LeaseToken, Link,
    LossCause, Name, Phase, Reason, RequestId, ServoReport, State, Steer, Submission, TakeLease, WireRecord,
};

/// Requests that can wait for the actor. The actor answers each within microseconds, so a full queue means that it
/// can't keep up, and further requests are rejected. Requests that stop, or that keep or end a lease, wait for a free
/// slot instead, in order. The interfaces bound how many such requests their clients can make at the same time.
pub const MAX_WAITING_REQUESTS: usize = 64;

/// FAST STOPs that can wait for the actor, in a queue of their own, which the actor empties before it does anything
/// else. While the queue is full, a further FAST STOP joins the ones that wait.
pub const MAX_WAITING_FAST_STOPS: usize = 64;

/// Longest wait for the confirmation of a FAST STOP, after which the client gets `confirmed: false`.
pub const FAST_STOP_WAIT: Duration = Duration::from_millis(250);

/// A request to the actor, with the channel for its reply. [`Handle`] has a method for each.
#[derive(Debug)]
#[allow(missing_docs, reason = "documented at the handle's methods")]
pub enum ActorRequest {
    Submit { submission: Submission, id: CommandId, answer: ResultSender<Ticket> },
    Find { id: CommandId, answer: oneshot::Sender<Option<Ticket>> },
    FindRequest { subject: Arc<str>, request_id: RequestId, answer: oneshot::Sender<Option<Ticket>> },
    Cancel { id: CommandId, client: Client, answer: oneshot::Sender<Option<Ticket>> },
    Exchange { command: wsg::Command, client: Client, lease: Option<LeaseToken>, answer: Steps },
    Acknowledge { id: FastStopId, client: Client, answer: ResultSender<()> },
    AcknowledgeFault { client: Client, lease: Option<LeaseToken>, answer: ResultSender<()> },
    Lease { answer: oneshot::Sender<Lease> },
    TakeLease { take: TakeLease, token: LeaseToken, answer: ResultSender<AcquiredLease> },
    UseLease { token: LeaseToken, answer: oneshot::Sender<Option<LeaseKeepAlive>> },
    RenewLease { token: Option<LeaseToken>, answer: ResultSender<Lease> },
    HandOver { token: Option<LeaseToken>, to: String, new: LeaseToken, answer: ResultSender<Lease> },
    ReleaseLease { token: Option<LeaseToken>, answer: oneshot::Sender<Lease> },
    LoseLease { token: LeaseToken, times_taken: Option<u64>, cause: LossCause },
    Disconnect { client: Client, lease: Option<LeaseToken>, answer: ResultSender<()> },
    Connect { client: Client, lease: Option<LeaseToken>, answer: ResultSender<()> },
    Steer { request: Steer, client: Client, lease: Option<LeaseToken>, answer: ResultSender<ServoReport> },
    Drain { answer: oneshot::Sender<()> },
    Reconfigure { change: Box<Reconfiguration>, answer: oneshot::Sender<()> },
}

/// New configuration of a gripper.
pub struct Reconfiguration {
    pub config: ActorConfig,
    /// New device; `None` if the gripper keeps its device.
    pub connector: Option<Arc<dyn Connector>>,
}

impl fmt::Debug for Reconfiguration {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Reconfiguration").field("config", &self.config).finish_non_exhaustive()
    }
}

/// Channel for a reply or a rejection.
pub type ResultSender<T> = oneshot::Sender<Result<T, Rejection>>;

/// Optional channel to signal that the device has accepted a request (`E_CMD_PENDING`), and channel for the data of the
/// last reply.
pub type Steps = (Option<oneshot::Sender<()>>, ResultSender<wsg::Data>);

/// A requested FAST STOP, on its way to the actor.
#[derive(Debug)]
pub struct FastStopRequest {
    /// Id that an acknowledgement will have to name.
    pub id: FastStopId,
    pub client: Client,
    pub cause: FastStopCause,
    pub reason: Reason,
    /// Time at which the request was received.
    pub at: Instant,
    /// Channel for the latch's epoch, by which the caller recognises a confirmation of this FAST STOP or a later one.
    pub epoch: Option<oneshot::Sender<u64>>,
}

/// Result of a FAST STOP so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FastStop {
    /// Id that an acknowledgement has to name.
    pub id: FastStopId,
    /// Whether the device's flags have shown it.
    pub confirmed: bool,
}

/// A lease that was taken.
#[derive(Debug)]
pub struct AcquiredLease {
    /// The lease, with its token.
    pub lease: Lease,
    /// Number of times that this lease was taken. It belongs to the connection that took it last.
    pub times_taken: u64,
    /// Guard that keeps the lease, for interfaces whose open connection counts as use.
    pub keep: Option<LeaseKeepAlive>,
}

/// Guard for a lease in use, which does not run out before the guard is dropped.
#[derive(Debug)]
pub struct Using {
    _keep: oneshot::Receiver<Option<LeaseKeepAlive>>,
}

/// An admitted command, whose end can be awaited. Its client's lease does not run out meanwhile.
#[derive(Debug, Clone)]
pub struct Ticket {
    pub(super) record: watch::Receiver<Arc<CommandReport>>,
    pub(super) replayed: bool,
    pub(super) _keep: Option<Arc<LeaseKeepAlive>>,
}

impl Ticket {
    /// The command as it is now.
    #[must_use]
    pub fn now(&self) -> CommandReport {
        let record = CommandReport::clone(&self.record.borrow());
        CommandReport { replayed: self.replayed, ..record }
    }

    /// A ticket for observers, which does not keep the client's lease.
    #[must_use]
    pub fn watched(&self) -> Self {
        Self { _keep: None, ..self.clone() }
    }

    #[must_use]
    pub fn id(&self) -> CommandId {
        self.record.borrow().id
    }

    /// Waits until the command is recorded, or until the actor stops waiting for the record.
    async fn recorded(&mut self) {
        // An actor that has ended records nothing further.
        let _ = self.record.wait_for(|command| command.recorded).await;
    }

    /// Waits until the device has accepted the command or the command has ended.
    pub async fn accepted(&mut self) -> CommandReport {
        // The actor's end is not an error here: the record shows how far the command came.
        let _ = self.record.wait_for(|command| command.accepted || command.phase == Phase::Done).await;
        self.now()
    }

    /// Waits until the command has ended or the gripper is disconnected.
    pub async fn ended(&mut self) -> CommandReport {
        // The actor's end is not an error here: the record shows how far the command came.
        let _ = self.record.wait_for(|command| command.phase == Phase::Done).await;
        self.now()
    }

    /// Waits until the command has ended, but no longer than `limit`.
    pub async fn wait(&mut self, limit: Duration) -> CommandReport {
        // Neither a time-out nor the actor's end is an error here: the record shows how far the command came.
        let _ = tokio::time::timeout(limit, self.ended()).await;
        self.now()
    }
}

/// Access to one gripper.
#[derive(Debug, Clone)]
pub struct Handle {
    pub(super) name: Name,
    pub(super) requests: mpsc::Sender<ActorRequest>,
    pub(super) fast_stops: mpsc::Sender<FastStopRequest>,
    pub(super) state: watch::Receiver<Arc<State>>,
    pub(super) info: watch::Receiver<Arc<Info>>,
    pub(super) frames: broadcast::Sender<Arc<WireRecord>>,
}

impl Handle {
    #[must_use]
    pub fn name(&self) -> &Name {
        &self.name
    }

    /// Whether both handles are for the same gripper of the same run.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        self.requests.same_channel(&other.requests)
    }

    /// Whether the gateway no longer serves the gripper, because a reload has removed or replaced it.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.requests.is_closed()
    }

    /// The newest state. Causes no request to the device.
    #[must_use]
    pub fn state(&self) -> Arc<State> {
        let state = self.state.borrow().clone();
        if self.has_ended() {
            // The last state must not look current.
            let link_cause = Some("the gateway has disconnected from this gripper".to_owned());
            let fault = state.latch.is_none().then_some(Fault::LinkDown.code());
            let fault_code = fault.unwrap_or(state.fault_code);
            let link = Link::Reconnecting;
            let mut values = state.values;
            values.forget();
            return Arc::new(State { link, link_cause, values, fault: true, fault_code, ..State::clone(&state) });
        }
        state
    }

    /// Watches the state. A slow receiver sees only the newest one.
    #[must_use]
    pub fn states(&self) -> watch::Receiver<Arc<State>> {
        self.state.clone()
    }

    /// Subscribes to frames in both directions. A slow receiver misses frames and learns how many.
    #[must_use]
    pub fn frames(&self) -> broadcast::Receiver<Arc<WireRecord>> {
        self.frames.subscribe()
    }

    /// Period of the device's updates.
    #[must_use]
    pub fn update_period_ms(&self) -> u16 {
        self.info.borrow().update_period_ms
    }

    /// Information about the device. Causes no request to the device.
    #[must_use]
    pub fn info(&self) -> Arc<Info> {
        self.info.borrow().clone()
    }

    /// Whether a custom command of this id is configured as read-only. All others may move the fingers.
    #[must_use]
    pub fn only_reads(&self, id: u8) -> bool {
        self.info.borrow().custom_ids.read.contains(&id)
    }

    #[must_use]
    pub fn custom_ids(&self) -> Arc<CustomIds> {
        self.info.borrow().custom_ids.clone()
    }

    /// Submits a command. It is admitted and recorded, or rejected before anything was sent.
    pub async fn submit(&self, submission: Submission) -> Result<Ticket, Rejection> {
        let id = CommandId::generate();
        let mut ticket = if matches!(submission.action, Action::Stop) {
            self.request_reserved(|answer| ActorRequest::Submit { submission, id, answer }).await??
        } else {
            self.try_request(|answer| ActorRequest::Submit { submission, id, answer }).await??
        };
        ticket.recorded().await;
        Ok(ticket)
    }

    /// Finds a command of the last hour.
    pub async fn find(&self, id: CommandId) -> Result<Option<Ticket>, Failure> {
        self.try_request(|answer| ActorRequest::Find { id, answer }).await
    }

    /// Finds the command of a client's request id.
    pub async fn find_request(&self, subject: Arc<str>, request_id: RequestId) -> Result<Option<Ticket>, Failure> {
        self.try_request(|answer| ActorRequest::FindRequest { subject, request_id, answer }).await
    }

    /// Stops a command if it is still running.
    pub async fn cancel(&self, id: CommandId, client: Client) -> Result<Option<Ticket>, Failure> {
        self.request_reserved(|answer| ActorRequest::Cancel { id, client, answer }).await
    }

    /// Sends one request that moves nothing, and returns the data of its reply. After a setter, the value is read back,
    /// and the data are those of the getter.
    pub async fn exchange(
        &self,
        command: wsg::Command,
        client: Client,
        lease: Option<LeaseToken>,
    ) -> Result<wsg::Data, Rejection> {
        self.try_request(|answer| ActorRequest::Exchange { command, client, lease, answer: (None, answer) }).await?
    }

    /// Works like [`Handle::exchange`], and signals `accepted` when the device has answered `E_CMD_PENDING`.
    pub async fn exchange_in_steps(
        &self,
        command: wsg::Command,
        client: Client,
        lease: Option<LeaseToken>,
        accepted: oneshot::Sender<()>,
    ) -> Result<wsg::Data, Rejection> {
        self.try_request(|answer| ActorRequest::Exchange { command, client, lease, answer: (Some(accepted), answer) })
            .await?
    }

    /// Begins or ends a servo session, or gives it a target. Returns the session as it is then.
    pub async fn steer(
        &self,
        request: Steer,
        client: Client,
        lease: Option<LeaseToken>,
    ) -> Result<ServoReport, Rejection> {
        if matches!(request, Steer::Stop) {
            return self.request_reserved(|answer| ActorRequest::Steer { request, client, lease, answer }).await?;
        }
        self.try_request(|answer| ActorRequest::Steer { request, client, lease, answer }).await?
    }

    pub async fn lease(&self) -> Result<Lease, Failure> {
        self.try_request(|answer| ActorRequest::Lease { answer }).await
    }

    /// Waits until the actor responds, however many requests are waiting.
    pub async fn responds(&self) -> bool {
        self.request_reserved(|answer| ActorRequest::Lease { answer }).await.is_ok()
    }

    /// Takes the lease, or changes the terms of a lease that the client holds already.
    pub async fn take_lease(&self, take: TakeLease) -> Result<AcquiredLease, Rejection> {
        let token = LeaseToken::generate();
        self.request_reserved(|answer| ActorRequest::TakeLease { take, token, answer }).await?
    }

    /// Marks the lease of this token as in use, if there is one, without waiting for the actor.
    #[must_use]
    pub fn use_lease(&self, token: LeaseToken) -> Using {
        let (answer, keep) = oneshot::channel();
        if let Err(mpsc::error::TrySendError::Full(request)) =
            self.requests.try_send(ActorRequest::UseLease { token, answer })
        {
            let requests = self.requests.clone();
            // Waits for a free slot. An actor that has ended has no lease.
            tokio::spawn(async move { requests.send(request).await });
        }
        Using { _keep: keep }
    }

    /// Renews the lease of this token.
    pub async fn renew_lease(&self, token: Option<LeaseToken>) -> Result<Lease, Rejection> {
        self.request_reserved(|answer| ActorRequest::RenewLease { token, answer }).await?
    }

    /// Gives the lease of this token to the client that has requested it.
    pub async fn hand_over(&self, token: Option<LeaseToken>, to: String) -> Result<Lease, Rejection> {
        let new = LeaseToken::generate();
        self.request_reserved(|answer| ActorRequest::HandOver { token, to, new, answer }).await?
    }

    /// Releases the lease of this token and stops a running motion. A token without a lease does nothing.
    pub async fn release_lease(&self, token: Option<LeaseToken>) -> Result<Lease, Failure> {
        self.request_reserved(|answer| ActorRequest::ReleaseLease { token, answer }).await
    }

    /// Reports that the holder of this token was lost. With `times_taken`, the report counts only if the lease was not
    /// taken again since.
    pub async fn lose_lease(&self, token: LeaseToken, times_taken: Option<u64>, cause: LossCause) {
        // An actor that has ended has disconnected from its device.
        let _ = self.requests.send(ActorRequest::LoseLease { token, times_taken, cause }).await;
    }

    /// Requests a FAST STOP. Waits only for the device's confirmation, and at most [`FAST_STOP_WAIT`].
    pub async fn fast_stop(&self, id: FastStopId, client: Client, reason: Reason) -> FastStop {
        let at = clock::instant();
        let mut states = self.states();
        let before = states.borrow().latch.as_ref().map_or(0, |latch| latch.epoch);
        let (epoch, latched) = oneshot::channel();
        let request = FastStopRequest { id, client, cause: FastStopCause::Requested, reason, at, epoch: Some(epoch) };
        let stop = async {
            let (epoch, joins) = match self.fast_stops.try_send(request) {
                Ok(()) => (latched.await.ok()?, false),
                // The waiting FAST STOPs stop the gripper as well: this one joins the next of them.
                Err(mpsc::error::TrySendError::Full(_)) => (before + 1, true),
                Err(mpsc::error::TrySendError::Closed(_)) => return None,
            };
            let confirmed = states.wait_for(|state| {
                state.latch.as_ref().is_some_and(|latch| latch.epoch >= epoch && latch.fast_stop_confirmed)
            });
            let state = confirmed.await.ok()?;
            joins.then(|| state.latch.as_ref().map(|latch| latch.fast_stop_id)).flatten().or(Some(id))
        };
        let confirmed = tokio::time::timeout(FAST_STOP_WAIT, stop).await.ok().flatten();
        FastStop { id: confirmed.unwrap_or(id), confirmed: confirmed.is_some() }
    }

    /// Acknowledges the FAST STOP of this id, and returns when the device's flags show that it is cleared.
    pub async fn acknowledge(&self, id: FastStopId, client: Client) -> Result<(), Rejection> {
        self.request_reserved(|answer| ActorRequest::Acknowledge { id, client, answer }).await?
    }

    /// Acknowledges a fault of the device while no FAST STOP is latched.
    pub async fn acknowledge_fault(&self, client: Client, lease: Option<LeaseToken>) -> Result<(), Rejection> {
        self.request_reserved(|answer| ActorRequest::AcknowledgeFault { client, lease, answer }).await?
    }

    /// Releases the device to another program: announces the disconnect, closes the link, and returns. The gateway does
    /// not connect again until [`Handle::connect`].
    pub async fn disconnect(&self, client: Client, lease: Option<LeaseToken>) -> Result<(), Rejection> {
        self.request_reserved(|answer| ActorRequest::Disconnect { client, lease, answer }).await?
    }

    /// Lets the gateway connect to a released device again.
    pub async fn connect(&self, client: Client, lease: Option<LeaseToken>) -> Result<(), Rejection> {
        self.request_reserved(|answer| ActorRequest::Connect { client, lease, answer }).await?
    }

    /// Applies a new configuration. If that needs another link, a running command finishes first, and the disconnect is
    /// announced, as in [`Handle::drain`].
    pub async fn reconfigure(&self, change: Reconfiguration) {
        let change = Box::new(change);
        // An actor that has ended needs no configuration.
        let _ = self.request_reserved(|answer| ActorRequest::Reconfigure { change, answer }).await;
    }

    /// Disconnects from the gripper for good: rejects new commands, lets a running one finish, announces the disconnect
    /// and closes the link.
    pub async fn drain(&self) {
        // If the actor has ended, there is nothing left to disconnect.
        if self.request_reserved(|answer| ActorRequest::Drain { answer }).await.is_ok() {
            // The last records follow the reply, so wait for the actor's end.
            self.requests.closed().await;
        }
    }

    /// Sends a request, or fails if too many are waiting.
    async fn try_request<T>(&self, request: impl FnOnce(oneshot::Sender<T>) -> ActorRequest) -> Result<T, Failure> {
        let (answer, answered) = oneshot::channel();
        self.requests.try_send(request(answer)).map_err(|error| match error {
            mpsc::error::TrySendError::Full(_) => Failure::Overloaded { limit: MAX_WAITING_REQUESTS },
            mpsc::error::TrySendError::Closed(_) => Failure::Draining,
        })?;
        answered.await.map_err(|_| Failure::Draining)
    }

    /// Sends a request that must get through: waits for a free slot, ahead of later calls of [`Handle::try_request`].
    async fn request_reserved<T>(
        &self,
        request: impl FnOnce(oneshot::Sender<T>) -> ActorRequest,
    ) -> Result<T, Failure> {
        let (answer, answered) = oneshot::channel();
        self.requests.send(request(answer)).await.map_err(|_| Failure::Draining)?;
        answered.await.map_err(|_| Failure::Draining)
    }
}

#[cfg(test)]
mod tests;
