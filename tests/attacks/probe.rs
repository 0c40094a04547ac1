//! FAST STOPs over each interface, one at a time. A FAST STOP counts as arrived when the device sees 23h with nothing
//! latched before: the gateway repeats 23h only for an unconfirmed latch.

use std::io::{Read as _, Write as _};
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

/// Interval of reads on the open Modbus connection.
const POLLED_EVERY: Duration = Duration::from_secs(10);

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
    OpenModbus,
    FreshModbus,
    /// Through the broker.
    Mqtt,
    Zenoh,
}

impl Way {
    /// All interfaces other than HTTP. A put to Zenoh stops all grippers, so it comes last.
    pub const OTHERS: [Self; 7] = [
        Self::OpenWebSocket,
        Self::OpenPort,
        Self::FreshPort,
        Self::OpenModbus,
        Self::FreshModbus,
        Self::Mqtt,
        Self::Zenoh,
    ];
}

/// FAST STOPs over one interface.
#[derive(Debug, Default)]
pub struct Stops {
    pub wanted: usize,
    pub asked: usize,
    /// Number of those whose client got an answer. Zenoh gives none to a put, which counts as answered once it has
    /// reached the device.
    pub answered: usize,
    /// The first FAST STOP that did not reach the device: its number, and what its client saw.
    pub first_loss: Option<String>,
    /// Times of those that reached the device, sorted.
    times: Vec<Duration>,
}

/// One FAST STOP.
struct Outcome {
    /// Time until the device saw 23h, including the connect if the connection is fresh.
    reached: Option<Duration>,
    is_answered: bool,
    /// Failure to connect or to send.
    error: Option<std::io::Error>,
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
    modbus: Option<TcpStream>,
    /// Number of FAST STOPs over MQTT so far.
    mqtt_stops: usize,
    /// Time of the last request over Modbus.
    polled_at: Instant,
}

impl<'a> Probe<'a> {
    pub fn of(gateway: &'a Gateway, device: &'a Device) -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let zenoh = runtime.block_on(ZenohClient::at(&gateway.zenoh));
        let socket = Socket::open(gateway).expect("a WebSocket opens before the attack");
        let port = http::connect(gateway.port).expect("the WSG port accepts before the attack");
        let modbus = gateway.modbus.map(|address| http::connect(address).expect("Modbus accepts before the attack"));
        Self { gateway, device, runtime, zenoh, socket, port, modbus, mqtt_stops: 0, polled_at: Instant::now() }
    }

    /// Sends a series of FAST STOPs over one interface.
    pub fn stops(&mut self, way: Way, wanted: usize) -> Stops {
        let mut stops = Stops { wanted, ..Stops::default() };
        let (mut missed, series_begun) = (0, Instant::now());
        while stops.asked < wanted && missed < GIVES_UP_AFTER && series_begun.elapsed() < ENDS_AFTER {
            self.settle("g");
            self.poll_modbus();
            stops.asked += 1;
            let begun = Instant::now();
            let Outcome { reached, is_answered, error } = self.stop(way);
            stops.answered += usize::from(is_answered);
            if reached.is_none() {
                let seen = error.map_or_else(|| format!("answered: {is_answered}"), |error| error.to_string());
                stops.first_loss.get_or_insert(format!("number {}, {seen}", stops.asked));
            }
            match reached {
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

    fn stop(&mut self, way: Way) -> Outcome {
        let answers_before = self.socket.answers();
        let begun = Instant::now();
        let asked = self.ask(way);
        let reached = self.device.first_since(FAST_STOP, begun, REACHES_WITHIN);
        let begun = begun + if way == Way::HesitantHttp { HESITATES_FOR } else { Duration::ZERO };
        let mut error = None;
        let is_answered = match (way, asked) {
            // A client that waits for its answer frees its slot only then.
            (Way::FreshHttp | Way::HesitantHttp, Ok(Some(mut connection))) => {
                http::read_answer(&mut connection).is_some_and(|answer| answer.status == 200)
            }
            (Way::FreshPort, Ok(Some(mut connection))) => read_frame(&mut connection, FAST_STOP).is_some(),
            (Way::FreshModbus, Ok(Some(mut connection))) => read_adu(&mut connection).is_some(),
            (Way::OpenPort, Ok(_)) => read_frame(&mut self.port, FAST_STOP).is_some(),
            (Way::OpenModbus, Ok(_)) => self.modbus.as_mut().is_some_and(|modbus| {
                let is_answered = read_adu(modbus).is_some();
                // Only the next change from 0 is another FAST STOP.
                is_answered && modbus.write_all(&modbus_fast_stop(false)).is_ok() && read_adu(modbus).is_some()
            }),
            (Way::OpenWebSocket, Ok(_)) => self.socket.has_more_answers(answers_before, http::PATIENCE),
            (Way::Mqtt, Ok(_)) => {
                let mqtt = self.gateway.mqtt.as_ref();
                mqtt.is_some_and(|mqtt| mqtt.is_answered(&self.mqtt_stops.to_string()))
            }
            (Way::Zenoh, Ok(_)) => reached.is_some(),
            (_, Ok(None)) => false,
            (_, Err(failure)) => {
                error = Some(failure);
                false
            }
        };
        Outcome { reached: reached.map(|at| at.saturating_duration_since(begun)), is_answered, error }
    }

    /// Reads a register over Modbus now and then, since a connection without requests is closed after a minute.
    fn poll_modbus(&mut self) {
        if let Some(modbus) = self.modbus.as_mut().filter(|_| self.polled_at.elapsed() > POLLED_EVERY) {
            self.polled_at = Instant::now();
            // A closed connection shows in the next FAST STOP.
            let _ = modbus.write_all(&[0, 8, 0, 0, 0, 6, 1, 4, 0, 100, 0, 1]);
            read_adu(modbus);
        }
    }

    /// Whether the gateway serves this interface.
    pub fn has(&self, way: Way) -> bool {
        match way {
            Way::OpenModbus | Way::FreshModbus => self.modbus.is_some(),
            Way::Mqtt => self.gateway.mqtt.is_some(),
            _ => true,
        }
    }

    /// Sends a FAST STOP, and returns the connection if it is a fresh one.
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
            Way::OpenModbus => {
                let modbus = self.modbus.as_mut().ok_or(std::io::ErrorKind::NotConnected)?;
                modbus.write_all(&modbus_fast_stop(true)).map(|()| None)
            }
            Way::FreshModbus => {
                let mut connection = http::connect(self.gateway.modbus.ok_or(std::io::ErrorKind::NotConnected)?)?;
                connection.write_all(&modbus_fast_stop(true))?;
                Ok(Some(connection))
            }
            Way::Mqtt => {
                self.mqtt_stops += 1;
                let mqtt = self.gateway.mqtt.as_ref().ok_or(std::io::ErrorKind::NotConnected)?;
                mqtt.fast_stop(&self.mqtt_stops.to_string());
                Ok(None)
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

/// Request that sets or clears the FAST STOP register of `g` over Modbus.
fn modbus_fast_stop(is_set: bool) -> [u8; 12] {
    [0, 7, 0, 0, 0, 6, 1, 6, 0, 110, 0, is_set.into()]
}

/// Reads a response that is not an exception; `None` if the connection ends first.
fn read_adu(stream: &mut TcpStream) -> Option<()> {
    let mut header = [0; 8];
    stream.read_exact(&mut header).ok()?;
    let mut rest = vec![0; usize::from(header[5]).checked_sub(2)?];
    stream.read_exact(&mut rest).ok()?;
    (header[7] < 0x80).then_some(())
}

/// Reads frames of the WSG port until one has this id; `None` if the connection ends first.
fn read_frame(stream: &mut TcpStream, id: u8) -> Option<()> {
    loop {
        let mut header = [0; 6];
        stream.read_exact(&mut header).ok()?;
        let mut rest = vec![0; usize::from(header[4]) + 2];
        stream.read_exact(&mut rest).ok()?;
        if header[3] == id {
            return Some(());
        }
    }
}
