//! The driver: the I/O around one gripper's actor. It connects, reads, writes one frame at a time, and forwards
//! clients' requests.

use std::future::Future;
use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use futures_util::FutureExt as _;
use futures_util::stream::{FuturesUnordered, StreamExt as _};
use rand::RngExt;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::sync::{Notify, mpsc, oneshot, watch};

use super::actor::{Actor, ActorConfig};
use super::connector::Connector;
use super::handle::{ActorRequest, FastStopRequest, Handle, MAX_WAITING_FAST_STOPS, MAX_WAITING_REQUESTS};
use super::recorder::{JournalHealth, Record, Recorder, RestoredState};
use model::CommandId;
use model::clock::{Now, sleep_until};
use transport::Pipe;
use wsg::Command;

/// Pause before the first attempt to reconnect; it doubles with each attempt.
const FIRST_BACK_OFF: Duration = Duration::from_millis(100);

/// Longest pause between two attempts.
const LONGEST_BACK_OFF: Duration = Duration::from_secs(2);

/// Time for which a link must have lasted before the pauses start anew. Otherwise a device that accepts every connection
/// and drops it at once would be connected to nine times per second.
const HELD_FOR: Duration = Duration::from_secs(10);

/// Time limit for writing the disconnect announcement before a link is closed.
const FAREWELL_WITHIN: Duration = Duration::from_millis(100);

/// Consecutive reads before deadlines and requests get their turn, so that a device that sends without end can't
/// block them.
const READS_IN_A_ROW: u32 = 8;

/// Bytes of one read: everything that a device sends in four seconds with updates every 10 ms. A driver stalled for
/// less than this still processes every queued update before it acts on timeouts.
const READ_BYTES: usize = 32 * 1024;

/// Lateness of a deadline that counts as a stall: the driver had no processor time and has unread input.
const STALLED_AFTER: Duration = Duration::from_millis(50);

/// Starts a gripper on the current runtime. It ends when drained, or when all its handles are gone.
pub fn spawn(
    config: ActorConfig,
    connector: Arc<dyn Connector>,
    recorder: Arc<dyn Recorder>,
    restored: RestoredState,
) -> Handle {
    let (driver, handle) = Driver::new(config, connector, recorder, restored);
    tokio::spawn(driver.run());
    handle
}

struct Driver {
    actor: Actor,
    connector: Arc<dyn Connector>,
    recorder: Arc<dyn Recorder>,
    health: watch::Receiver<JournalHealth>,
    /// Records that commands wait for: at most one for each running command.
    awaited: FuturesUnordered<Awaited>,
    requests: mpsc::Receiver<ActorRequest>,
    fast_stops: mpsc::Receiver<FastStopRequest>,
    /// Notified when a request of the lease's holder ends.
    lease_requests: Arc<Notify>,
    /// Whether all handles are gone.
    is_abandoned: bool,
}

/// Resolves when a command's record is durable, or has failed to become so.
struct Awaited(CommandId, oneshot::Receiver<()>);

impl Future for Awaited {
    type Output = (CommandId, bool);

    fn poll(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Self::Output> {
        Pin::new(&mut self.1).poll(cx).map(|durable| (self.0, durable.is_ok()))
    }
}

/// A link's I/O.
struct LinkIo {
    pipe: Pipe,
    outgoing: Outgoing,
    incoming: Vec<u8>,
    /// Read error, reported after the bytes before it were processed.
    failed: Option<io::Error>,
    reads_in_a_row: u32,
}

impl LinkIo {
    fn new(pipe: Pipe) -> Self {
        let outgoing = Outgoing::default();
        let incoming = vec![0; READ_BYTES];
        Self { pipe, outgoing, incoming, failed: None, reads_in_a_row: 0 }
    }
}

/// Result of a wait.
enum Input {
    FastStop(Option<FastStopRequest>),
    Deadline,
    LeaseRequestClosed,
    Recorded(CommandId, bool),
    Health(JournalHealth),
    Request(Option<ActorRequest>),
    Written(io::Result<()>),
    Read(io::Result<usize>),
}

impl Driver {
    fn new(
        config: ActorConfig,
        connector: Arc<dyn Connector>,
        recorder: Arc<dyn Recorder>,
        restored: RestoredState,
    ) -> (Self, Handle) {
        let (requests, request_queue) = mpsc::channel(MAX_WAITING_REQUESTS);
        let (fast_stops, fast_stop_queue) = mpsc::channel(MAX_WAITING_FAST_STOPS);
        let name = config.name.clone();
        let (mut actor, watches) = Actor::new(config);
        actor.restore(Now::read(), restored);
        let health = recorder.health();
        let driver = Self {
            lease_requests: actor.lease_requests(),
            actor,
            connector,
            recorder,
            health,
            awaited: FuturesUnordered::new(),
            requests: request_queue,
            fast_stops: fast_stop_queue,
            is_abandoned: false,
        };
        let super::actor::Watches { state, info, frames, .. } = watches;
        (driver, Handle { name, requests, fast_stops, state, info, frames })
    }

    async fn run(mut self) {
        let mut back_off = FIRST_BACK_OFF;
        while !self.actor.is_draining() {
            if let Some(connector) = self.actor.take_connector() {
                (self.connector, back_off) = (connector, FIRST_BACK_OFF);
            }
            if self.actor.is_released() {
                let input = self.wait(None).await;
                self.take_request(input);
                back_off = FIRST_BACK_OFF;
                continue;
            }
            match self.connect().await {
                Some(Ok(pipe)) => {
                    if self.serve(pipe).await {
                        back_off = FIRST_BACK_OFF;
                    }
                }
                Some(Err(error)) => self.actor.link_down(Now::read(), &error.to_string()),
                None => continue,
            }
            self.pause(back_off).await;
            back_off = (back_off * 2).min(LONGEST_BACK_OFF);
        }
        self.actor.drained(Now::read());
        // A drain waits for the driver's end, and so for these records.
        self.pass_records_on();
    }

    /// Whether the gateway may connect.
    fn may_connect(&self) -> bool {
        !self.actor.is_draining() && !self.actor.is_released() && !self.actor.is_reconfiguring()
    }

    /// Connects, and serves requests meanwhile. Returns `None` if the gateway may no longer connect.
    async fn connect(&mut self) -> Option<io::Result<Pipe>> {
        let connector = self.connector.clone();
        let mut connecting = connector.connect();
        self.actor.connecting();
        while self.may_connect() {
            tokio::select! {
                biased;
                // First, because clients could always have another request waiting.
                connected = &mut connecting => return Some(connected),
                input = self.wait(None) => self.take_request(input),
            }
        }
        // A connection being made may exist already, and dropping it would cause a FAST STOP.
        if let Ok(Ok(mut pipe)) = tokio::time::timeout(FAREWELL_WITHIN, connecting).await
            && self.connector.properties().connection_oriented
        {
            say_good_bye(&mut pipe, &[]).await;
        }
        if !self.actor.is_draining() {
            self.actor.link_down(Now::read(), "disconnected");
        }
        None
    }

    /// Waits before the next attempt to connect, and serves requests meanwhile. The wait ends early if the gateway may
    /// no longer connect. While the device has not confirmed a FAST STOP, the wait is the shortest one, also if the FAST
    /// STOP is requested meanwhile. It is not left out, so that repeated FAST STOPs do not make repeated connections.
    async fn pause(&mut self, back_off: Duration) {
        let jitter = rand::rng().random_range(0.75..=1.0);
        let begun = Now::read().instant;
        while self.may_connect() {
            let pause = if self.actor.owes_fast_stop() { FIRST_BACK_OFF } else { back_off };
            tokio::select! {
                biased;
                () = sleep_until(Some(begun + pause.mul_f64(jitter))) => return,
                input = self.wait(None) => self.take_request(input),
            }
        }
    }

    /// Serves a link until it ends. Returns whether it was set up and lasted for [`HELD_FOR`].
    async fn serve(&mut self, pipe: Pipe) -> bool {
        let begun = Now::read();
        self.actor.link_up(begun);
        let mut link = LinkIo::new(pipe);
        let cause = loop {
            if let Some(close) = self.actor.wants_close() {
                self.farewell(&mut link).await;
                break close.to_string();
            }
            if link.outgoing.is_written() {
                link.outgoing.refill(&mut self.actor);
            }
            match self.wait(Some(&mut link)).await {
                Input::Written(Ok(())) => {}
                Input::Written(Err(error)) => break format!("writing failed: {error}"),
                Input::Read(Ok(0)) => break "the device closed the connection".to_owned(),
                Input::Read(Ok(bytes)) => self.actor.receive(Now::read(), &link.incoming[..bytes]),
                Input::Read(Err(error)) => break format!("reading failed: {error}"),
                request => self.take_request(request),
            }
        };
        let was_set_up = self.actor.is_set_up();
        let cause = match link.pipe.stranger.get() {
            Some(stranger) if !was_set_up => {
                format!("{cause}; datagrams came from {stranger} instead: check the address of the gripper")
            }
            _ => cause,
        };
        let ended = Now::read();
        self.actor.link_down(ended, &cause);
        was_set_up && ended.instant >= begun.instant + HELD_FOR
    }

    /// Waits for the next input. Cancel-safe.
    async fn wait(&mut self, link: Option<&mut LinkIo>) -> Input {
        self.pass_records_on();
        let deadline = self.actor.poll_timeout();
        let input = self.next_input(link, deadline).await;
        let now = Now::read();
        if deadline.is_some_and(|deadline| now.instant >= deadline + STALLED_AFTER) {
            self.actor.after_stall(now);
        }
        input
    }

    /// Picks the next input by priority: a FAST STOP first, then a finished write, which makes room for its frame.
    /// Deadlines come after input that the device and the journal have sent already, and requests after deadlines.
    /// Every [`READS_IN_A_ROW`] reads, deadlines and requests come before the next read.
    async fn next_input(&mut self, link: Option<&mut LinkIo>, deadline: Option<Instant>) -> Input {
        let mut failed_before = None;
        let (pipe, outgoing, incoming, failed) = match link {
            Some(LinkIo { pipe, outgoing, incoming, failed, reads_in_a_row }) => {
                if *reads_in_a_row >= READS_IN_A_ROW {
                    if let Ok(request) = self.fast_stops.try_recv() {
                        return Input::FastStop(Some(request));
                    }
                    if deadline.is_some_and(|deadline| deadline <= Now::read().instant) {
                        return Input::Deadline;
                    }
                    *reads_in_a_row = 0;
                    if let Ok(request) = self.requests.try_recv() {
                        return Input::Request(Some(request));
                    }
                }
                *reads_in_a_row += 1;
                (Some(pipe), Some(outgoing), incoming.as_mut_slice(), failed)
            }
            None => (None, None, [].as_mut_slice(), &mut failed_before),
        };
        let (mut reader, mut writer) = pipe.map(|pipe| (&mut pipe.reader, &mut pipe.writer)).unzip();
        let is_writing = outgoing.as_ref().is_some_and(|outgoing| !outgoing.is_written());
        tokio::select! {
            biased;
            request = self.fast_stops.recv(), if !self.is_abandoned => Input::FastStop(request),
            written = async {
                match (outgoing, &mut writer) {
                    (Some(outgoing), Some(writer)) => outgoing.write(writer).await,
                    _ => std::future::pending().await,
                }
            }, if is_writing => Input::Written(written),
            () = self.lease_requests.notified() => Input::LeaseRequestClosed,
            Some((id, durable)) = self.awaited.next() => Input::Recorded(id, durable),
            Ok(()) = self.health.changed() => Input::Health(self.health.borrow_and_update().clone()),
            read = async {
                match &mut reader {
                    Some(reader) => read_all(reader, incoming, failed).await,
                    None => std::future::pending().await,
                }
            } => Input::Read(read),
            () = sleep_until(deadline) => Input::Deadline,
            request = self.requests.recv(), if !self.is_abandoned => Input::Request(request),
        }
    }

    /// Passes the actor's records to the recorder, which never blocks.
    fn pass_records_on(&mut self) {
        while let Some((record, awaited_by)) = self.actor.poll_record() {
            let record = match (record, awaited_by) {
                (Record::Event(event, _), Some(id)) => {
                    let (durable, is_durable) = oneshot::channel();
                    self.awaited.push(Awaited(id, is_durable));
                    Record::Event(event, Some(durable))
                }
                (record, _) => record,
            };
            self.recorder.record(record);
        }
    }

    /// Passes an input to the actor, unless it concerns the link's I/O.
    fn take_request(&mut self, input: Input) {
        match input {
            Input::FastStop(Some(request)) => self.actor.fast_stop(Now::read(), request),
            Input::Request(Some(request)) => self.actor.request(Now::read(), request),
            Input::FastStop(None) | Input::Request(None) => {
                self.is_abandoned = true;
                self.actor.abandon(Now::read());
            }
            Input::Deadline => self.actor.handle_timeout(Now::read()),
            Input::LeaseRequestClosed => self.actor.lease_request_closed(Now::read()),
            Input::Recorded(id, durable) => self.actor.recorded(Now::read(), id, durable),
            Input::Health(health) => self.actor.journal_health(Now::read(), health),
            Input::Written(_) | Input::Read(_) => {}
        }
    }

    /// Announces the disconnect before closing the connection of a device that may still be listening, since a plain
    /// close causes a FAST STOP. A half-written frame is finished first, so that the announcement is a separate frame.
    /// Requests that can still act late are thrown away instead, and the gripper's FAST STOP is then welcome.
    async fn farewell(&self, link: &mut LinkIo) {
        if self.actor.may_act_late() {
            // Bytes that still wait in a buffer must not reach the device after this connection: nobody would know.
            if let Some(discard_unsent) = &link.pipe.discard_unsent {
                discard_unsent();
            }
            return;
        }
        if self.connector.properties().connection_oriented && !self.actor.has_announced() {
            say_good_bye(&mut link.pipe, link.outgoing.rest()).await;
        }
    }
}

/// Reads all available bytes that fit into the buffer. Cancel-safe. An error after some bytes is returned by the next
/// call.
async fn read_all(
    reader: &mut (impl AsyncRead + Unpin),
    incoming: &mut [u8],
    failed: &mut Option<io::Error>,
) -> io::Result<usize> {
    if let Some(error) = failed.take() {
        return Err(error);
    }
    let mut bytes = reader.read(incoming).await?;
    while let Some(place) = incoming.get_mut(bytes..).filter(|place| bytes > 0 && !place.is_empty()) {
        match reader.read(place).now_or_never() {
            Some(Ok(more)) if more > 0 => bytes += more,
            Some(Err(error)) => {
                *failed = Some(error);
                break;
            }
            _ => break,
        }
    }
    Ok(bytes)
}

/// Finishes the current frame, then writes 07h. A failure is ignored: the link may be closed because nothing gets
/// through.
async fn say_good_bye(pipe: &mut Pipe, unfinished: &[u8]) {
    let mut bytes = unfinished.to_vec();
    Command::DisconnectAnnouncement.encode(&mut bytes);
    let _ = tokio::time::timeout(FAREWELL_WITHIN, pipe.writer.write_all(&bytes)).await;
}

/// The frame being written. There is one at a time, so that a FAST STOP waits for one frame at most.
#[derive(Debug, Default)]
struct Outgoing {
    frame: Vec<u8>,
    written: usize,
    /// Whether the whole frame was written and the line is still sending it. The next frame waits outside, so that a
    /// FAST STOP can overtake it.
    is_leaving: bool,
}

impl Outgoing {
    fn is_written(&self) -> bool {
        self.written == self.frame.len() && !self.is_leaving
    }

    fn rest(&self) -> &[u8] {
        &self.frame[self.written..]
    }

    fn refill(&mut self, actor: &mut Actor) {
        self.frame.clear();
        self.written = 0;
        self.is_leaving = actor.poll_transmit(Now::read(), &mut self.frame);
    }

    /// Writes part of the frame, or waits until the line has sent it. Cancel-safe.
    async fn write(&mut self, writer: &mut (impl AsyncWrite + Unpin)) -> io::Result<()> {
        if self.written == self.frame.len() {
            writer.flush().await?;
            self.is_leaving = false;
            return Ok(());
        }
        match writer.write(&self.frame[self.written..]).await? {
            0 => Err(io::ErrorKind::WriteZero.into()),
            bytes => {
                self.written += bytes;
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests;
