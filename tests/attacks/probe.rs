//! FAST STOPs over each interface, one at a time. A FAST STOP counts as arrived when the device sees 23h with nothing
//! latched before: the gateway repeats 23h only for an unconfirmed latch.

use std::io::Write as _;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tokio::runtime::Runtime;

use crate::device::{Device, FAST_STOP};
use crate::gateway::Gateway;
use crate::harness::{ZenohClient, wsg};
use crate::http;
use crate::websocket::{Socket, TEXT};

/// Time after which a FAST STOP counts as lost.
const REACHES_WITHIN: Duration = Duration::from_secs(1);

/// Minimum time between two FAST STOPs, so that they cover all stages of an attack.
const ASKED_EVERY: Duration = Duration::from_millis(90);

/// Number of consecutive losses that end a series, to save time.
const GIVES_UP_AFTER: usize = 20;

/// Time limit of a series, which slow acknowledges can stretch. The result then covers the FAST STOPs so far.
const ENDS_AFTER: Duration = Duration::from_secs(40);

/// Pause of a client between connect and first byte, as on a slow line.
const HESITATES_FOR: Duration = Duration::from_millis(20);

/// Time to acknowledge a latch.
const SETTLES_WITHIN: Duration = Duration::from_secs(5);

/// An interface, with a fresh or an already open connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    FreshHttp,
    /// On a fresh connection that is silent for [`HESITATES_FOR`]; the time runs from the first byte.
    HesitantHttp,
    OpenWebSocket,
    OpenPort,
    FreshPort,
    Zenoh,
}

/// FAST STOPs over one interface.
#[derive(Debug, Default)]
pub struct Stops {
    pub wanted: usize,
    pub asked: usize,
    /// Times of those that reached the device, sorted.
    times: Vec<Duration>,
}

impl Stops {
    pub fn reached(&self) -> usize {
        self.times.len()
    }

    /// Returns this percentile of the times.
    pub fn percentile(&self, percent: usize) -> Option<Duration> {
        let last = self.times.len().checked_sub(1)?;
        self.times.get((last * percent).div_ceil(100)).copied()
    }
}

/// A client of each interface, all connected before an attack starts.
pub struct Probe<'a> {
    gateway: &'a Gateway,
    device: &'a Device,
    runtime: Runtime,
    zenoh: ZenohClient,
    socket: Socket,
    port: TcpStream,
}

impl<'a> Probe<'a> {
    pub fn of(gateway: &'a Gateway, device: &'a Device) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let zenoh = runtime.block_on(ZenohClient::at(&gateway.zenoh));
        let socket = Socket::open(gateway).expect("a WebSocket opens before the attack");
        let port = http::connect(gateway.port).expect("the WSG port accepts before the attack");
        Self { gateway, device, runtime, zenoh, socket, port }
    }

    /// Sends a series of FAST STOPs over one interface.
    pub fn stops(&mut self, way: Way, wanted: usize) -> Stops {
        let mut stops = Stops { wanted, ..Stops::default() };
        let (mut missed, series_begun) = (0, Instant::now());
        while stops.asked < wanted && missed < GIVES_UP_AFTER && series_begun.elapsed() < ENDS_AFTER {
            self.settle("g");
            stops.asked += 1;
            let begun = Instant::now();
            match self.stop(way) {
                Some(time) => {
                    missed = 0;
                    stops.times.push(time);
                }
                None => missed += 1,
            }
            std::thread::sleep(ASKED_EVERY.saturating_sub(begun.elapsed()));
        }
        for gripper in self.gateway.grippers.iter().filter(|_| way == Way::Zenoh) {
            // A put stops all grippers.
            self.settle(gripper);
        }
        stops.times.sort_unstable();
        stops
    }

    /// Returns the time until the device saw 23h, including the connect if the connection is fresh.
    fn stop(&mut self, way: Way) -> Option<Duration> {
        let begun = Instant::now();
        let asked = self.ask(way);
        let reached = self.device.first_since(FAST_STOP, begun, REACHES_WITHIN);
        let begun = begun + if way == Way::HesitantHttp { HESITATES_FOR } else { Duration::ZERO };
        if let (Way::FreshHttp | Way::HesitantHttp, Ok(Some(mut connection)), true) = (way, asked, reached.is_some()) {
            // A client that waits for its answer frees its slot only then.
            http::read_answer(&mut connection);
        }
        reached.map(|at| at.saturating_duration_since(begun))
    }

    /// Sends a FAST STOP, and returns the connection if it is a fresh HTTP or port connection.
    fn ask(&mut self, way: Way) -> std::io::Result<Option<TcpStream>> {
        let port_request = wsg::request(FAST_STOP, &[]);
        match way {
            Way::FreshHttp | Way::HesitantHttp => {
                let mut connection = self.gateway.connect()?;
                if way == Way::HesitantHttp {
                    std::thread::sleep(HESITATES_FOR);
                }
                let path = "/api/v1/grippers/g/fast-stop";
                connection.write_all(http::request("POST", path, r#"{"reason": "the probe"}"#).as_bytes())?;
                Ok(Some(connection))
            }
            Way::OpenWebSocket => {
                let params = json!({"gripper": "g", "reason": "the probe"});
                let request = json!({"jsonrpc": "2.0", "id": 1, "method": "fast-stop", "params": params});
                self.socket.send(TEXT, &request.to_string()).map(|()| None)
            }
            Way::OpenPort => self.port.write_all(&port_request).map(|()| None),
            Way::FreshPort => {
                let mut connection = http::connect(self.gateway.port)?;
                connection.write_all(&port_request)?;
                Ok(Some(connection))
            }
            Way::Zenoh => {
                self.runtime.block_on(self.zenoh.put("wsg/v1/gateway/fast-stop", "the probe"));
                Ok(None)
            }
        }
    }

    /// Acknowledges over Zenoh until nothing is latched.
    fn settle(&self, gripper: &str) {
        let until = Instant::now() + SETTLES_WITHIN;
        while Instant::now() < until {
            let state = self.zenoh_answer(&format!("wsg/v1/gateway/{gripper}/state"), &Value::Null);
            match state.as_ref().map(|state| &state["fast_stop"]) {
                Some(Value::Bool(false)) => return,
                Some(_) => {
                    let id = json!({"fast_stop_id": state.unwrap_or_default()["fast_stop_id"]});
                    self.zenoh_answer(&format!("wsg/v1/gateway/{gripper}/command/acknowledge"), &id);
                }
                None => std::thread::sleep(ASKED_EVERY),
            }
        }
        eprintln!("a FAST STOP of {gripper} could not be acknowledged within {SETTLES_WITHIN:?}");
    }

    fn zenoh_answer(&self, selector: &str, payload: &Value) -> Option<Value> {
        let payload = if payload.is_null() { String::new() } else { payload.to_string() };
        self.runtime.block_on(self.zenoh.all(selector, payload)).into_iter().find_map(|(_, answer)| answer.ok())
    }

    /// Runs `ask`, which must cause one FAST STOP, and returns whether it reached the device.
    pub fn reaches(&self, ask: impl FnOnce()) -> bool {
        self.settle("g");
        let begun = Instant::now();
        ask();
        self.device.first_since(FAST_STOP, begun, REACHES_WITHIN).is_some()
    }

    /// Whether the gateway has closed the probe's WebSocket.
    pub fn socket_has_ended(&self) -> bool {
        self.socket.has_ended()
    }
}
