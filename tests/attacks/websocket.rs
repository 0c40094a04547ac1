//! A WebSocket over a plain socket, frame by frame, for messages that client libraries do not send.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::gateway::Gateway;
use crate::http;

/// Interval of pongs: the gateway closes a socket after 3 s without one.
const LIVES_EVERY: Duration = Duration::from_millis(500);

const LOOK_EVERY: Duration = Duration::from_millis(1);

/// A part of each message with a result.
const RESULT: &[u8] = br#""result":"#;

pub const TEXT: u8 = 1;
pub const BINARY: u8 = 2;
pub const PONG: u8 = 10;

/// Key of the example in RFC 6455.
pub const KEY: &str = "dGhlIHNhbXBsZSBub25jZQ==";

/// Head of an upgrade request.
pub fn upgrade(key: &str) -> String {
    format!(
        "GET /api/v1/ws HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n\
         Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Protocol: wsg.v1\r\n\r\n"
    )
}

/// Encodes a whole client frame with a zero mask.
pub fn frame(opcode: u8, payload: &[u8]) -> Vec<u8> {
    let length = match payload.len() {
        short @ 0..126 => vec![0x80 | short as u8],
        middle @ 126..=0xFFFF => [&[0xFE], &(middle as u16).to_be_bytes()[..]].concat(),
        long => [&[0xFF], &(long as u64).to_be_bytes()[..]].concat(),
    };
    [&[0x80 | opcode], &length[..], &[0; 4], payload].concat()
}

/// An open WebSocket of a well-behaved client, which reads and drops all messages.
#[derive(Debug)]
pub struct Socket {
    stream: TcpStream,
    has_ended: Arc<AtomicBool>,
    answers: Arc<AtomicUsize>,
}

impl Socket {
    pub fn open(gateway: &Gateway) -> Option<Self> {
        let mut stream = gateway.connect().ok()?;
        stream.write_all(upgrade(KEY).as_bytes()).ok()?;
        if http::read_answer(&mut stream)?.status != 101 {
            return None;
        }
        let (reading, has_ended) = (stream.try_clone().ok()?, Arc::<AtomicBool>::default());
        let (ends, answers) = (has_ended.clone(), Arc::<AtomicUsize>::default());
        let counts = answers.clone();
        std::thread::spawn(move || {
            stay(reading, &counts);
            ends.store(true, Ordering::Relaxed);
        });
        Some(Self { stream, has_ended, answers })
    }

    pub fn send(&mut self, opcode: u8, payload: &str) -> std::io::Result<()> {
        self.stream.write_all(&frame(opcode, payload.as_bytes()))
    }

    /// Number of results received so far.
    pub fn answers(&self) -> usize {
        self.answers.load(Ordering::Relaxed)
    }

    /// Waits until there are more results than `before`.
    pub fn has_more_answers(&self, before: usize, within: Duration) -> bool {
        let until = Instant::now() + within;
        while self.answers() <= before && !self.has_ended() && Instant::now() < until {
            std::thread::sleep(LOOK_EVERY);
        }
        self.answers() > before
    }

    /// Whether the gateway has closed the socket.
    pub fn has_ended(&self) -> bool {
        self.has_ended.load(Ordering::Relaxed)
    }
}

impl Drop for Socket {
    fn drop(&mut self) {
        let _ = self.stream.shutdown(std::net::Shutdown::Both);
    }
}

/// Reads messages until the socket ends, and counts the results. The socket follows nothing, so there is nothing else.
fn stay(mut stream: TcpStream, answers: &AtomicUsize) {
    let (mut buffer, mut lived_at, mut received) = ([0; 4096], Instant::now(), Vec::new());
    if stream.set_read_timeout(Some(LIVES_EVERY)).is_err() {
        return;
    }
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => return,
            Ok(bytes) => {
                received.extend_from_slice(&buffer[..bytes]);
                while let Some(at) = received.windows(RESULT.len()).position(|part| part == RESULT) {
                    received.drain(..at + RESULT.len());
                    answers.fetch_add(1, Ordering::Relaxed);
                }
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => return,
        }
        if lived_at.elapsed() >= LIVES_EVERY {
            lived_at = Instant::now();
            if stream.write_all(&frame(PONG, &[])).is_err() {
                return;
            }
        }
    }
}
