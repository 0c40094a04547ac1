//! The pump, which runs a device over its wire in real time.

use std::io;
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::{mpsc, oneshot};

use super::wire::Wire;
use crate::model::clock;
use crate::sim::{Change, Device, ImpossibleChange, Interface, LinkAction, ReceivedFrame, Snapshot};
use crate::transport::Pipe;
use crate::wsg::Opening;

/// Bytes read at once.
const READ_BYTES: usize = 4096;

/// Orders that can wait. Each is carried out at once, so none waits long.
const MAX_WAITING_ORDERS: usize = 16;

/// Time for which a wire without connections is pulled. A gateway calls the link unresponsive after 1.5 s, so a client
/// that polls once a second sees that.
const PULLED_FOR: Duration = Duration::from_millis(2500);

/// A request to a device outside its protocol.
enum Order {
    Apply(Change, oneshot::Sender<Result<(), ImpossibleChange>>),
    Look(oneshot::Sender<(Snapshot, Vec<ReceivedFrame>)>),
}

/// The switch of a simulated device, which changes the device and shows its true state. When the last switch is
/// dropped, the device is switched off.
#[derive(Debug, Clone)]
pub struct Switch(mpsc::Sender<Order>);

impl std::fmt::Debug for Order {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Apply(..) => "Apply",
            Self::Look(_) => "Look",
        })
    }
}

impl Switch {
    /// Applies a change to the device. Without a connection that could be cut, [`Change::CutConnection`] pulls the
    /// wire: a pty ends and another one replaces it; on UDP and CAN, frames in both directions are lost for some
    /// seconds. The wire stays pulled for as long as connections are refused.
    ///
    /// # Errors
    /// The change is impossible ([`io::ErrorKind::InvalidInput`]), or the device is gone.
    pub async fn apply(&self, change: Change) -> io::Result<()> {
        let (done, wait) = oneshot::channel();
        let applied = self.order(Order::Apply(change, done), wait).await?;
        applied.map_err(|impossible| io::Error::new(io::ErrorKind::InvalidInput, impossible))
    }

    /// Returns the full state of the device at this moment.
    ///
    /// # Errors
    /// The device is gone.
    pub async fn snapshot(&self) -> io::Result<Snapshot> {
        Ok(self.look().await?.0)
    }

    /// Returns the newest frames that the device received, the oldest first.
    ///
    /// # Errors
    /// The device is gone.
    pub async fn received(&self) -> io::Result<Vec<ReceivedFrame>> {
        Ok(self.look().await?.1)
    }

    async fn look(&self) -> io::Result<(Snapshot, Vec<ReceivedFrame>)> {
        let (shown, wait) = oneshot::channel();
        self.order(Order::Look(shown), wait).await
    }

    async fn order<T>(&self, order: Order, wait: oneshot::Receiver<T>) -> io::Result<T> {
        self.0.send(order).await.map_err(|_| gone())?;
        wait.await.map_err(|_| gone())
    }
}

fn gone() -> io::Error {
    io::Error::new(io::ErrorKind::BrokenPipe, "the simulated device is gone")
}

/// Switches a device on, on the current runtime.
pub(super) fn start(device: Device, wire: Wire) -> Switch {
    let (switch, orders) = mpsc::channel(MAX_WAITING_ORDERS);
    tokio::spawn(Pump { device, wire, orders, connection: None, pulled_until: None }.run());
    Switch(switch)
}

struct Pump {
    device: Device,
    wire: Wire,
    orders: mpsc::Receiver<Order>,
    connection: Option<Connection>,
    /// Earliest end of a pulled wire. Bytes that come meanwhile are read and dropped, so they have no effect later.
    pulled_until: Option<Instant>,
}

/// A pipe with the bytes on their way through it.
struct Connection {
    pipe: Pipe,
    outgoing: Vec<u8>,
    written: usize,
    /// Whether all bytes are written, but the wire is still busy with them.
    is_leaving: bool,
    incoming: Vec<u8>,
    opening: Opening,
}

/// The result of a wait.
enum Input {
    Written(io::Result<()>),
    Read(io::Result<usize>),
    Deadline,
    Next(Option<Pipe>),
    Order(Option<Order>),
}

impl Connection {
    fn new(pipe: Pipe) -> Self {
        let incoming = vec![0; READ_BYTES];
        Self { pipe, outgoing: Vec::new(), written: 0, is_leaving: false, incoming, opening: Opening::default() }
    }

    fn is_written(&self) -> bool {
        self.written == self.outgoing.len() && !self.is_leaving
    }

    fn refill(&mut self, device: &mut Device) {
        self.outgoing.clear();
        self.written = 0;
        self.is_leaving = device.poll_transmit(&mut self.outgoing) && !self.outgoing.is_empty();
    }

    /// Writes or reads, whichever is ready first. Cancellation loses nothing.
    async fn transfer(&mut self) -> Input {
        let is_writing = !self.is_written();
        let Self { pipe, outgoing, written, is_leaving, incoming, .. } = self;
        tokio::select! {
            biased;
            done = async {
                if *written == outgoing.len() {
                    pipe.writer.flush().await?;
                    *is_leaving = false;
                    return Ok(());
                }
                match pipe.writer.write(&outgoing[*written..]).await? {
                    0 => return Err(io::ErrorKind::WriteZero.into()),
                    bytes => *written += bytes,
                }
                Ok(())
            }, if is_writing => Input::Written(done),
            read = pipe.reader.read(incoming) => Input::Read(read),
        }
    }
}

impl Pump {
    /// Runs until all switches are dropped, or no further connection can come. Rejects a second client, as a device
    /// does.
    async fn run(mut self) {
        loop {
            self.plug_in();
            self.transmit();
            match self.wait().await {
                Input::Read(Ok(bytes)) if bytes > 0 => self.receive(bytes),
                Input::Written(Err(_)) | Input::Read(_) => self.hang_up(),
                Input::Deadline => self.device.handle_timeout(clock::instant()),
                Input::Next(Some(pipe)) => self.connect(pipe),
                Input::Order(Some(order)) => self.obey(order),
                Input::Next(None) if self.connection.is_none() => return,
                Input::Order(None) => return,
                Input::Written(Ok(())) | Input::Next(None) => {}
            }
        }
    }

    /// Plugs a pulled wire in again, once [`PULLED_FOR`] is over.
    fn plug_in(&mut self) {
        let is_over = self.pulled_until.is_some_and(|until| until <= clock::instant());
        if is_over && self.device.accepts_connections() {
            self.pulled_until = None;
            self.device.connect(clock::instant(), self.wire.interface());
        }
    }

    fn transmit(&mut self) {
        match self.connection.as_mut().filter(|_| self.pulled_until.is_none()) {
            Some(connection) if connection.is_written() => connection.refill(&mut self.device),
            Some(_) => {}
            // Without a client on the wire, sent bytes are lost.
            None => while self.device.poll_transmit(&mut Vec::new()) {},
        }
        let all_written = self.connection.as_ref().is_none_or(Connection::is_written);
        if all_written && self.device.poll_link() == Some(LinkAction::Drop) {
            self.hang_up();
        }
    }

    async fn wait(&mut self) -> Input {
        let connections = self.wire.interface() == Interface::Tcp;
        let listens = connections || (self.connection.is_none() && self.device.accepts_connections());
        let plug_in_at = self.pulled_until.filter(|until| *until > clock::instant());
        let deadline = self.device.poll_timeout().into_iter().chain(plug_in_at).min();
        let connection = &mut self.connection;
        tokio::select! {
            biased;
            input = async {
                match connection {
                    Some(connection) => connection.transfer().await,
                    None => std::future::pending().await,
                }
            } => input,
            () = clock::sleep_until(deadline) => Input::Deadline,
            order = self.orders.recv() => Input::Order(order),
            next = self.wire.next(), if listens => Input::Next(next),
        }
    }

    /// Passes received bytes on to the device. A program that does not speak its protocol, such as a browser, is
    /// disconnected; on other wires than TCP, its bytes are noise.
    fn receive(&mut self, bytes: usize) {
        let Some(connection) = self.connection.as_mut().filter(|_| self.pulled_until.is_none()) else { return };
        let received = connection.incoming.get(..bytes).unwrap_or_default();
        if self.wire.interface() == Interface::Tcp && !connection.opening.accepts(received) {
            tracing::warn!(
                "connection to the simulated device closed: its first bytes belong to another protocol; connect a \
                 gateway or a WSG driver"
            );
            return self.hang_up();
        }
        self.device.receive(clock::instant(), received);
    }

    fn connect(&mut self, pipe: Pipe) {
        let is_free = self.connection.is_none();
        if is_free && self.device.connect(clock::instant(), self.wire.interface()) {
            self.connection = Some(Connection::new(pipe));
        }
    }

    fn hang_up(&mut self) {
        self.connection = None;
        self.device.disconnect(clock::instant());
    }

    fn apply(&mut self, change: Change) {
        tracing::info!(?change, "change applied to the simulated device");
        match self.wire.interface() {
            _ if change != Change::CutConnection => {}
            Interface::Tcp => {}
            Interface::Serial => self.connection = None,
            Interface::Udp | Interface::Can => self.pulled_until = Some(clock::instant() + PULLED_FOR),
        }
        self.device.apply(clock::instant(), change);
    }

    fn obey(&mut self, order: Order) {
        match order {
            Order::Apply(change, done) => {
                let possible = change.check(&self.device.config().limits);
                if possible.is_ok() {
                    self.apply(change);
                }
                let _ = done.send(possible);
            }
            Order::Look(shown) => {
                self.device.handle_timeout(clock::instant());
                let _ = shown.send((self.device.snapshot(), self.device.received().to_vec()));
            }
        }
    }
}
