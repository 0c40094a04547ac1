//! The I/O around one client's virtual device, and its requests to the gripper on behalf of that client.

use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use futures_util::FutureExt as _;
use futures_util::future::BoxFuture;
use futures_util::stream::{FuturesUnordered, StreamExt as _};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

mod last_replies;
mod leases;
use super::acknowledge::acknowledge;
use super::device::VirtualDevice;
use super::order::{PortOrder, PortOrdered, PortReply, PortRequest};
use super::port::Port;
use super::refusals::{Refusals, Refused};
use super::rights;
use super::status::RefusedStatus;
use crate::connections::admission::{Claim, Class, ConnectionPermit};
use crate::gripper::{AcquiredLease, Conflict, LeaseKeepAlive, Rejection, Ticket};
use crate::model::clock::{self, sleep_until};
use crate::model::{Action, Client, CommandReport, FastStopId, LeaseToken, Motion, Outcome, Phase, Reason, Submission};
use crate::wsg::{self, Data, Reply, Status, id};

/// Read buffer size. The replies to all requests that fit into it can be queued before any of them is written.
const READ_BYTES: usize = 1024;

/// Steps for one client before another client's turn, so that no client can delay a gripper.
const TURN: u32 = 16;

/// Maximum number of reads after a client's end, so that a client that never stops sending is still lost.
const MAX_LAST_READS: usize = 256;

/// Time in which the first bytes of an evicted client must arrive.
const FIRST_BYTES_WITHIN: Duration = Duration::from_millis(10);

/// Time for a client to read its last replies at shutdown, and for its last FAST STOPs to be passed on after it has
/// disconnected.
const LAST_REPLIES_WITHIN: Duration = Duration::from_millis(500);

/// One client and its connection.
pub(super) struct Served<R, W> {
    port: Arc<Port>,
    client: Client,
    address: IpAddr,
    /// Lease token of the client's motions.
    token: LeaseToken,
    device: VirtualDevice,
    under_way: FuturesUnordered<BoxFuture<'static, Step>>,
    /// Keeps the lease alive while the client is connected.
    kept: Option<Kept>,
    permit: Arc<ConnectionPermit>,
    reader: R,
    writer: W,
    outgoing: Vec<u8>,
    written: usize,
    /// Silence after which the client is lost; `None` if silence is allowed.
    silence: Option<Duration>,
    heard: Instant,
    /// Whether the client has sent nothing yet.
    is_fresh: bool,
    /// Whether the client was silent for too long. Such a client still gets its outstanding replies and its updates,
    /// since many clients wait for them forever.
    is_lost: bool,
    /// End of the client, after which it starts no motion, acknowledges nothing and takes no lease.
    end: Option<ClientEnd>,
    /// Whether the client has used a script that may move the fingers, and so may take the lease.
    uses_scripts: bool,
    /// Newest lease that this client has tried to keep.
    tried_epoch: u64,
    refusals: Refusals,
}

/// A lease kept alive for its client, which is not evicted meanwhile.
struct Kept {
    epoch: u64,
    _keep: LeaseKeepAlive,
    _pin: Option<Claim>,
}

/// Progress of an order.
enum Step {
    Answered(PortRequest, PortReply),
    /// The device has accepted a request that moves nothing, and is still working on it.
    Begun(PortRequest, BoxFuture<'static, Step>),
    Admitted(PortRequest, Ticket),
    /// A command was accepted by the device, or ended before that.
    Accepted(PortRequest, Ticket, Box<CommandReport>),
    /// A request was refused; the flag says whether the refusal is recorded.
    Rejected(PortRequest, Rejection, bool),
    Kept(Option<AcquiredLease>),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ClientEnd {
    /// The client has disconnected or is lost.
    Gone,
    /// The client has closed the sending side of its connection, and perhaps the other side too.
    SentLast,
    /// The gateway shuts down.
    Closing,
}

impl<R: AsyncRead + Unpin, W: AsyncWrite + Unpin> Served<R, W> {
    pub(super) fn new(
        port: Arc<Port>,
        (client, address): (Client, IpAddr),
        permit: Arc<ConnectionPermit>,
        (reader, writer): (R, W),
        silence: Option<Duration>,
    ) -> Self {
        let ids = port.gripper.custom_ids();
        let period_ms = port.gripper.update_period_ms();
        let device = VirtualDevice::new(client.subject.clone(), &port.rules, ids, period_ms);
        Self {
            port,
            client,
            address,
            token: LeaseToken::generate(),
            device,
            under_way: FuturesUnordered::new(),
            kept: None,
            permit,
            reader,
            writer,
            outgoing: Vec::new(),
            written: 0,
            silence,
            heard: clock::instant(),
            is_fresh: true,
            is_lost: false,
            end: None,
            uses_scripts: false,
            tried_epoch: 0,
            refusals: Refusals::default(),
        }
    }

    /// Serves the client until it is gone, or until `closing`.
    pub(super) async fn run(mut self, closing: CancellationToken) {
        let end = self.serve(&closing).await;
        if end == ClientEnd::Closing {
            // At shutdown, the gripper was released cleanly. The client must still learn how its last motion ended.
            let _ = tokio::time::timeout(LAST_REPLIES_WITHIN, self.finish()).await;
            // After a reload, the gripper is still there.
            self.leave_lease(self.device.has_announced()).await;
            return;
        }
        if self.is_fresh {
            // The runtime may not have seen yet what an evicted client sent, perhaps a FAST STOP.
            let mut incoming = vec![0; READ_BYTES];
            let slot = self.permit.displaced();
            let within = if slot.is_some() { FIRST_BYTES_WITHIN } else { Duration::ZERO };
            if let Ok(Ok(bytes)) = tokio::time::timeout(within, self.reader.read(&mut incoming)).await {
                self.receive(incoming.get(..bytes).unwrap_or_default());
            }
        }
        // Requests sent before the disconnect count: many clients send 07h and disconnect at once.
        for _ in 0..MAX_LAST_READS {
            let Some(Ok(bytes)) = self.read_now().filter(|read| !matches!(read, Ok(0))) else { break };
            tracing::trace!(bytes, "read after the end");
            // Yields, since the grippers' actors run on the same thread.
            tokio::task::yield_now().await;
        }
        self.start_orders();
        let has_announced = self.device.has_announced();
        self.end = Some(end);
        if end == ClientEnd::SentLast {
            // For the lease and a running motion, this is the end of the connection: a killed client looks the same.
            self.device.withdraw_motions();
        } else {
            self.device.forget_waiting();
        }
        self.leave_lease(has_announced).await;
        if end == ClientEnd::SentLast {
            self.send_last_replies(&closing).await;
        }
        // FAST STOPs of the client may still be waiting for their turn.
        let _ = tokio::time::timeout(LAST_REPLIES_WITHIN, self.finish_fast_stops()).await;
    }

    async fn serve(&mut self, closing: &CancellationToken) -> ClientEnd {
        let mut incoming = vec![0; READ_BYTES];
        let mut states = self.port.gripper.states();
        let mut steps = 0;
        loop {
            steps = (steps + 1) % TURN;
            if steps == 0 {
                tokio::task::yield_now().await;
            }
            self.start_orders();
            if self.device.has_overflown() || self.has_left() || self.is_forgotten() {
                return ClientEnd::Gone;
            }
            if self.written == self.outgoing.len() {
                self.written = 0;
                self.outgoing = self.device.poll_frame().unwrap_or_default();
            }
            let state = self.port.gripper.state();
            let is_writing = !self.outgoing.is_empty();
            self.forget_lost_lease(&state);
            self.keep_claimed_lease(&state);
            let holds_lease = self.kept.is_some();
            self.device.set_holder(holds_lease);
            let watches = holds_lease || self.uses_scripts || self.device.watches();
            let silent_at = self.silence.filter(|_| !self.is_lost).map(|silence| self.heard + silence);
            let deadline = self.device.poll_timeout(clock::instant(), &state).into_iter().chain(silent_at).min();
            tokio::select! {
                biased;
                () = closing.cancelled() => return ClientEnd::Closing,
                () = self.permit.evicted(), if !holds_lease => {
                    if self.is_fresh {
                        return ClientEnd::Gone;
                    }
                    tracing::warn!(gripper = %self.port.gripper.name(), client = %self.client.subject,
                        "client evicted: silent longest, and a new client needs its slot");
                    return ClientEnd::Gone;
                }
                written = self.writer.write(self.outgoing.get(self.written..).unwrap_or_default()), if is_writing => {
                    match written {
                        Ok(bytes) if bytes > 0 => self.written += bytes,
                        _ => return ClientEnd::Gone,
                    }
                }
                Some(step) = self.under_way.next() => self.take(step),
                read = self.reader.read(&mut incoming) => match read {
                    Ok(bytes) if bytes > 0 => self.receive(incoming.get(..bytes).unwrap_or_default()),
                    Ok(_) if self.silence.is_none() => return ClientEnd::SentLast,
                    _ => return ClientEnd::Gone,
                },
                () = sleep_until(deadline) => {
                    let now = clock::instant();
                    if silent_at.is_some_and(|at| at <= now) {
                        if self.device.has_announced() {
                            return ClientEnd::Gone;
                        }
                        self.is_lost = true;
                        self.device.withdraw_motions();
                        self.lose_lease().await;
                    }
                    self.device.handle_timeout(now, &self.port.gripper.state());
                }
                Ok(()) = states.changed(), if watches => {
                    let state = states.borrow_and_update().clone();
                    self.device.handle_timeout(clock::instant(), &state);
                }
            }
        }
    }

    /// Whether a client without a connection (UDP) has announced its disconnect and got all replies.
    fn has_left(&self) -> bool {
        self.silence.is_some() && self.device.has_announced() && self.is_owed_nothing()
    }

    /// Whether the client is lost, and nothing has to be kept in case it returns.
    fn is_forgotten(&self) -> bool {
        self.is_lost && self.is_owed_nothing() && !self.device.is_remembered()
    }

    fn is_answered(&self) -> bool {
        self.device.is_idle() && self.written == self.outgoing.len()
    }

    fn is_owed_nothing(&self) -> bool {
        self.under_way.is_empty() && self.is_answered()
    }

    fn receive(&mut self, bytes: &[u8]) {
        self.heard = clock::instant();
        self.is_fresh = false;
        self.is_lost = false;
        self.permit.heard();
        let state = self.port.gripper.state();
        self.device.receive(self.heard, bytes, &state);
        // A longer datagram comes in several pieces, of which the last one is shorter.
        let is_datagram = self.silence.is_some();
        if is_datagram && bytes.len() < READ_BYTES {
            self.device.end_datagram(self.heard, &state);
        }
    }

    /// Reads bytes that have already arrived.
    fn read_now(&mut self) -> Option<std::io::Result<usize>> {
        let mut incoming = vec![0; READ_BYTES];
        let read = self.reader.read(&mut incoming).now_or_never()?;
        if let Ok(bytes) = read {
            self.receive(incoming.get(..bytes).unwrap_or_default());
        }
        Some(read)
    }

    /// Starts all orders one after the other, so that the gripper gets them in this order.
    fn start_orders(&mut self) {
        while let Some(refused) = self.device.poll_refused() {
            self.refusals.record(&self.port, &self.client, &refused);
        }
        while let Some(ordered) = self.device.poll_order() {
            self.uses_scripts |= matches!(&ordered.order, PortOrder::Exchange(wsg::Command::Custom(custom))
                if !self.port.gripper.only_reads(custom.id()));
            let is_late = self.is_too_late(&ordered.order);
            let allowed = rights::check(&self.port, self.address, &ordered.order);
            if is_late || allowed.is_err() {
                let ask = ordered.ask;
                let status = Status::E_ACCESS_DENIED;
                if let Some(cause) = allowed.err().filter(|_| !is_late) {
                    self.refusals.record(&self.port, &self.client, &Refused { id: ask.id, status, cause });
                }
                self.answer(ask, PortReply::Refused(RefusedStatus { status, fast_stop: None }));
                continue;
            }
            let step = self.step_of(ordered);
            self.begin(step);
        }
    }

    fn begin(&mut self, mut step: BoxFuture<'static, Step>) {
        match (&mut step).now_or_never() {
            Some(step) => self.take(step),
            None => self.under_way.push(step),
        }
    }

    fn step_of(&self, PortOrdered { ask, order }: PortOrdered) -> BoxFuture<'static, Step> {
        let gripper = self.port.gripper.clone();
        let client = self.client.clone();
        let token = self.token.clone();
        let order = match order {
            PortOrder::Exchange(wsg::Command::Custom(custom)) if gripper.custom_ids().stream.contains(&custom.id()) => {
                PortOrder::Command(Action::Motion(Motion::Custom(custom)))
            }
            order => order,
        };
        match order {
            PortOrder::Command(action) => {
                // A Stop needs no lease.
                let lease = matches!(action, Action::Motion(_)).then_some(token);
                let submission = Submission { client, action, request_id: None, lease };
                async move {
                    match gripper.submit(submission).await {
                        Ok(ticket) => Step::Admitted(ask, ticket),
                        Err(rejection) => Step::Rejected(ask, rejection, true),
                    }
                }
                .boxed()
            }
            PortOrder::FastStop => async move {
                let stopped = gripper.fast_stop(FastStopId::generate(), client, Reason::truncated("23h")).await;
                Step::Answered(ask, PortReply::FastStopped(stopped))
            }
            .boxed(),
            PortOrder::Acknowledge(id) => async move {
                match acknowledge(&gripper, id, client).await {
                    Ok(()) => Step::Answered(ask, PortReply::Reply(Reply::Success(Data::None))),
                    Err(rejection) => Step::Rejected(ask, rejection, true),
                }
            }
            .boxed(),
            PortOrder::AcknowledgeFault => async move {
                match gripper.acknowledge_fault(client, Some(token)).await {
                    Err(Rejection::Invalid(_) | Rejection::Conflict(Conflict::FastStop { .. })) => {
                        Step::Answered(ask, PortReply::NoFault)
                    }
                    // A fault under another client's lease is for that client. Many drivers start by 24h and expect
                    // success while nothing is latched.
                    Ok(())
                    | Err(Rejection::Conflict(
                        Conflict::LeaseHeld { .. }
                        | Conflict::Reserved { .. }
                        | Conflict::LeaseBound { .. }
                        | Conflict::LeaseTokenMissing { .. }
                        | Conflict::StaleLease { .. },
                    )) => Step::Answered(ask, PortReply::Reply(Reply::Success(Data::None))),
                    Err(rejection) => Step::Rejected(ask, rejection, true),
                }
            }
            .boxed(),
            PortOrder::Exchange(command) => {
                let (accepted, is_accepted) = oneshot::channel();
                let mut exchanged = async move {
                    // Refused reads are not recorded.
                    let changes = !command.is_read();
                    match gripper.exchange_in_steps(command, client, Some(token), accepted).await {
                        Ok(data) => Step::Answered(ask, PortReply::Reply(Reply::Success(data.of_reply(ask.id)))),
                        Err(rejection) => Step::Rejected(ask, rejection, changes),
                    }
                }
                .boxed();
                let begun = async move {
                    tokio::select! {
                        biased;
                        Ok(()) = is_accepted => Step::Begun(ask, exchanged),
                        step = &mut exchanged => step,
                    }
                };
                begun.boxed()
            }
            PortOrder::Release => async move {
                let _ = gripper.release_lease(Some(token)).await;
                Step::Answered(ask, PortReply::Reply(Reply::Success(Data::None)))
            }
            .boxed(),
        }
    }

    fn take(&mut self, step: Step) {
        match step {
            Step::Answered(ask, answer) => self.answer(ask, answer),
            Step::Begun(ask, rest) => {
                // If the next request waits for the final reply, the client expects no other reply.
                if !ask.is_awaited {
                    self.answer(ask, PortReply::Accepted);
                }
                self.begin(rest);
            }
            Step::Rejected(ask, rejection, is_recorded) => {
                let refusal = RefusedStatus::from(&rejection);
                if is_recorded {
                    self.refusals.record_rejection(&self.port, &self.client, ask.id, refusal.status, &rejection);
                }
                self.answer(ask, PortReply::Refused(refusal));
            }
            Step::Admitted(ask, mut ticket) => {
                if ask.id != id::STOP {
                    self.keep();
                }
                let accepted = async move {
                    let command = Box::new(ticket.accepted().await);
                    Step::Accepted(ask, ticket, command)
                };
                self.begin(accepted.boxed());
            }
            Step::Accepted(ask, ticket, command) => self.accepted(ask, ticket, &command),
            Step::Kept(granted) => {
                self.kept = granted.and_then(|granted| {
                    Some(Kept {
                        epoch: granted.lease.epoch,
                        _keep: granted.keep?,
                        _pin: self.permit.claim(Class::Pinned),
                    })
                });
            }
        }
    }

    /// Handles a command that was accepted, or that ended before that.
    fn accepted(&mut self, ask: PortRequest, mut ticket: Ticket, command: &CommandReport) {
        // A motion that was stopped before it was sent gets the same replies as one stopped right after.
        let was_stopped = id::is_motion(ask.id) && command.outcome == Some(Outcome::Aborted);
        let is_two_step = command.accepted || was_stopped;
        let mut end = ask;
        if is_two_step {
            self.answer(ask, PortReply::Accepted);
            end = PortRequest { is_awaited: false, ..ask };
        }
        if command.phase == Phase::Done {
            return self.answer(end, PortReply::of_end(command));
        }
        let ended = async move { Step::Answered(end, PortReply::of_end(&ticket.ended().await)) };
        self.begin(ended.boxed());
    }

    fn answer(&mut self, ask: PortRequest, answer: PortReply) {
        self.device.answer(clock::instant(), ask, answer, &self.port.gripper.state());
    }
}
