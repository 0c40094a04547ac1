//! A device with a script that steers its fingers. Like [`Scripted`](super::Scripted), it is independent of the simulator.
//! Its fingers move by the clock: towards the newest target, at its speed, until they are there or a Stop comes.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;

use super::frames::{Frame, Frames};
use super::scripted::{Table, UPDATE_EVERY, frame, idle, success};

/// Id of the script.
pub const STEER: u8 = 0xB1;

/// Travel of the fingers, in mm.
const STROKE_MM: f32 = 110.0;

/// System state flags.
const REFERENCED: u32 = 0x1;
const MOVING: u32 = 0x2;
const FAST_STOP: u32 = 0x1000;

/// A target that the script has taken up.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// First float of the request: a width or a position.
    pub width_mm: f32,
    pub arrived_at: Instant,
    pub taken_at: Instant,
}

#[derive(Debug)]
struct Fingers {
    from_mm: f32,
    since: Instant,
    target_mm: f32,
    speed_mm_s: f32,
    is_fast_stopped: bool,
}

impl Fingers {
    fn width_mm(&self) -> f32 {
        let way_mm = self.speed_mm_s * self.since.elapsed().as_secs_f32();
        self.from_mm + (self.target_mm - self.from_mm).clamp(-way_mm, way_mm)
    }

    /// Speed in mm/s, positive while opening.
    fn speed_mm_s(&self) -> f32 {
        let distance_mm = self.target_mm - self.width_mm();
        if distance_mm.abs() < 0.001 { 0.0 } else { self.speed_mm_s.copysign(distance_mm) }
    }

    fn move_to(&mut self, target_mm: f32, speed_mm_s: f32) {
        self.from_mm = self.width_mm();
        self.since = Instant::now();
        self.target_mm = if self.is_fast_stopped { self.from_mm } else { target_mm.clamp(0.0, STROKE_MM) };
        self.speed_mm_s = speed_mm_s.abs();
    }

    fn stop(&mut self) {
        let width_mm = self.width_mm();
        self.move_to(width_mm, 0.0);
    }

    fn flags(&self) -> u32 {
        let moving = if self.speed_mm_s().abs() > 0.0 { MOVING } else { 0 };
        REFERENCED | moving | if self.is_fast_stopped { FAST_STOP } else { 0 }
    }

    /// Follows a request of the two public protocols: a byte, then width and speed, or position, speed, two gains and
    /// two force limits. Returns the data of its reply.
    fn steer(&mut self, payload: &[u8]) -> Vec<u8> {
        let values: Vec<f32> =
            payload[1..].chunks(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect();
        match values[..] {
            [width_mm, speed_mm_s] => self.move_to(width_mm, speed_mm_s),
            [position_mm, speed_mm_s, kp, kd, ..] => {
                let mm_s = kp * (position_mm - self.width_mm()) + kd * (speed_mm_s - self.speed_mm_s());
                self.move_to(if mm_s < 0.0 { 0.0 } else { STROKE_MM }, mm_s);
            }
            _ => panic!("not a target: {payload:?}"),
        }
        let mut data = vec![self.flags() as u8];
        data.extend(self.width_mm().to_le_bytes());
        data.extend(self.speed_mm_s().to_le_bytes());
        // Force and time, or force and the forces at two fingers.
        data.resize(if values.len() == 2 { 21 } else { 17 }, 0);
        data
    }
}

#[derive(Debug)]
struct State {
    fingers: Fingers,
    targets: Vec<Target>,
    table: Table,
}

/// Requests that wait for the script.
#[derive(Debug)]
struct Script {
    waiting: VecDeque<Frame>,
    free_at: Instant,
    period: Duration,
}

impl Script {
    /// Takes up the requests that are due.
    fn run(&mut self, state: &Mutex<State>, out: &mut Vec<u8>) {
        while Instant::now() >= self.free_at
            && let Some(request) = self.waiting.pop_front()
        {
            self.free_at = Instant::now() + self.period;
            state.lock().unwrap().take(&request, out);
        }
    }
}

impl State {
    /// Takes up a request of the script.
    fn take(&mut self, request: &Frame, out: &mut Vec<u8>) {
        let data = self.fingers.steer(&request.payload);
        let width_mm = f32::from_le_bytes(request.payload[1..5].try_into().unwrap());
        self.targets.push(Target { width_mm, arrived_at: request.at, taken_at: Instant::now() });
        frame(STEER, &success(&data), out);
    }

    fn answer(&mut self, id: u8, payload: &[u8], out: &mut Vec<u8>) {
        match id {
            0x22 => self.fingers.stop(),
            0x23 => {
                self.fingers.stop();
                self.fingers.is_fast_stopped = true;
            }
            0x24 => self.fingers.is_fast_stopped = false,
            _ => {}
        }
        let measured = match id {
            0x40 => Some(success(&self.fingers.flags().to_le_bytes())),
            0x43 => Some(success(&self.fingers.width_mm().to_le_bytes())),
            0x44 => Some(success(&self.fingers.speed_mm_s().to_le_bytes())),
            _ => None,
        };
        if let Some(payload) = measured {
            return frame(id, &payload, out);
        }
        match self.table.get(&id) {
            Some(payloads) => payloads.iter().for_each(|payload| frame(id, payload, out)),
            None if id == 0x06 => frame(id, &success(payload), out),
            None => frame(id, &[0x0E, 0], out),
        }
    }
}

/// A device whose script B1h takes one request per period. It serves one client at a time.
#[derive(Debug)]
pub struct Steered {
    pub address: SocketAddr,
    /// Frames that the device received, with the times of their arrival.
    pub frames: Frames,
    state: Arc<Mutex<State>>,
    serving: JoinHandle<()>,
}

impl Steered {
    /// Starts a device with its fingers at 100 mm.
    pub async fn start(period: Duration) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let fingers = Fingers {
            from_mm: 100.0,
            since: Instant::now(),
            target_mm: 100.0,
            speed_mm_s: 0.0,
            is_fast_stopped: false,
        };
        let state = Arc::new(Mutex::new(State { fingers, targets: Vec::new(), table: idle() }));
        let frames = Frames::default();
        let serving = tokio::spawn(serve(listener, period, state.clone(), frames.clone()));
        Self { address, frames, state, serving }
    }

    /// All targets that the script has taken up.
    pub fn targets(&self) -> Vec<Target> {
        self.state.lock().unwrap().targets.clone()
    }

    pub fn width_mm(&self) -> f32 {
        self.state.lock().unwrap().fingers.width_mm()
    }

    pub fn moves(&self) -> bool {
        self.state.lock().unwrap().fingers.flags() & MOVING != 0
    }
}

impl Drop for Steered {
    fn drop(&mut self) {
        self.serving.abort();
    }
}

async fn serve(listener: TcpListener, period: Duration, state: Arc<Mutex<State>>, frames: Frames) {
    for connection in 0.. {
        let (stream, _) = listener.accept().await.unwrap();
        stream.set_nodelay(true).unwrap();
        // Serve the next client however this connection ends.
        let _ = serve_one(stream, period, &state, &frames, connection).await;
    }
}

async fn serve_one(
    mut stream: TcpStream,
    period: Duration,
    state: &Mutex<State>,
    frames: &Frames,
    connection: usize,
) -> std::io::Result<()> {
    let mut recorder = frames.recorder(connection);
    let mut seen = frames.len();
    let mut updated = Vec::new();
    let mut script = Script { waiting: VecDeque::new(), free_at: Instant::now(), period };
    let mut buffer = [0; 4096];
    let mut tick = tokio::time::interval(UPDATE_EVERY);
    loop {
        let mut out = Vec::new();
        tokio::select! {
            bytes = stream.read(&mut buffer) => {
                let bytes = bytes?;
                if bytes == 0 {
                    return Ok(());
                }
                recorder.push(&buffer[..bytes]);
                let received = frames.since(seen);
                seen += received.len();
                for frame in received {
                    if matches!(frame.id, 0x40 | 0x41 | 0x43..=0x45) && !updated.contains(&frame.id) {
                        updated.push(frame.id);
                    }
                    if frame.id == STEER {
                        script.waiting.push_back(frame);
                        script.run(state, &mut out);
                    } else {
                        state.lock().unwrap().answer(frame.id, &frame.payload, &mut out);
                    }
                }
            }
            () = tokio::time::sleep_until(script.free_at.into()), if !script.waiting.is_empty() => {}
            _ = tick.tick() => {
                for &id in &updated {
                    state.lock().unwrap().answer(id, &[], &mut out);
                }
            }
        }
        script.run(state, &mut out);
        stream.write_all(&out).await?;
    }
}
