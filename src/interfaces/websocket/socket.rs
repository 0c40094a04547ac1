//! One client's socket: its requests, its leases and its liveness.
//!
//! Nothing here waits for the client. Responses queue in the [`Outbox`], whose bytes are bounded. Requests are still
//! read meanwhile, so that a FAST STOP works even if its client reads nothing. Urgent calls and changes of a gripper
//! run here; all others run on the observers' runtime.

use std::collections::HashMap;
use std::io;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures_util::future::{BoxFuture, FutureExt as _, join_all};
use futures_util::stream::{FuturesUnordered, StreamExt as _};
use tokio::time::{Instant, Interval, MissedTickBehavior, sleep_until};
use tokio_tungstenite::WebSocketStream;
use tokio_tungstenite::tungstenite::protocol::frame::Frame;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;
use tokio_tungstenite::tungstenite::protocol::{Role, WebSocketConfig};
use tokio_tungstenite::tungstenite::{Error as WsError, Message};
use tokio_util::task::AbortOnDropHandle;

use super::bodies;
use super::message_results::{Answered, MessageResult, raw};
use super::outbox::Outbox;
use super::rpc::{self, Incoming, RpcCall, RpcError, RpcMethod, RpcResponse};
use super::socket_end::{SocketEnd, TOO_LONG, end_of};
use super::split_connection::{self, Inbound};
use super::writer::Writer;
use crate::access::{Right, Visitor};
use crate::connections::admission::{Claim, Class, ConnectionPermit, HeldBytes};
use crate::connections::client_stream::ClientStream;
use crate::connections::metrics::Connected;
use crate::connections::pace::RequestPace;
use crate::events::{Notification, encoded, text_frame};
use crate::interfaces::Context;
use crate::model::{Client, CommandReport, LossCause, Name, Urgency};
use crate::operations::gripper::lease;
use crate::operations::parameters::json::{MAX_BODY_BYTES, MAX_OVERSIZED_BYTES};
use crate::operations::{Caller, Code, ConnectionLease, Method, Problem, require};

const PINGED_EVERY: Duration = Duration::from_secs(1);

/// Unanswered pings after which a client is lost. Counting pings instead of time keeps clients when the gateway itself
/// was starved of processor time.
const MAX_UNANSWERED: u32 = 3;

/// Maximum number of concurrent requests of one client. More are refused as `overloaded`, except FAST STOPs.
const MAX_CALLS: usize = 32;

/// Maximum number of concurrent requests including FAST STOPs. At this limit the socket is not read. Each FAST STOP
/// ends within 250 ms, and the grippers are already being stopped.
const MAX_CALLS_AND_FAST_STOPS: usize = 36;

/// Memory cost of a running request besides its text.
const CALL_BYTES: usize = 4 * 1024;

/// Maximum number of commands of one client whose end is reported. The client must ask for the end of further ones.
const MAX_COMMANDS: usize = 64;

/// Read buffer size: requests are small, and there can be a thousand clients.
const READ_BYTES: usize = 1024;

/// A connection after its upgrade to a WebSocket.
pub struct Connection {
    pub stream: ClientStream,
    /// Bytes that arrived directly after the handshake.
    pub early: Bytes,
    pub permit: Option<Arc<ConnectionPermit>>,
    /// Held until the socket has ended, even if the HTTP connection ends earlier.
    pub claim: Option<Claim>,
}

pub struct Socket {
    pub(super) client: Client,
    visitor: Visitor,
    /// Whether the client has ever subscribed to updates.
    is_subscribed: bool,
    context: Context,
    pub(super) permit: Option<Arc<ConnectionPermit>>,
    pub(super) outbox: Arc<Outbox>,
    pub(super) writer: AbortOnDropHandle<io::Result<()>>,
    pub(super) incoming: WebSocketStream<Inbound>,
    pub(super) calls: FuturesUnordered<BoxFuture<'static, MessageResult>>,
    /// Number of requests in `calls`, where a batch is one call with several requests.
    under_way: usize,
    /// Bytes of the running requests.
    request_bytes: usize,
    held: Option<HeldBytes>,
    /// Commands that were answered but have not ended.
    running: FuturesUnordered<BoxFuture<'static, CommandReport>>,
    /// The newest lease of each gripper that was taken on this socket. Unless released, a lease is lost with the
    /// socket. A connection with a lease is not evicted.
    pub(super) leases: HashMap<Name, (Arc<ConnectionLease>, Option<Claim>)>,
    pings: Interval,
    /// Pings since the client last sent anything.
    unanswered: u32,
    pace: Arc<RequestPace>,
    /// Time until which the socket is not read, because its client exceeded the rate limit.
    paused_until: Option<Instant>,
    _connected: Connected,
    /// Dropped after the descriptors.
    _claim: Option<Claim>,
}

/// Serves a connection until its end. A task takes as much memory as its future ever needs, so the large parts are
/// boxed.
pub fn serve(
    connection: Connection,
    client: (Client, Visitor),
    context: Context,
) -> impl Future<Output = ()> + Send + 'static {
    let socket = Box::pin(Socket::new(connection, client, context));
    async {
        match socket.await {
            Ok(socket) => socket.run().await,
            Err(error) => tracing::debug!(%error, "WebSocket could not be started"),
        }
    }
}

impl Socket {
    async fn new(
        Connection { stream, early, permit, claim }: Connection,
        (client, visitor): (Client, Visitor),
        context: Context,
    ) -> io::Result<Box<Self>> {
        let runtimes = &context.runtimes;
        let (reader, writer) = split_connection::split(stream, &runtimes.sockets, &runtimes.observers)?;
        let outbox = Arc::new(Outbox::new(permit.as_ref().map(ConnectionPermit::held)));
        let inbound = Inbound::new(early, reader, outbox.clone(), permit.as_ref().map(ConnectionPermit::held));
        let writer = Writer::new(writer, outbox.clone(), context.metrics.clone());
        let writer = AbortOnDropHandle::new(runtimes.observers.spawn(writer.run()));
        let bounds = WebSocketConfig::default()
            .read_buffer_size(READ_BYTES)
            .max_message_size(Some(MAX_OVERSIZED_BYTES))
            .max_frame_size(Some(MAX_OVERSIZED_BYTES));
        let incoming = WebSocketStream::from_raw_socket(inbound, Role::Server, Some(bounds)).await;
        let mut pings = tokio::time::interval(PINGED_EVERY);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Ok(Box::new(Self {
            client,
            visitor,
            is_subscribed: false,
            held: permit.as_ref().map(ConnectionPermit::held),
            permit,
            outbox,
            writer,
            incoming,
            calls: FuturesUnordered::new(),
            under_way: 0,
            request_bytes: 0,
            running: FuturesUnordered::new(),
            leases: HashMap::new(),
            pings,
            unanswered: 0,
            pace: Arc::default(),
            paused_until: None,
            _connected: context.metrics.connected(),
            _claim: claim,
            context,
        }))
    }

    /// Reads and answers requests until the socket ends.
    pub(super) async fn read(&mut self) -> SocketEnd {
        let permit = self.permit.clone();
        let evicted = async {
            match permit {
                Some(permit) => permit.evicted().await,
                None => std::future::pending().await,
            }
        };
        let mut evicted = std::pin::pin!(evicted);
        loop {
            let may_read = self.under_way < MAX_CALLS_AND_FAST_STOPS && self.paused_until.is_none();
            let paused_until = self.paused_until.unwrap_or_else(Instant::now);
            tokio::select! {
                biased;
                // Begins a call before its socket can end.
                Some(done) = self.calls.next() => self.take_done(done),
                () = self.context.closing.cancelled() => return SocketEnd::Closing,
                () = evicted.as_mut() => return if self.context.closing.is_cancelled() { SocketEnd::Closing } else { SocketEnd::Evicted },
                _ = &mut self.writer => return SocketEnd::Unwritable,
                Some(command) = self.running.next() => {
                    if let Some(ended) = Notification::new("command", &command) {
                        self.outbox.push(ended.frame());
                    }
                }
                message = self.incoming.next(), if may_read => match self.take_message(message) {
                    None => {}
                    Some(end) => return end,
                },
                () = sleep_until(paused_until), if self.paused_until.is_some() => self.paused_until = None,
                _ = self.pings.tick() => {
                    // A connection that has lost its lease to another client can be evicted again.
                    self.leases.retain(|_, (lease, _)| lease.is_held());
                    if self.unanswered >= MAX_UNANSWERED {
                        return SocketEnd::Lost;
                    }
                    let access = &self.context.gateway.access;
                    if !self.visitor.is_known(access) || (self.is_subscribed && !self.visitor.may_read(access)) {
                        return SocketEnd::Violation(CloseCode::Policy, "the client's credential is no longer valid");
                    }
                    self.lose_forbidden_leases();
                    self.unanswered += 1;
                    self.outbox.push(encoded(Frame::ping(Bytes::new())));
                }
            }
            if self.outbox.has_overflown() {
                return SocketEnd::Violation(CloseCode::Policy, "too many unread responses");
            }
        }
    }

    /// Ends the leases of grippers that the client may no longer move, as if their holder were lost.
    fn lose_forbidden_leases(&mut self) {
        let identity = self.visitor.identity(&self.context.gateway.access);
        for (gripper, (lease, _)) in &mut self.leases {
            if identity.as_ref().is_ok_and(|identity| identity.may(Right::Operate, Some(gripper))) {
                continue;
            }
            // The lease stays in the list until it is lost, in case the socket ends before, but nothing keeps it alive.
            *lease = Arc::new(lease.without_keep());
            let lease = lease.clone();
            self.calls.push(
                async move {
                    lease.lose(LossCause::Forbidden).await;
                    MessageResult::default()
                }
                .boxed(),
            );
        }
    }

    /// Processes a message from the client. Returns the reason if the message ends the socket.
    fn take_message(&mut self, message: Option<Result<Message, WsError>>) -> Option<SocketEnd> {
        self.unanswered = 0;
        self.paused_until = self.pace.due(Instant::now(), false);
        self.incoming.get_mut().taken();
        match message {
            Some(Ok(message)) if message.len() > MAX_BODY_BYTES => {
                let payload = message.into_data();
                let text = String::from_utf8_lossy(&payload);
                // The length of a reason must not keep the fingers moving.
                if rpc::has_fast_stop(&text) {
                    self.take_requests(&text);
                }
                return Some(TOO_LONG);
            }
            Some(Ok(Message::Text(text))) => self.take_requests(&text),
            Some(Ok(Message::Binary(bytes))) => {
                // A reason in another encoding must not keep the fingers moving.
                let text = String::from_utf8_lossy(&bytes);
                if !rpc::has_fast_stop(&text) {
                    return Some(SocketEnd::Violation(
                        CloseCode::Unsupported,
                        "binary frames are not supported, except a FAST STOP",
                    ));
                }
                self.take_requests(&text);
            }
            Some(Ok(Message::Ping(_) | Message::Pong(_) | Message::Frame(_))) => {}
            Some(Err(error)) => return Some(end_of(&error)),
            Some(Ok(Message::Close(_))) | None => return Some(SocketEnd::Closed),
        }
        None
    }

    fn take_requests(&mut self, text: &str) {
        let (calls, is_batch) = match rpc::parse(text) {
            Incoming::One(call) => (vec![call], false),
            Incoming::Batch(calls) => (calls, true),
        };
        let requests = calls.len();
        let bytes = text.len();
        self.under_way += requests;
        self.request_bytes += bytes;
        self.count();
        let answered: Vec<_> = calls.into_iter().map(|call| self.answered(call)).collect();
        let done = join_all(answered)
            .map(move |answered| MessageResult { bytes, ..MessageResult::of(requests, answered, is_batch) });
        self.calls.push(done.boxed());
    }

    /// Updates the count of bytes held by running requests.
    fn count(&mut self) {
        if let Some(held) = &mut self.held {
            held.set(self.request_bytes + self.under_way * CALL_BYTES);
        }
    }

    /// Begins a request.
    pub(super) fn answered(&self, call: Result<RpcCall, RpcResponse>) -> BoxFuture<'static, Answered> {
        let RpcCall { id, method, params, label } = match call {
            Ok(call) => call,
            Err(answer) => return ready(Answered { answer: Some(answer), ..Answered::default() }),
        };
        if let Some(detail) = self.overload().filter(|_| !method.is_fast_stop()) {
            return ready(Answered::new(id, Err(Problem::new(Code::Overloaded, detail))));
        }
        let method = match method {
            RpcMethod::Operation(method) => method,
            RpcMethod::Subscribe => {
                let allowed = self.check_read().and_then(|()| bodies::subscribe(&self.context.gateway, &params));
                return ready(match allowed {
                    Ok((body, following)) => Answered {
                        answer: id.map(|id| RpcResponse::new(id, raw(&body))),
                        following: Some(following),
                        lease: None,
                        running: None,
                    },
                    Err(problem) => Answered::new(id, Err(problem)),
                });
            }
            RpcMethod::Unknown(problem) => {
                let error = RpcError::no_method(problem);
                return ready(Answered {
                    answer: id.map(|id| RpcResponse::new(id, Err(error))),
                    ..Answered::default()
                });
            }
        };
        if method == Method::from(&lease::TAKE) && id.is_none() {
            // A request without an id gets no response, so nobody would get the token.
            return ready(Answered::default());
        }
        let (gateway, client, metrics) =
            (self.context.gateway.clone(), self.client.clone(), self.context.metrics.clone());
        let identity = self.visitor.identity(&gateway.access);
        let urgency = method.urgency();
        let is_change = method.operations().any(|operation| operation.changes_something() && operation.is_of_gripper());
        let pace = self.pace.clone();
        let answered = async move {
            // The FAST STOPs of a batch arrive all at once.
            if urgency == Urgency::FastStop {
                pace.next_fast_stop().await;
            }
            let caller = Caller::new(client, identity).labelled(label.as_deref());
            let result = crate::operations::call(&gateway, caller, method, params).await;
            let status = result.as_ref().map_or_else(|problem| problem.status().as_u16(), |_| 200);
            metrics.answered(Some(method.name()), "CALL", status);
            Answered::new(id, result)
        };
        // A call that panicked gets no response. A FAST STOP runs to its end even without the socket.
        if urgency == Urgency::FastStop {
            return tokio::spawn(answered).map(Result::unwrap_or_default).boxed();
        }
        // Changes of a gripper start in the order of their requests: a Stop must not overtake the motion before it.
        if urgency != Urgency::None || is_change {
            let mut answered = AssertUnwindSafe(answered).catch_unwind().map(Result::unwrap_or_default).boxed();
            if urgency != Urgency::Stop {
                return answered;
            }
            // Once begun, a Stop runs to its end even without the socket.
            return async move {
                match (&mut answered).now_or_never() {
                    Some(answered) => answered,
                    None => tokio::spawn(answered).await.unwrap_or_default(),
                }
            }
            .boxed();
        }
        let answered = AbortOnDropHandle::new(self.context.runtimes.observers.spawn(answered));
        answered.map(Result::unwrap_or_default).boxed()
    }

    /// Checks that the client may receive updates.
    fn check_read(&self) -> Result<(), Problem> {
        require(&self.visitor.identity(&self.context.gateway.access)?, Right::Read, None)
    }

    /// Returns why this client can't start another request now, if it can't.
    fn overload(&self) -> Option<String> {
        if self.outbox.is_backlogged() {
            return Some("too many unread responses on this socket: read them first".to_owned());
        }
        (self.under_way > MAX_CALLS)
            .then(|| format!("too many requests on this socket ({MAX_CALLS} in progress): wait for their responses"))
    }

    pub(super) fn take_done(&mut self, done: MessageResult) {
        self.under_way -= done.requests;
        self.request_bytes -= done.bytes;
        self.count();
        let answer = done.answer.map(text_frame);
        if let Some(following) = done.following {
            self.is_subscribed = true;
            self.outbox.follow(following, answer);
        } else if let Some(answer) = answer {
            self.outbox.push(answer);
        }
        for mut ticket in done.running {
            if self.running.len() < MAX_COMMANDS {
                self.running.push(async move { ticket.ended().await }.boxed());
            }
        }
        for lease in done.leases {
            let pin = self.permit.as_ref().and_then(|permit| permit.claim(Class::Pinned));
            self.leases.insert(lease.gripper().clone(), (lease, pin));
        }
    }
}

fn ready(answered: Answered) -> BoxFuture<'static, Answered> {
    std::future::ready(answered).boxed()
}
