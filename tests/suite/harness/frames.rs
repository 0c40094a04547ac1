//! Frames captured on a link.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use wsg_gateway::wsg::id::MAX_OPAQUE_BYTES;
use wsg_gateway::wsg::{ChecksumEvaluation, Decoded, Decoder};

use super::MOTIONS;

/// One frame to the device.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Index of the connection that carried the frame, from 0.
    pub connection: usize,
    pub id: u8,
    pub payload: Vec<u8>,
    pub at: Instant,
}

impl Frame {
    /// Whether the gateway sends this frame on its own: automatic updates on, the temperature, or a Loop of the
    /// session.
    pub fn is_upkeep(&self) -> bool {
        matches!((self.id, self.payload.first()), (0x40 | 0x41 | 0x43..=0x45, Some(flags)) if flags & 1 == 1)
            || matches!(self.id, 0x46 | 0x06)
    }

    pub fn is_motion(&self) -> bool {
        MOTIONS.contains(&self.id)
    }
}

/// All frames to the device so far.
#[derive(Debug, Clone, Default)]
pub struct Frames(Arc<Mutex<Vec<Frame>>>);

impl Frames {
    /// Frames from index `first` on.
    pub fn since(&self, first: usize) -> Vec<Frame> {
        self.0.lock().unwrap()[first..].to_vec()
    }

    pub fn all(&self) -> Vec<Frame> {
        self.since(0)
    }

    pub fn len(&self) -> usize {
        self.0.lock().unwrap().len()
    }

    /// Number of frames with this id.
    pub fn count(&self, id: u8) -> usize {
        self.all().iter().filter(|frame| frame.id == id).count()
    }

    /// Time of the first frame of this id since `since`.
    pub fn first_since(&self, id: u8, since: Instant) -> Option<Instant> {
        self.all().iter().filter(|frame| frame.id == id && frame.at >= since).map(|frame| frame.at).min()
    }

    /// Number of frames that move the fingers.
    pub fn motions(&self) -> usize {
        self.all().iter().filter(|frame| frame.is_motion()).count()
    }

    /// Returns a recorder for one connection.
    pub fn recorder(&self, connection: usize) -> Recorder {
        let decoder = Decoder::new(|_| MAX_OPAQUE_BYTES, ChecksumEvaluation::On);
        Recorder { frames: self.clone(), decoder, connection }
    }
}

/// Extracts the frames from one connection's bytes.
#[derive(Debug)]
pub struct Recorder {
    frames: Frames,
    decoder: Decoder,
    connection: usize,
}

impl Recorder {
    /// Takes bytes that the gateway sent, and panics if a frame is damaged.
    pub fn push(&mut self, bytes: &[u8]) {
        self.decoder.push(bytes);
        while let Some(decoded) = self.decoder.next() {
            let Decoded::Frame(frame) = decoded else { panic!("the gateway sent a damaged frame: {decoded:?}") };
            let (connection, id, payload) = (self.connection, frame.id, frame.payload.to_vec());
            self.frames.0.lock().unwrap().push(Frame { connection, id, payload, at: Instant::now() });
        }
        assert_eq!(self.decoder.counters().skipped_bytes, 0, "the gateway sent bytes outside a frame");
    }
}
