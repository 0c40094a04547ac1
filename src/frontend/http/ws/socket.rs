//! One client's socket: its requests, its updates, and whether it is still there.
//!
//! Nothing here waits for the client. Answers wait for it, and are bounded; while some do, updates are left where they
//! are: states and telemetry are replaced by newer ones there, and events and frames fall behind and are told as a gap.
//! Requests are read meanwhile, so that a FAST STOP of a client that reads nothing stops all the same.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, WebSocket, close_code};
use axum::http::{HeaderMap, StatusCode};
use futures_util::future::{BoxFuture, FutureExt as _, join_all};
use futures_util::stream::{FuturesUnordered, SplitStream, StreamExt as _};
use serde_json::value::{RawValue, to_raw_value};
use tokio::time::{Interval, MissedTickBehavior, timeout};
use tokio_tungstenite::tungstenite;

use super::bodies::{self, Following};
use super::outgoing::Outgoing;
use super::rpc::{self, Answer, Call, Incoming};
use crate::frontend::http::Context;
use crate::frontend::http::errors::{Code, Problem};
use crate::frontend::http::lease::Taken;
use crate::frontend::http::methods::{Methods, Refusal, Wait, is_fast_stop};
use crate::frontend::metrics::Connected;
use crate::frontend::updates::{Notification, Pace, Subscription};
use crate::gripper::Ticket;
use crate::gripper::model::{Client, Command, Name};

/// How often a client is asked for a sign of life.
const PINGED_EVERY: Duration = Duration::from_secs(1);

/// And after how many in a row without one it is lost: pings are counted, and not time, so that nobody is lost because
/// the gateway itself got no processor time.
const MAX_UNANSWERED: u32 = 3;

/// Requests of one client that may be under way. More are refused as `overloaded`, but for FAST STOPs.
const MAX_CALLS: usize = 32;

/// With FAST STOPs, each of which ends within 250 ms: more are read then.
const MAX_CALLS_AND_FAST_STOPS: usize = 64;

/// Answers that may wait for a client to read them. Requests but for FAST STOPs are refused as `overloaded` then; they
/// are read all the same, since a FAST STOP may be behind them.
const MAX_UNREAD: usize = 64;

/// And of all answers: who goes on asking without reading is sent away.
const MAX_WAITING: usize = 1024;

/// Commands of one client whose end is waited for. The end of more is not told, and has to be asked for.
const MAX_COMMANDS: usize = 64;

/// Updates that are gathered for one write.
const MAX_GATHERED: usize = 64;

/// How long a farewell may take.
const FAREWELL_WITHIN: Duration = Duration::from_secs(1);

/// The method whose answer has a token.
const TAKE: &str = "lease.take";

/// A client's socket.
pub struct Socket {
    client: Client,
    methods: Methods,
    context: Arc<Context>,
    outgoing: Outgoing,
    incoming: SplitStream<WebSocket>,
    calls: FuturesUnordered<BoxFuture<'static, Done>>,
    /// How many requests `calls` are: a batch is one of them.
    under_way: usize,
    /// Commands that were answered, and have not ended.
    running: FuturesUnordered<BoxFuture<'static, Command>>,
    following: Option<(Subscription, Pace)>,
    /// The newest of each gripper that was taken here. It is lost with the socket, unless it was released.
    leases: HashMap<Name, Arc<Taken>>,
    pings: Interval,
    /// Pings since anything came from the client.
    unanswered: u32,
    _connected: Connected,
}

/// A message that was worked off.
#[derive(Default)]
struct Done {
    requests: usize,
    answer: Option<String>,
    running: Vec<Ticket>,
    leases: Vec<Arc<Taken>>,
    following: Option<Following>,
}

/// One request of it.
#[derive(Default)]
struct Answered {
    answer: Option<Answer>,
    running: Option<Ticket>,
    lease: Option<Arc<Taken>>,
    following: Option<Following>,
}

/// Why a socket ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    /// The gateway ends.
    Closing,
    /// The client has closed it, or is gone.
    Closed,
    /// The client gives no sign of life.
    Lost,
    /// The client sends what is not spoken here.
    Unspoken(u16, &'static str),
}

impl Socket {
    pub fn new(socket: WebSocket, client: Client, methods: Methods, context: &Arc<Context>) -> Self {
        let (sink, incoming) = socket.split();
        let mut pings = tokio::time::interval(PINGED_EVERY);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        Self {
            client,
            methods,
            context: context.clone(),
            outgoing: Outgoing::new(sink),
            incoming,
            calls: FuturesUnordered::new(),
            under_way: 0,
            running: FuturesUnordered::new(),
            following: None,
            leases: HashMap::new(),
            pings,
            unanswered: 0,
            _connected: context.ws_metrics.connected(),
        }
    }

    /// Serves it until its end.
    pub async fn run(mut self) {
        let end = self.serve().await;
        tracing::debug!(client = %self.client.subject, ?end, "a WebSocket has ended");
        // A gateway that ends has given its grippers up already.
        for lease in self.leases.values().filter(|_| end != End::Closing) {
            lease.lose().await;
        }
        let (code, reason) = match end {
            End::Closing => (close_code::AWAY, "the gateway ends"),
            End::Lost => (close_code::POLICY, "pings were not answered"),
            End::Unspoken(code, reason) => (code, reason),
            End::Closed => (close_code::NORMAL, ""),
        };
        if end != End::Closed {
            self.outgoing.push(Message::Close(Some(CloseFrame { code, reason: reason.into() })));
        }
        let farewell = async {
            // Whoever is gone hears nothing of it.
            if self.outgoing.write().await.is_ok() {
                while let Some(Ok(_)) = self.incoming.next().await {}
            }
        };
        let _ = timeout(FAREWELL_WITHIN, farewell).await;
    }

    async fn serve(&mut self) -> End {
        loop {
            let may_tell = self.outgoing.is_idle();
            let may_read = self.under_way < MAX_CALLS_AND_FAST_STOPS;
            tokio::select! {
                biased;
                () = self.context.closing.cancelled() => return End::Closing,
                Some(done) = self.calls.next() => {
                    self.take_done(done);
                    if self.outgoing.waiting() > MAX_WAITING {
                        return End::Unspoken(close_code::POLICY, "answers are not read");
                    }
                }
                Some(command) = self.running.next() => self.tell(Notification::new("command", &command)),
                message = self.incoming.next(), if may_read => match self.take_message(message) {
                    None => {}
                    Some(end) => return end,
                },
                written = self.outgoing.write(), if !may_tell => {
                    if written.is_err() {
                        return End::Closed;
                    }
                }
                _ = self.pings.tick() => {
                    if self.unanswered >= MAX_UNANSWERED {
                        return End::Lost;
                    }
                    self.unanswered += 1;
                    self.outgoing.push(Message::Ping(axum::body::Bytes::new()));
                }
                (told, dropped) = updates(&mut self.following), if may_tell => {
                    self.context.ws_metrics.dropped(dropped);
                    self.outgoing.push_all(told.into_iter().map(|told| Message::Text(told.text())));
                }
            }
        }
    }

    fn tell(&mut self, told: Option<Notification>) {
        self.outgoing.push_all(told.map(|told| Message::Text(told.text())));
    }

    /// Takes what came from the client, unless that ends the socket.
    fn take_message(&mut self, message: Option<Result<Message, axum::Error>>) -> Option<End> {
        self.unanswered = 0;
        match message {
            Some(Ok(Message::Text(text))) => self.take_requests(rpc::parse(&text)),
            Some(Ok(Message::Ping(_) | Message::Pong(_))) => {}
            Some(Ok(Message::Binary(_))) => return Some(End::Unspoken(close_code::UNSUPPORTED, "only text is read")),
            Some(Err(error)) => return Some(end_of(error)),
            Some(Ok(Message::Close(_))) | None => return Some(End::Closed),
        }
        None
    }

    fn take_requests(&mut self, incoming: Incoming) {
        let (calls, is_batch) = match incoming {
            Incoming::One(call) => (vec![call], false),
            Incoming::Batch(calls) => (calls, true),
        };
        let requests = calls.len();
        self.under_way += requests;
        let answered: Vec<_> = calls.into_iter().map(|call| self.answered(call)).collect();
        self.calls.push(join_all(answered).map(move |answered| Done::of(requests, answered, is_batch)).boxed());
    }

    /// Begins a request.
    fn answered(&self, call: Result<Call, Answer>) -> BoxFuture<'static, Answered> {
        let ready = |answered| std::future::ready(answered).boxed();
        let Call { id, method, params } = match call {
            Ok(call) => call,
            Err(answer) => return ready(Answered { answer: Some(answer), ..Answered::default() }),
        };
        let refused = |problem: Problem| Err(rpc::Error::from(Refusal::from(problem)));
        if let Some(detail) = self.overload().filter(|_| !is_fast_stop(&method)) {
            let refused = refused(Problem::new(Code::Overloaded, detail));
            return ready(Answered { answer: id.map(|id| Answer::new(id, refused)), ..Answered::default() });
        }
        if method == "subscribe" {
            return ready(
                match bodies::subscribe(&self.context, &params).map(|(told, following)| (raw(&told), following)) {
                    Ok((told, following)) => Answered {
                        answer: id.map(|id| Answer::new(id, told)),
                        following: Some(following),
                        lease: None,
                        running: None,
                    },
                    Err(problem) => {
                        Answered { answer: id.map(|id| Answer::new(id, refused(problem))), ..Answered::default() }
                    }
                },
            );
        }
        if !Methods::has(&method) {
            let names = "there is no such method: the API's description has them all";
            let error = rpc::Error::no_method(Problem::new(Code::NotFound, names).into());
            return ready(Answered { answer: id.map(|id| Answer::new(id, Err(error))), ..Answered::default() });
        }
        if method == TAKE && id.is_none() {
            // Nobody would hear its token.
            return ready(Answered::default());
        }
        let (methods, client, metrics) = (self.methods.clone(), self.client.clone(), self.context.ws_metrics.clone());
        async move {
            let told = methods.call(client, &method, params, Wait::No, HeaderMap::new()).await;
            let status = told.as_ref().map_or_else(|refusal| refusal.status, |_| StatusCode::OK);
            metrics.answered(Some(&method), "CALL", status.as_u16());
            match told {
                Ok(told) => Answered {
                    // Who doesn't hear of its beginning hears nothing of its end.
                    running: told.running.filter(|_| id.is_some()),
                    answer: id.map(|id| Answer::new(id, Ok(told.body))),
                    lease: told.lease,
                    following: None,
                },
                Err(refusal) => {
                    Answered { answer: id.map(|id| Answer::new(id, Err(refusal.into()))), ..Answered::default() }
                }
            }
        }
        .boxed()
    }

    /// Why this client may begin nothing more for now, if so.
    fn overload(&self) -> Option<String> {
        if self.outgoing.waiting() >= MAX_UNREAD {
            return Some(format!("{MAX_UNREAD} answers of this socket wait to be read: read them first"));
        }
        (self.under_way > MAX_CALLS)
            .then(|| format!("{MAX_CALLS} requests of this socket are under way already: await their answers first"))
    }

    fn take_done(&mut self, done: Done) {
        self.under_way -= done.requests;
        self.outgoing.push_all(done.answer.map(|answer| Message::Text(answer.into())));
        for mut ticket in done.running {
            if self.running.len() < MAX_COMMANDS {
                self.running.push(async move { ticket.ended().await }.boxed());
            }
        }
        self.leases.extend(done.leases.into_iter().map(|lease| (lease.gripper().clone(), lease)));
        if let Some(Following { updates, max_hz }) = done.following {
            self.following = Some((updates, Pace::new(max_hz as u32)));
        }
    }
}

impl Done {
    fn of(requests: usize, all: Vec<Answered>, is_batch: bool) -> Self {
        let mut done = Self { requests, ..Self::default() };
        let mut answers = Vec::new();
        for answered in all {
            answers.extend(answered.answer);
            done.running.extend(answered.running);
            done.leases.extend(answered.lease);
            done.following = answered.following.or(done.following);
        }
        let json = match answers.as_slice() {
            [] => return done,
            [answer] if !is_batch => serde_json::to_string(answer),
            answers => serde_json::to_string(answers),
        };
        done.answer = json.inspect_err(|error| tracing::error!(%error, "an answer has no JSON")).ok();
        done
    }
}

fn raw(told: &impl serde::Serialize) -> Result<Box<RawValue>, rpc::Error> {
    to_raw_value(told).map_err(|error| {
        rpc::Error::from(Refusal::from(Problem::new(Code::Internal, format!("the answer has no JSON: {error}"))))
    })
}

fn end_of(error: axum::Error) -> End {
    match error.into_inner().downcast_ref::<tungstenite::Error>() {
        Some(tungstenite::Error::Capacity(_)) => End::Unspoken(close_code::SIZE, "a message has 64 KiB at most"),
        Some(tungstenite::Error::Utf8(_)) => End::Unspoken(close_code::INVALID, "text is UTF-8"),
        Some(tungstenite::Error::Protocol(tungstenite::error::ProtocolError::ResetWithoutClosingHandshake)) => {
            End::Closed
        }
        Some(tungstenite::Error::Protocol(_)) => End::Unspoken(close_code::PROTOCOL, "this is no WebSocket"),
        _ => End::Closed,
    }
}

/// What is to be told next: the newest states and telemetry when their time has come, or events and frames, with what
/// else of them is there already; and how many were dropped for newer ones. Cancelled without loss.
async fn updates(following: &mut Option<(Subscription, Pace)>) -> (Vec<Notification>, u64) {
    let Some((updates, pace)) = following else { return std::future::pending().await };
    let has_states = updates.has_states();
    let mut told = tokio::select! {
        biased;
        missed = pace.next(), if has_states => return updates.newest(missed),
        Some(told) = updates.next() => vec![told],
        else => return std::future::pending().await,
    };
    while told.len() < MAX_GATHERED
        && let Some(Some(next)) = updates.next().now_or_never()
    {
        told.push(next);
    }
    (told, 0)
}
