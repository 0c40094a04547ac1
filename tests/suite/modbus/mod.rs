//! Modbus TCP, with an independent client.

mod access;
mod commands;
mod fieldbus;
mod lost_clients;
mod protocol;

use std::net::SocketAddr;

use tokio::net::{TcpSocket, TcpStream};
use tokio_modbus::client::{Context, Reader as _, Writer as _, tcp};
use tokio_modbus::prelude::{ExceptionCode, Slave};

use crate::harness::{DEADLINE, Gateway, Proxy, Simulator, eventually};

/// Holding registers of the gateway map.
const COUNTER: u16 = 100;
const HEARTBEAT: u16 = 108;
const FAST_STOP_REGISTER: u16 = 110;

/// Commands.
const NONE: u16 = 0;
const HOME: u16 = 1;
const MOVE: u16 = 2;
const GRIP: u16 = 3;
const RELEASE: u16 = 4;
const STOP: u16 = 5;
const ACKNOWLEDGE: u16 = 6;
const TAKE_LEASE: u16 = 7;
const RELEASE_LEASE: u16 = 8;

/// Bits of the status word.
const READY: u16 = 1;
const BUSY: u16 = 1 << 1;
const DONE: u16 = 1 << 2;
const OK: u16 = 1 << 3;
const NOK: u16 = 1 << 4;
const HOLDING: u16 = 1 << 5;
const MOVING: u16 = 1 << 6;
const LATCHED: u16 = 1 << 9;
const MINE: u16 = 1 << 10;
const OTHERS: u16 = 1 << 11;
const PREPARED: u16 = 1 << 13;

/// Unit identifier of the gateway.
const GATEWAY: u8 = 255;

/// Id of a FAST STOP on the device's line.
const FAST_STOP: u8 = 0x23;

/// A controller, connected to gripper 1.
struct Plc {
    client: Context,
    counter: u16,
}

/// Values of a command.
#[derive(Default, Clone, Copy)]
struct Values {
    recipe: u16,
    /// In 1/100 mm.
    width: u16,
    /// In 1/10 mm/s.
    speed: u16,
    /// In 1/10 N.
    force: u16,
    options: u16,
    on_loss: u16,
    fast_stop_number: u16,
}

/// Input registers of the gateway map.
#[derive(Debug, Clone, Copy)]
struct Seen {
    counter: u16,
    status: u16,
    outcome: u16,
    problem: u16,
    fault: u16,
    width: u16,
    contact_width: u16,
    peak_force: u16,
    fast_stop_number: u16,
}

impl Values {
    fn at(width: u16, speed: u16) -> Self {
        Self { width, speed, ..Self::default() }
    }
}

impl Plc {
    async fn connect(address: SocketAddr) -> Self {
        Self::over(TcpStream::connect(address).await.unwrap())
    }

    /// Connects from this address.
    async fn from(own: &str, address: SocketAddr) -> Self {
        let socket = TcpSocket::new_v4().unwrap();
        socket.bind(format!("{own}:0").parse().unwrap()).unwrap();
        Self::over(socket.connect(address).await.unwrap())
    }

    fn over(stream: TcpStream) -> Self {
        Self { client: tcp::attach_slave(stream, Slave(1)), counter: 0 }
    }

    /// Connects, and prepares commands.
    async fn ready(address: SocketAddr) -> Self {
        let mut plc = Self::connect(address).await;
        plc.counter = plc.seen().await.counter;
        plc.write(COUNTER, &[plc.counter, NONE]).await.unwrap();
        plc
    }

    async fn write(&mut self, address: u16, words: &[u16]) -> Result<(), ExceptionCode> {
        self.client.write_multiple_registers(address, words).await.unwrap()
    }

    async fn inputs(&mut self, address: u16, count: u16) -> Vec<u16> {
        self.client.read_input_registers(address, count).await.unwrap().unwrap()
    }

    async fn seen(&mut self) -> Seen {
        let words = self.inputs(COUNTER, 12).await;
        let [counter, status, outcome, problem, fault, _, width, _, _, contact_width, peak_force, fast_stop_number] =
            words.try_into().unwrap();
        Seen { counter, status, outcome, problem, fault, width, contact_width, peak_force, fast_stop_number }
    }

    /// Executes a command.
    async fn command(&mut self, command: u16, values: Values) -> Result<(), ExceptionCode> {
        self.counter += 1;
        let Values { recipe, width, speed, force, options, on_loss, fast_stop_number } = values;
        let words = [self.counter, command, recipe, width, speed, force, options, on_loss];
        self.write(FAST_STOP_REGISTER - 1, &[fast_stop_number]).await?;
        self.write(COUNTER, &words).await
    }

    /// Executes a command, and waits for its end.
    async fn ended(&mut self, command: u16, values: Values) -> Seen {
        self.command(command, values).await.unwrap();
        self.until("the command has ended", |seen| seen.status & DONE != 0).await
    }

    /// Executes a command, which succeeds.
    async fn ok(&mut self, command: u16, values: Values) -> Seen {
        let seen = self.ended(command, values).await;
        assert_eq!((seen.status & (OK | NOK), seen.counter), (OK, self.counter), "{seen:?}");
        seen
    }

    async fn until(&mut self, what: &str, wanted: impl Fn(&Seen) -> bool) -> Seen {
        let ends = tokio::time::Instant::now() + DEADLINE;
        loop {
            let seen = self.seen().await;
            if wanted(&seen) {
                return seen;
            }
            assert!(tokio::time::Instant::now() < ends, "{what}: {seen:?}");
            tokio::task::yield_now().await;
        }
    }
}

/// A gateway that serves a device over Modbus as unit 1, the device, and the proxy between them.
struct Cell {
    _device: Simulator,
    proxy: Proxy,
    gateway: Gateway,
    address: SocketAddr,
}

impl Cell {
    /// A gripper with a part of 20 mm in reach.
    async fn start() -> Self {
        Self::with("").await
    }

    async fn with(settings: &str) -> Self {
        let device = Simulator::with_part().await;
        let proxy = Proxy::to(device.address);
        let toml = format!("{settings}\n[grippers.g]\nurl = \"tcp://{}\"\n", proxy.address);
        let gateway = Gateway::with_file(&["--modbus", "127.0.0.1:0"], &toml).await;
        let address = gateway.word_after("Modbus: ").await.parse().unwrap();
        gateway.until_link("connected").await;
        Self { _device: device, proxy, gateway, address }
    }

    /// Starts with a homed gripper, and returns a controller that holds the lease.
    async fn homed() -> (Self, Plc) {
        let cell = Self::start().await;
        let mut plc = Plc::ready(cell.address).await;
        plc.ok(HOME, Values::default()).await;
        (cell, plc)
    }
}

/// Waits until a unit has no holder.
async fn until_free(gateway: &Gateway) {
    eventually("the lease is free", async || gateway.state().await["lease_holder"].is_null().then_some(())).await;
}
