//! A client of the WSG port, by TCP. It reads as drivers do, and holds the port to what they need: whole frames.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::time::Duration;

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use wsg_gateway::wsg::{ChecksumEvaluation, Decoded, Decoder, frame, id};

use super::DEADLINE;

/// `E_CMD_PENDING`
pub const PENDING: u16 = 26;

/// A frame from the port.
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

/// A request as it is sent.
pub fn request(id: u8, payload: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    frame::encode(id, payload, &mut bytes);
    bytes
}

/// The parameters of these numbers.
pub fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

/// The parameters of 21h: absolute, stop on block.
pub fn move_to(width_mm: f32, speed_mm_s: f32) -> Vec<u8> {
    [&[2], floats(&[width_mm, speed_mm_s]).as_slice()].concat()
}

impl Driver {
    pub async fn connect(port: SocketAddr) -> Self {
        Self::over(TcpStream::connect(port).await.unwrap())
    }

    /// On this connection.
    pub fn over(stream: TcpStream) -> Self {
        stream.set_nodelay(true).unwrap();
        let decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
        Self { stream, decoder, waiting: VecDeque::new() }
    }

    /// Sends a request.
    pub async fn send(&mut self, id: u8, payload: &[u8]) {
        self.send_raw(&request(id, payload)).await;
    }

    /// Sends bytes.
    pub async fn send_raw(&mut self, bytes: &[u8]) {
        self.stream.write_all(bytes).await.unwrap();
    }

    /// The next frame, whatever it is.
    pub async fn next(&mut self) -> Reply {
        self.next_within(DEADLINE).await.expect("a frame")
    }

    /// The next frame, if one comes in time.
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
                assert!(!self.decoder.is_partial(), "half a frame was sent by itself");
                assert_eq!(self.decoder.counters().skipped_bytes, 0, "what is no frame was sent");
            }
            self.waiting.pop_front()
        };
        tokio::time::timeout(limit, reading).await.ok().flatten()
    }

    /// Asks, and takes the next frame, which has to be the answer.
    pub async fn ask(&mut self, id: u8, payload: &[u8]) -> Reply {
        self.send(id, payload).await;
        let reply = self.next().await;
        assert_eq!(reply.id, id, "not what was asked for: {reply:?}");
        reply
    }

    /// The status that a request gets.
    pub async fn status(&mut self, id: u8, payload: &[u8]) -> u16 {
        self.ask(id, payload).await.status
    }

    /// The status that a request gets, whose answer may come behind updates of others.
    pub async fn status_among_updates(&mut self, id: u8, payload: &[u8]) -> u16 {
        self.send(id, payload).await;
        loop {
            let reply = self.next().await;
            if reply.id == id {
                return reply.status;
            }
            assert!(id::has_updates(reply.id), "not what was asked for: {reply:?}");
        }
    }

    /// Runs a motion to its end: both its frames, and then its status.
    pub async fn run(&mut self, id: u8, payload: &[u8]) -> u16 {
        assert_eq!(self.status(id, payload).await, PENDING);
        self.end_of(id).await
    }

    /// The second frame of a motion.
    pub async fn end_of(&mut self, id: u8) -> u16 {
        let reply = self.next().await;
        assert_eq!(reply.id, id, "not what was asked for: {reply:?}");
        assert!(reply.status != PENDING && reply.data.is_empty(), "{reply:?}");
        reply.status
    }

    /// The system state flags.
    pub async fn flags(&mut self) -> u32 {
        let reply = self.ask(0x40, &[0; 3]).await;
        assert_eq!(reply.status, 0, "{reply:?}");
        u32::from_le_bytes(reply.data.try_into().unwrap())
    }

    /// Announces the end, and leaves.
    pub async fn leave(mut self) {
        assert_eq!(self.status(0x07, &[]).await, 0);
    }

    /// Whether the port ends the connection, with nothing left to read.
    pub async fn has_ended(&mut self) -> bool {
        let read = tokio::time::timeout(DEADLINE, self.stream.read(&mut [0; 16])).await.expect("an end");
        matches!(read, Ok(0) | Err(_))
    }

    /// Leaves so that unread bytes don't matter: with a reset.
    pub fn reset(self) {
        self.stream.set_zero_linger().unwrap();
    }
}
