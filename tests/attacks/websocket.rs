//! A WebSocket over a plain socket, frame by frame, for messages that client libraries do not send.

use std::io::{ErrorKind, Read as _, Write as _};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crate::gateway::Gateway;
use crate::http;

/// Interval of pongs: the gateway closes a socket after 3 s without one.
const LIVES_EVERY: Duration = Duration::from_millis(500);

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
}

impl Socket {
    pub fn open(gateway: &Gateway) -> Option<Self> {
        let mut stream = gateway.connect().ok()?;
        stream.write_all(upgrade(KEY).as_bytes()).ok()?;
        if http::read_answer(&mut stream)?.status != 101 {
            return None;
        }
        let (reading, has_ended) = (stream.try_clone().ok()?, Arc::<AtomicBool>::default());
        let ends = has_ended.clone();
        std::thread::spawn(move || {
            stay(reading);
            ends.store(true, Ordering::Relaxed);
        });
        Some(Self { stream, has_ended })
    }

    pub fn send(&mut self, opcode: u8, payload: &str) -> std::io::Result<()> {
        self.stream.write_all(&frame(opcode, payload.as_bytes()))
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

fn stay(mut stream: TcpStream) {
    let (mut buffer, mut lived_at) = ([0; 4096], Instant::now());
    if stream.set_read_timeout(Some(LIVES_EVERY)).is_err() {
        return;
    }
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => return,
            Ok(_) => {}
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
