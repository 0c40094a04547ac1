//! A TCP client of the WSG port. Like real drivers, it requires whole frames in each read.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use wsg_gateway::wsg::{ChecksumEvaluation, Decoded, Decoder, frame, id};

use super::DEADLINE;

/// `E_CMD_PENDING`
pub const PENDING: u16 = 26;

#[derive(Debug, Clone, PartialEq)]
pub struct Reply {
    pub id: u8,
    pub status: u16,
    pub data: Vec<u8>,
}

/// A connection to a WSG port.
#[derive(Debug)]
pub struct Driver {
    stream: TcpStream,
    decoder: Decoder,
    waiting: VecDeque<Reply>,
}

/// Encodes a request.
pub fn request(id: u8, payload: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    frame::encode(id, payload, &mut bytes);
    bytes
}

/// Encodes parameters.
pub fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// Parameters of 21h: absolute, stop on block.
pub fn move_to(width_mm: f32, speed_mm_s: f32) -> Vec<u8> {
    [&[2], floats(&[width_mm, speed_mm_s]).as_slice()].concat()
}

impl Driver {
    pub async fn connect(port: SocketAddr) -> Self {
        Self::over(TcpStream::connect(port).await.unwrap())
    }

    pub fn over(stream: TcpStream) -> Self {
        stream.set_nodelay(true).unwrap();
        let decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
        Self { stream, decoder, waiting: VecDeque::new() }
    }

    pub async fn send(&mut self, id: u8, payload: &[u8]) {
        self.send_raw(&request(id, payload)).await;
    }

    pub async fn send_raw(&mut self, bytes: &[u8]) {
        self.stream.write_all(bytes).await.unwrap();
    }

    pub async fn next(&mut self) -> Reply {
        self.next_within(DEADLINE).await.expect("a frame")
    }

    /// Returns the next frame, if one arrives in time.
    pub async fn next_within(&mut self, limit: Duration) -> Option<Reply> {
        let reading = async {
            while self.waiting.is_empty() {
                let mut bytes = [0; 4096];
                let read = self.stream.read(&mut bytes).await.unwrap();
                assert!(read > 0, "the port has closed the connection");
                self.decoder.push(&bytes[..read]);
                while let Some(decoded) = self.decoder.next() {
                    let Decoded::Frame(frame) = decoded else { panic!("a damaged frame: {decoded:?}") };
                    let (status, data) = frame.payload.split_first_chunk().expect("a status");
                    let status = u16::from_le_bytes(*status);
                    self.waiting.push_back(Reply { id: frame.id, status, data: data.to_vec() });
                }
                assert!(!self.decoder.is_partial(), "half a frame was sent");
                assert_eq!(self.decoder.counters().skipped_bytes, 0, "bytes outside a frame were sent");
            }
            self.waiting.pop_front()
        };
        tokio::time::timeout(limit, reading).await.ok().flatten()
    }

    /// Sends a request, and takes the next frame, which must be its reply.
    pub async fn ask(&mut self, id: u8, payload: &[u8]) -> Reply {
        self.send(id, payload).await;
        let reply = self.next().await;
        assert_eq!(reply.id, id, "wrong id: {reply:?}");
        reply
    }

    /// Sends a request, and returns the status of its reply.
    pub async fn status(&mut self, id: u8, payload: &[u8]) -> u16 {
        self.ask(id, payload).await.status
    }

    /// Like [`Driver::status`], but skips updates of other ids before the reply.
    pub async fn status_among_updates(&mut self, id: u8, payload: &[u8]) -> u16 {
        self.send(id, payload).await;
        loop {
            let reply = self.next().await;
            if reply.id == id {
                return reply.status;
            }
            assert!(id::has_updates(reply.id), "wrong id: {reply:?}");
        }
    }

    /// Runs a motion to its end: pending frame, then the returned status.
    pub async fn run(&mut self, id: u8, payload: &[u8]) -> u16 {
        assert_eq!(self.status(id, payload).await, PENDING);
        self.end_of(id).await
    }

    /// Waits for the second frame of a motion, and returns its status.
    pub async fn end_of(&mut self, id: u8) -> u16 {
        let reply = self.next().await;
        assert_eq!(reply.id, id, "wrong id: {reply:?}");
        assert!(reply.status != PENDING && reply.data.is_empty(), "{reply:?}");
        reply.status
    }

    pub async fn flags(&mut self) -> u32 {
        let reply = self.ask(0x40, &[0; 3]).await;
        assert_eq!(reply.status, 0, "{reply:?}");
        u32::from_le_bytes(reply.data.try_into().unwrap())
    }

    /// Announces the disconnect (07h), and closes.
    pub async fn leave(mut self) {
        assert_eq!(self.status(0x07, &[]).await, 0);
    }

    /// Whether the port closes the connection without further bytes.
    pub async fn has_ended(&mut self) -> bool {
        let read = tokio::time::timeout(DEADLINE, self.stream.read(&mut [0; 16])).await.expect("an end");
        matches!(read, Ok(0) | Err(_))
    }

    /// Closes the sending side, and goes on reading.
    pub async fn end_sending(&mut self) {
        self.stream.shutdown().await.unwrap();
    }

    /// Closes with a TCP reset, so that unread bytes do not matter.
    pub fn reset(self) {
        self.stream.set_zero_linger().unwrap();
    }
}
