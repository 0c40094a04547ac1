//! One client's connection: reads requests, performs their orders, and keeps the client's leases.

mod orders;
mod pending;
mod requests;

use std::collections::{BTreeMap, BTreeSet};
use std::convert::Infallible;
use std::io::{self, ErrorKind};
use std::net::IpAddr;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::BytesMut;
use futures_util::FutureExt as _;
use futures_util::future::BoxFuture;
use futures_util::stream::{FuturesUnordered, StreamExt as _};
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;
use tokio::net::tcp::{OwnedReadHalf, OwnedWriteHalf};
use tokio::time::{MissedTickBehavior, interval, sleep_until, timeout, timeout_at};
use tokio_modbus::prelude::ExceptionCode;
use tokio_util::codec::{FramedRead, LengthDelimitedCodec};
use tokio_util::sync::CancellationToken;

use super::adu::{self, Header};
use super::context::{ModbusContext, NewestSettings};
use super::image::Image;
use crate::connections::admission::{Claim, ConnectionPermit};
use crate::connections::pace::RequestPace;
use crate::model::clock;
use crate::model::{Client, LeaseToken, LossCause, Name};
use crate::operations::ConnectionLease;
use pending::{OrderStep, Unanswered};

/// Time limit for a client to receive a response.
const TAKEN_WITHIN: Duration = Duration::from_secs(1);

/// Time after which a connection without requests and leases is closed.
const IDLE_LIMIT: Duration = Duration::from_mins(1);

/// Requests that are read one after the other after a stall of the gateway.
const MAX_READ_AFTER_STALL: usize = 16;

/// Time in which the first bytes of an evicted client must arrive.
const FIRST_BYTES_WITHIN: Duration = Duration::from_millis(10);

/// Maximum number of requests that are searched for a FAST STOP after their client is gone.
const MAX_LAST_REQUESTS: usize = 256;

/// Maximum number of orders under way: enough for one every 10 ms while the journal takes its whole time limit. Further
/// requests wait, even those with a FAST STOP.
const MAX_UNDER_WAY: usize = 64;

/// Interval in which the rights of a lease holder are checked. A reload that fails half-way announces no new settings.
const RIGHTS_CHECKED_EVERY: Duration = Duration::from_secs(1);

/// Delay of a timer that shows a stall of the gateway.
const LATE: Duration = Duration::from_millis(20);

/// Time limit for the runtime to notice, after a stall, what has arrived.
const NOTICED_WITHIN: Duration = Duration::from_millis(100);

/// Time limit for the last commands of a disconnected client to be admitted or refused.
const LAST_COMMANDS_WITHIN: Duration = Duration::from_millis(500);

/// A client and its connection.
pub(super) struct ModbusConnection {
    context: Arc<ModbusContext>,
    settings: NewestSettings,
    client: Client,
    peer: IpAddr,
    permit: Arc<ConnectionPermit>,
    frames: FramedRead<OwnedReadHalf, LengthDelimitedCodec>,
    writer: OwnedWriteHalf,
    /// Lease token of motions that take a free lease.
    token: LeaseToken,
    leases: BTreeMap<Name, ClientLease>,
    /// Number of motions of each gripper that are taking the lease.
    claiming: BTreeMap<Name, u32>,
    /// The registers of each gripper and of the gateway.
    images: BTreeMap<Option<Name>, Image>,
    under_way: FuturesUnordered<BoxFuture<'static, OrderStep>>,
    /// The request that waits for its answer.
    unanswered: Option<Unanswered>,
    pace: RequestPace,
    /// Time before which no further request is read, because the client exceeds the rate limit.
    paced_until: Option<Instant>,
    heard: Instant,
    /// Whether the client has sent nothing yet.
    is_fresh: bool,
}

/// A lease that the connection keeps. Meanwhile, the connection is not evicted.
struct ClientLease {
    lease: Arc<ConnectionLease>,
    _pin: Option<Claim>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ConnectionEnd {
    /// The client has disconnected or is lost.
    Gone,
    /// The client speaks another protocol.
    Foreign,
    /// The gateway shuts down.
    Closing,
}

impl ModbusConnection {
    pub(super) fn new(
        context: Arc<ModbusContext>,
        settings: NewestSettings,
        (client, peer): (Client, IpAddr),
        permit: Arc<ConnectionPermit>,
        stream: TcpStream,
    ) -> Self {
        let (reader, writer) = stream.into_split();
        Self {
            context,
            settings,
            client,
            peer,
            permit,
            frames: FramedRead::new(reader, adu::frames()),
            writer,
            token: LeaseToken::generate(),
            leases: BTreeMap::new(),
            claiming: BTreeMap::new(),
            images: BTreeMap::new(),
            under_way: FuturesUnordered::new(),
            unanswered: None,
            pace: RequestPace::default(),
            paced_until: None,
            heard: clock::instant(),
            is_fresh: true,
        }
    }

    /// Serves the client until it is gone, or until `closing`.
    pub(super) async fn run(mut self, closing: CancellationToken) {
        let _connected = self.context.metrics.connected();
        // A panic must not keep the leases.
        match AssertUnwindSafe(self.serve(&closing)).catch_unwind().await {
            Ok(ConnectionEnd::Closing) => return,
            Ok(ConnectionEnd::Foreign) => {}
            Ok(ConnectionEnd::Gone) => self.take_last_fast_stops().await,
            Err(_) => {
                tracing::error!(client = %self.client.subject, "Modbus connection panicked");
                self.take_last_fast_stops().await;
            }
        }
        // Commands sent before the disconnect can still reach the gripper, and take a lease there.
        self.lose_leases().await;
        let ends = async {
            while let Some(step) = self.under_way.next().await {
                self.take(step);
            }
        };
        let _ = timeout(LAST_COMMANDS_WITHIN, ends).await;
        self.lose_leases().await;
    }

    /// Performs the FAST STOPs among the last requests that the client sent before it disconnected.
    async fn take_last_fast_stops(&mut self) {
        let mut stopped = BTreeSet::new();
        let slot = if self.is_fresh { self.permit.displaced() } else { None };
        let mut waits = if slot.is_some() { FIRST_BYTES_WITHIN } else { Duration::ZERO };
        for _ in 0..MAX_LAST_REQUESTS {
            let Ok(Some(Ok(frame))) = timeout(waits, self.frames.next()).await else { return };
            waits = Duration::ZERO;
            // Behind bytes that are not Modbus, nothing is a request.
            let Ok((header, request)) = adu::parse(frame.freeze()) else { return };
            self.perform_fast_stops(header, request, &mut stopped);
        }
    }

    async fn serve(&mut self, closing: &CancellationToken) -> ConnectionEnd {
        match self.serve_requests(closing).await {
            Ok(never) => match never {},
            Err(end) => end,
        }
    }

    async fn serve_requests(&mut self, closing: &CancellationToken) -> Result<Infallible, ConnectionEnd> {
        let permit = self.permit.clone();
        // The futures are kept, since each request would cost a new one.
        let closed = closing.cancelled();
        let evicted = permit.evicted();
        let timer = sleep_until(self.due().into());
        tokio::pin!(closed, evicted, timer);
        let mut rights_checks = interval(RIGHTS_CHECKED_EVERY);
        rights_checks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            // Another client's turn, since its next request can be a FAST STOP.
            tokio::task::yield_now().await;
            self.leases.retain(|_, held| held.lease.is_held());
            let holds_lease = !self.leases.is_empty();
            let is_free = self.is_free();
            let due = self.due().into();
            // A later deadline takes effect when the timer fires.
            if due < timer.deadline() || timer.is_elapsed() {
                timer.as_mut().reset(due);
            }
            tokio::select! {
                biased;
                () = &mut closed => return Err(ConnectionEnd::Closing),
                () = &mut evicted, if !holds_lease => return Err(ConnectionEnd::Gone),
                Some(step) = self.under_way.next() => {
                    self.take(step);
                    self.answer_if_ended().await?;
                }
                () = &mut timer => self.handle_timeout().await?,
                changed = self.settings.changed() => {
                    if !self.settings.now().peers.allows(self.peer) {
                        tracing::warn!(client = %self.client.subject, "Modbus client disconnected: the reloaded configuration does not allow its address");
                        return Err(ConnectionEnd::Gone);
                    }
                    changed.map_err(|_| ConnectionEnd::Closing)?;
                    self.lose_forbidden_leases();
                }
                _ = rights_checks.tick(), if holds_lease => self.lose_forbidden_leases(),
                frame = self.frames.next(), if is_free => self.receive(frame).await?,
            }
        }
    }

    /// Whether the next request can be performed.
    fn is_free(&self) -> bool {
        self.unanswered.is_none() && self.under_way.len() < MAX_UNDER_WAY && self.paced_until.is_none()
    }

    /// Time at which there is something to do without an input.
    fn due(&self) -> Instant {
        let answer_at = self.unanswered.as_ref().map(|unanswered| unanswered.until);
        let times = [answer_at, self.lost_at(), self.paced_until].into_iter().flatten();
        times.fold(self.heard + IDLE_LIMIT, Instant::min)
    }

    async fn handle_timeout(&mut self) -> Result<(), ConnectionEnd> {
        let now = clock::instant();
        self.paced_until.take_if(|until| *until <= now);
        if self.unanswered.as_ref().is_some_and(|unanswered| unanswered.until <= now) {
            self.answer().await?;
        }
        // After a stall of the gateway, heartbeats can be waiting, and the runtime may not have noticed them yet.
        let is_late = self.lost_at().is_some_and(|lost_at| lost_at + LATE < now);
        let until = if is_late { now + NOTICED_WITHIN } else { now };
        for _ in 0..MAX_READ_AFTER_STALL {
            if !self.is_free() {
                break;
            }
            let Ok(frame) = timeout_at(until.into(), self.frames.next()).await else { break };
            self.receive(frame).await?;
        }
        self.lose_silent(now);
        if self.heard + IDLE_LIMIT > now {
            return Ok(());
        }
        if self.leases.is_empty() {
            return Err(ConnectionEnd::Gone);
        }
        // A lease keeps the connection.
        self.heard = now;
        Ok(())
    }

    async fn receive(&mut self, frame: Option<io::Result<BytesMut>>) -> Result<(), ConnectionEnd> {
        let frame = match frame {
            Some(Ok(frame)) => frame.freeze(),
            // The announced length is one that no request has. The bytes are still in the buffer.
            Some(Err(error)) if error.kind() == ErrorKind::InvalidData => {
                self.context.foreign.closed(self.peer, self.frames.read_buffer());
                return Err(ConnectionEnd::Foreign);
            }
            Some(Err(_)) | None => return Err(ConnectionEnd::Gone),
        };
        self.heard = clock::instant();
        self.delay_next(self.pace.due(self.heard.into(), false));
        self.permit.heard();
        self.is_fresh = false;
        let Ok((header, request)) = adu::parse(frame.clone()) else {
            self.context.foreign.closed(self.peer, &frame);
            return Err(ConnectionEnd::Foreign);
        };
        match self.perform(header, request) {
            Ok(Some(data)) => self.send(header, Ok(&data)).await,
            Ok(None) => Ok(()),
            Err(exception) => self.send(header, Err(exception)).await,
        }
    }

    /// Reads no further request before this time.
    pub(super) fn delay_next(&mut self, until: Option<tokio::time::Instant>) {
        self.paced_until = self.paced_until.max(until.map(tokio::time::Instant::into_std));
    }

    async fn send(&mut self, header: Header, response: Result<&[u8], ExceptionCode>) -> Result<(), ConnectionEnd> {
        let exception = response.as_ref().err().map_or(0, |exception| u8::from(*exception));
        self.context.count(header.function, exception);
        let frame = match response {
            Ok(data) => header.response(data),
            Err(exception) => header.exception(exception),
        };
        match timeout(TAKEN_WITHIN, self.writer.write_all(&frame)).await {
            Ok(Ok(())) => Ok(()),
            _ => Err(ConnectionEnd::Gone),
        }
    }

    /// Time at which a heartbeat is missed, and its client lost.
    fn lost_at(&self) -> Option<Instant> {
        self.heartbeats().map(|(_, lost_at)| lost_at).min()
    }

    /// The leases with a supervised heartbeat, and the times at which they are lost.
    fn heartbeats(&self) -> impl Iterator<Item = (&Name, Instant)> {
        let limit = self.settings.now().heartbeat;
        self.leases.keys().filter_map(move |gripper| {
            let alive_at = self.images.get(&Some(gripper.clone()))?.alive_at()?;
            Some((gripper, alive_at + limit))
        })
    }

    /// Loses the leases whose heartbeat has stopped.
    fn lose_silent(&mut self, now: Instant) {
        let lost = self.heartbeats().filter(|(_, lost_at)| *lost_at <= now).map(|(gripper, _)| gripper.clone());
        for gripper in lost.collect::<Vec<_>>() {
            tracing::warn!(%gripper, client = %self.client.subject, "Modbus client lost: heartbeat unchanged for longer than modbus_heartbeat_ms");
            if let Some(held) = self.leases.remove(&gripper) {
                self.lose(held.lease, LossCause::Disconnected);
            }
        }
    }

    /// Loses the leases of grippers that the client may no longer move.
    fn lose_forbidden_leases(&mut self) {
        let forbidden = self.leases.keys().filter(|gripper| !self.may_move(gripper)).cloned();
        for gripper in forbidden.collect::<Vec<_>>() {
            if let Some(held) = self.leases.remove(&gripper) {
                self.lose(held.lease, LossCause::Forbidden);
            }
        }
    }

    async fn lose_leases(&mut self) {
        while let Some((_, held)) = self.leases.pop_first() {
            held.lease.lose(LossCause::Disconnected).await;
        }
        for gripper in self.images.keys().flatten().filter_map(|name| self.context.gateway.grippers.get(name)) {
            // A motion may have taken the lease a moment ago. The token belongs to this connection alone.
            gripper.lose_lease(self.token.clone(), None, LossCause::Disconnected).await;
        }
    }
}
