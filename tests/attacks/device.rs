//! A gripper that shares no code with the simulator. It runs on its own threads and records the arrival time of each
//! frame, so that load on the gateway or on a test runtime does not delay the record.

use std::collections::BTreeSet;
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Condvar, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use crate::harness::scripted::{frame, success};

/// Period of the automatic updates.
const UPDATE_EVERY: Duration = Duration::from_millis(10);

const REFERENCED: u32 = 1;
const MOVING: u32 = 1 << 1;
const FAST_STOP_SET: u32 = 1 << 12;

const E_CMD_ABORTED: u8 = 19;
const E_CMD_PENDING: u8 = 26;

/// Id of FAST STOP.
pub const FAST_STOP: u8 = 0x23;

/// Id of Stop.
pub const STOP: u8 = 0x22;

/// A WSG 50 whose motions never end on their own.
#[derive(Debug)]
pub struct Device {
    pub address: SocketAddr,
    shared: Arc<Shared>,
}

#[derive(Debug, Default)]
struct Shared {
    seen: Mutex<Seen>,
    frame_arrived: Condvar,
}

#[derive(Debug, Default)]
struct Seen {
    /// Id and arrival time of each frame.
    frames: Vec<(u8, Instant)>,
    /// Start time of each connection.
    connections: Vec<Instant>,
    current: Option<TcpStream>,
    is_over: bool,
}

impl Device {
    /// Starts a device, idle and referenced.
    pub fn start() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let (address, shared) = (listener.local_addr().unwrap(), Arc::<Shared>::default());
        let serving = shared.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let stream = stream.unwrap();
                if serving.seen().is_over {
                    return;
                }
                stream.set_nodelay(true).unwrap();
                // A read can block until the next update is due.
                stream.set_read_timeout(Some(UPDATE_EVERY / 2)).unwrap();
                let mut seen = serving.seen();
                seen.connections.push(Instant::now());
                seen.current = stream.try_clone().ok();
                drop(seen);
                // The gateway can close the connection at any time, and reconnects.
                let _ = serve(stream, &serving);
            }
        });
        Self { address, shared }
    }

    /// Number of frames with this id.
    pub fn count(&self, id: u8) -> usize {
        self.shared.seen().frames.iter().filter(|(other, _)| *other == id).count()
    }

    /// Waits for the first frame of this id after `since`.
    pub fn first_since(&self, id: u8, since: Instant, within: Duration) -> Option<Instant> {
        let until = since + within;
        let mut seen = self.shared.seen();
        loop {
            let after = seen.frames.iter().rev().take_while(|(_, at)| *at >= since);
            if let Some(at) = after.filter(|(other, _)| *other == id).map(|(_, at)| *at).min() {
                return Some(at);
            }
            let left = until.checked_duration_since(Instant::now())?;
            seen = self.shared.frame_arrived.wait_timeout(seen, left).unwrap().0;
        }
    }

    /// Drops the gateway's connection, and returns the time until it reconnects.
    pub fn reconnect_time(&self, within: Duration) -> Option<Duration> {
        let (dropped_at, before) = {
            let mut seen = self.shared.seen();
            let stream = seen.current.take().expect("the gateway is connected");
            stream.shutdown(Shutdown::Both).unwrap();
            (Instant::now(), seen.connections.len())
        };
        while dropped_at.elapsed() < within {
            if let Some(again) = self.shared.seen().connections.get(before) {
                return Some(*again - dropped_at);
            }
            std::thread::sleep(UPDATE_EVERY);
        }
        None
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        let mut seen = self.shared.seen();
        seen.is_over = true;
        if let Some(stream) = seen.current.take() {
            let _ = stream.shutdown(Shutdown::Both);
        }
        drop(seen);
        // Ends the wait for the next connection.
        let _ = TcpStream::connect(self.address);
    }
}

impl Shared {
    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap()
    }
}

/// State of the device on one connection.
struct State {
    flags: u32,
    /// Id of the running motion.
    motion: Option<u8>,
    updated: BTreeSet<u8>,
    begun_at: Instant,
}

fn serve(mut stream: TcpStream, shared: &Shared) -> std::io::Result<()> {
    let begun_at = Instant::now();
    let mut state = State { flags: REFERENCED, motion: None, updated: BTreeSet::new(), begun_at };
    let (mut received, mut buffer, mut updated_at) = (Vec::new(), [0; 4096], begun_at);
    loop {
        let mut out = Vec::new();
        match stream.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(bytes) => received.extend_from_slice(&buffer[..bytes]),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(error) => return Err(error),
        }
        while let Some((id, payload)) = take_frame(&mut received) {
            shared.seen().frames.push((id, Instant::now()));
            shared.frame_arrived.notify_all();
            state.answer(id, &payload, &mut out);
        }
        if updated_at.elapsed() >= UPDATE_EVERY {
            updated_at = Instant::now();
            state.update(&mut out);
        }
        stream.write_all(&out)?;
    }
}

/// Takes the first whole frame. TCP preserves bytes, so the checksum is not verified.
fn take_frame(received: &mut Vec<u8>) -> Option<(u8, Vec<u8>)> {
    const AROUND: usize = 8;
    let header = received.first_chunk::<6>()?;
    let size = usize::from(u16::from_le_bytes([header[4], header[5]]));
    let id = header[3];
    let frame: Vec<_> = (received.len() >= size + AROUND).then(|| received.drain(..size + AROUND).collect())?;
    assert_eq!(frame[..3], [0xAA; 3], "the gateway sends whole frames");
    Some((id, frame[6..6 + size].to_vec()))
}

impl State {
    fn answer(&mut self, id: u8, payload: &[u8], out: &mut Vec<u8>) {
        match id {
            0x06 => frame(id, &success(payload), out),
            0x20 | 0x21 | 0x25 | 0x26 => {
                self.motion = Some(id);
                self.flags |= MOVING;
                frame(id, &[E_CMD_PENDING, 0], out);
            }
            STOP | FAST_STOP | 0x24 => {
                frame(id, &success(&[]), out);
                self.flags &= !MOVING;
                match id {
                    FAST_STOP => self.flags |= FAST_STOP_SET,
                    STOP => {}
                    _ => self.flags &= !FAST_STOP_SET,
                }
                if let Some(motion) = self.motion.take() {
                    frame(motion, &[E_CMD_ABORTED, 0], out);
                }
                self.update(out);
            }
            0x35 => frame(id, &[1, 0], out),
            0x40 | 0x41 | 0x43..=0x45 => {
                if payload.first().is_some_and(|flags| flags & 1 == 1) {
                    self.updated.insert(id);
                } else {
                    self.updated.remove(&id);
                }
                self.value(id, out);
            }
            0x46 => frame(id, &success(&250_i16.to_le_bytes()), out),
            0x50 => frame(id, &success(&[1, 6, 0x20, 0x40, 0x67, 0x12, 0, 0]), out),
            0x53 => frame(id, &floats(&[110.0, 5.0, 420.0, 100.0, 5000.0, 5.0, 80.0, 120.0]), out),
            0x07 => frame(id, &success(&[]), out),
            // E_CMD_UNKNOWN
            _ => frame(id, &[0x0E, 0], out),
        }
    }

    fn update(&self, out: &mut Vec<u8>) {
        for &id in &self.updated {
            self.value(id, out);
        }
    }

    /// ERROR, POSITIONING or IDLE.
    fn state(&self) -> u8 {
        match self.motion {
            _ if self.flags & FAST_STOP_SET != 0 => 7,
            Some(_) => 6,
            None => 0,
        }
    }

    /// Appends the value of a getter. The width swings while a motion runs, so that each update is a change.
    fn value(&self, id: u8, out: &mut Vec<u8>) {
        let swing = self.motion.map_or(0.0, |_| self.begun_at.elapsed().as_secs_f32().sin());
        match id {
            0x40 => frame(id, &success(&self.flags.to_le_bytes()), out),
            0x41 => frame(id, &success(&[self.state()]), out),
            0x43 => frame(id, &floats(&[50.0 + 40.0 * swing]), out),
            _ => frame(id, &floats(&[swing.abs()]), out),
        }
    }
}

fn floats(values: &[f32]) -> Vec<u8> {
    success(&values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<_>>())
}
