//! The wire log: every frame in both directions, for listeners. It costs nothing without listeners.

use std::sync::Arc;

use tokio::sync::broadcast;

use super::super::Now;
use super::super::model::{FrameDirection, FrameRecord, Name};
use crate::wsg::text::{WireDirection, describe};
use crate::wsg::{self, ChecksumEvaluation, Decoded, Decoder, id};

/// Frames that a listener can lag behind: about two seconds of a device on TCP.
const MAX_BEHIND: usize = 1024;

#[derive(Debug)]
pub(super) struct WireLog {
    gripper: Name,
    listeners: broadcast::Sender<Arc<FrameRecord>>,
    /// Sequence number of the newest frame.
    seq: u64,
    /// Decoder of the device's bytes; `None` without listeners.
    decoder: Option<Decoder>,
}

impl WireLog {
    pub(super) fn new(gripper: Name) -> Self {
        Self { gripper, listeners: broadcast::Sender::new(MAX_BEHIND), seq: 0, decoder: None }
    }

    pub(super) fn listeners(&self) -> broadcast::Sender<Arc<FrameRecord>> {
        self.listeners.clone()
    }

    /// Logs one complete frame.
    pub(super) fn sent(&mut self, now: Now, bytes: &[u8]) {
        if self.listeners.receiver_count() == 0 {
            return;
        }
        let mut decoder = Decoder::new(id::max_request_bytes, ChecksumEvaluation::On);
        decoder.push(bytes);
        while let Some(Decoded::Frame(frame)) = decoder.next() {
            self.tell(now, FrameDirection::Sent, frame);
        }
    }

    /// Logs the frames in received bytes.
    pub(super) fn received(&mut self, now: Now, bytes: &[u8]) {
        if self.listeners.receiver_count() == 0 {
            self.decoder = None;
            return;
        }
        let new = || Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
        let mut decoder = self.decoder.take().unwrap_or_else(new);
        decoder.push(bytes);
        while let Some(decoded) = decoder.next() {
            if let Decoded::Frame(frame) = decoded {
                self.tell(now, FrameDirection::Received, frame);
            }
        }
        self.decoder = Some(decoder);
    }

    /// Drops partial frames of the previous link.
    pub(super) fn link_up(&mut self) {
        self.decoder = None;
    }

    fn tell(&mut self, now: Now, direction: FrameDirection, frame: wsg::Frame<'_>) {
        self.seq += 1;
        let mut bytes = Vec::new();
        wsg::frame::encode(frame.id, frame.payload, &mut bytes);
        let read_as = match direction {
            FrameDirection::Sent => WireDirection::Request,
            FrameDirection::Received => WireDirection::Reply,
        };
        let record = FrameRecord {
            gripper: self.gripper.clone(),
            seq: self.seq,
            at: now.wall,
            direction,
            id: frame.id,
            name: id::name(frame.id).map(ToOwned::to_owned),
            hex: hex::encode(bytes),
            text: describe(frame, read_as),
        };
        // The last listener may have just gone.
        let _ = self.listeners.send(Arc::new(record));
    }
}
