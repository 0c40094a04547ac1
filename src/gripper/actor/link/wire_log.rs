//! The wire log: every frame in both directions, and damaged bytes from the device. Without listeners, it costs
//! nothing.

use std::sync::Arc;

use tokio::sync::broadcast;

use crate::Now;
use model::{DamageRecord, FrameDirection, FrameRecord, Name, WireDamage, WireRecord};
use wsg::frame::{HEADER_BYTES, OVERHEAD_BYTES};
use wsg::text::{WireDirection, describe, describe_damaged, describe_skipped};
use wsg::{self, ChecksumEvaluation, Decoded, Decoder, id};

/// Number of records that a listener can lag behind: about two seconds of a device on TCP.
const MAX_BEHIND: usize = 1024;

/// Maximum number of damaged bytes that a record shows.
const MAX_SHOWN_BYTES: usize = 256;

#[derive(Debug)]
pub(in crate::actor) struct WireLog {
    gripper: Name,
    listeners: broadcast::Sender<Arc<WireRecord>>,
    /// Sequence number of the newest record.
    seq: u64,
    /// Decoder of the device's bytes; `None` without listeners.
    received: Option<ReceivedBytes>,
    /// Whether the link has received nothing yet, so that the next byte begins a frame.
    is_at_start: bool,
}

/// Bytes from the device, decoded for the listeners.
#[derive(Debug)]
struct ReceivedBytes {
    decoder: Decoder,
    /// Bytes that the decoder has not yet classified.
    rest: Vec<u8>,
    /// Number of bytes at the start of `rest` that were already logged as part of a damaged frame.
    reported: usize,
    /// Whether a frame boundary is known. A listener can begin in the middle of a frame.
    is_in_step: bool,
}

impl WireLog {
    pub(in crate::actor) fn new(gripper: Name) -> Self {
        let listeners = broadcast::Sender::new(MAX_BEHIND);
        Self { gripper, listeners, seq: 0, received: None, is_at_start: true }
    }

    pub(super) fn listeners(&self) -> broadcast::Sender<Arc<WireRecord>> {
        self.listeners.clone()
    }

    /// Logs one complete frame.
    pub(in crate::actor) fn sent(&mut self, now: Now, bytes: &[u8]) {
        if self.listeners.receiver_count() == 0 {
            return;
        }
        let mut decoder = Decoder::of_requests(ChecksumEvaluation::On);
        decoder.push(bytes);
        while let Some(decoded) = decoder.next() {
            if let Decoded::Frame(frame) = decoded {
                self.log_frame(now, FrameDirection::Sent, frame);
            }
        }
    }

    /// Logs the frames in received bytes, and the bytes that are not part of a valid frame.
    pub(in crate::actor) fn received(&mut self, now: Now, bytes: &[u8]) {
        let is_at_start = std::mem::take(&mut self.is_at_start);
        if self.listeners.receiver_count() == 0 {
            self.received = None;
            return;
        }
        let mut received = self.received.take().unwrap_or_else(|| ReceivedBytes::new(is_at_start));
        received.rest.extend_from_slice(bytes);
        received.decoder.push(bytes);
        loop {
            let start = received.decoder.position();
            let Some(decoded) = received.decoder.next() else {
                let skipped = (received.decoder.position() - start) as usize;
                self.log_skipped(now, &mut received, skipped);
                break;
            };
            match decoded {
                Decoded::Frame(frame) => {
                    let id = frame.id;
                    let payload = frame.payload.to_vec();
                    let length = payload.len() + OVERHEAD_BYTES;
                    let skipped = (received.decoder.position() - start) as usize - length;
                    self.log_skipped(now, &mut received, skipped);
                    self.log_frame(now, FrameDirection::Received, wsg::Frame { id, payload: &payload });
                    received.take(length);
                    received.is_in_step = true;
                }
                Decoded::Damaged { id } => {
                    let skipped = (received.decoder.position() - start) as usize - 1;
                    self.log_skipped(now, &mut received, skipped);
                    self.log_damaged(now, &mut received, id);
                    received.take(1);
                }
                // No ids were named as opaque.
                Decoded::TooLong { .. } | Decoded::MissedFastStop => {}
            }
        }
        self.received = Some(received);
    }

    /// Drops partial frames of the previous link.
    pub(in crate::actor) fn link_up(&mut self) {
        self.received = None;
        self.is_at_start = true;
    }

    fn log_frame(&mut self, now: Now, direction: FrameDirection, frame: wsg::Frame<'_>) {
        self.seq += 1;
        let mut bytes = Vec::new();
        wsg::frame::encode(frame.id, frame.payload, &mut bytes);
        let read_as = match direction {
            FrameDirection::Sent => WireDirection::Request,
            FrameDirection::Received => WireDirection::Reply,
        };
        self.log(WireRecord::Frame(FrameRecord {
            gripper: self.gripper.clone(),
            seq: self.seq,
            at: now.wall,
            direction,
            id: frame.id,
            name: id::name(frame.id).map(ToOwned::to_owned),
            hex: hex::encode(bytes),
            text: describe(frame, read_as),
        }));
    }

    /// Logs the frame with a wrong checksum at the start of the bytes.
    fn log_damaged(&mut self, now: Now, received: &mut ReceivedBytes, id: u8) {
        let size = match received.rest.get(4..HEADER_BYTES) {
            Some(&[low, high]) => usize::from(u16::from_le_bytes([low, high])),
            _ => 0,
        };
        let length = (size + OVERHEAD_BYTES).min(received.rest.len());
        if received.is_in_step && received.reported < length {
            let name = id::name(id).map(ToOwned::to_owned);
            let text = describe_damaged(id);
            self.log_damage(now, &received.rest[..length], WireDamage::Checksum, (Some(id), name, text));
        }
        received.reported = received.reported.max(length);
    }

    /// Logs bytes that belong to no frame, unless they are part of a damaged frame.
    fn log_skipped(&mut self, now: Now, received: &mut ReceivedBytes, bytes: usize) {
        if received.is_in_step && received.reported < bytes {
            let skipped = &received.rest[received.reported..bytes];
            let text = describe_skipped(skipped.len() as u64);
            self.log_damage(now, skipped, WireDamage::Skipped, (None, None, text));
        }
        received.take(bytes);
    }

    fn log_damage(
        &mut self,
        now: Now,
        bytes: &[u8],
        damage: WireDamage,
        (id, name, text): (Option<u8>, Option<String>, String),
    ) {
        self.seq += 1;
        self.log(WireRecord::Damage(DamageRecord {
            gripper: self.gripper.clone(),
            seq: self.seq,
            at: now.wall,
            direction: FrameDirection::Received,
            damage,
            id,
            name,
            bytes: bytes.len(),
            hex: hex::encode(&bytes[..bytes.len().min(MAX_SHOWN_BYTES)]),
            text,
        }));
    }

    fn log(&self, record: WireRecord) {
        // The last listener may have just gone.
        let _ = self.listeners.send(Arc::new(record));
    }
}

impl ReceivedBytes {
    fn new(is_in_step: bool) -> Self {
        let decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
        Self { decoder, rest: Vec::new(), reported: 0, is_in_step }
    }

    /// Removes classified bytes.
    fn take(&mut self, bytes: usize) {
        self.rest.drain(..bytes);
        self.reported = self.reported.saturating_sub(bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the text and the hex of each record that the reads cause.
    fn logged(log: &mut WireLog, reads: &[&str]) -> Vec<(String, String)> {
        let mut listener = log.listeners().subscribe();
        for read in reads {
            log.received(Now::read(), &hex::decode(read).unwrap());
        }
        let mut told = Vec::new();
        while let Ok(record) = listener.try_recv() {
            told.push(match (*record).clone() {
                WireRecord::Frame(frame) => (frame.text, frame.hex),
                WireRecord::Damage(damage) => {
                    assert_eq!(damage.bytes * 2, damage.hex.len());
                    (damage.text, damage.hex)
                }
            });
        }
        told
    }

    fn texts(reads: &[&str]) -> Vec<String> {
        logged(&mut WireLog::new("left".parse().unwrap()), reads).into_iter().map(|(text, _)| text).collect()
    }

    const GOOD: &str = "aaaaaa2002000000b3fd";
    const DAMAGED: &str = "aaaaaa2002000000b3fe";

    #[test]
    fn damaged_frames_and_skipped_bytes_are_logged() {
        let good = "Homing -> E_SUCCESS";
        let damaged = "Homing  [checksum wrong]";
        assert_eq!(texts(&[GOOD, DAMAGED, GOOD]), [good, damaged, good]);
        assert_eq!(texts(&[&format!("{GOOD}000102{GOOD}")]), [good, "(3 bytes outside any frame)", good]);
        assert_eq!(texts(&[GOOD, "0001", &format!("02{GOOD}")]).len(), 4);
        assert_eq!(texts(&[&DAMAGED[..10], &DAMAGED[10..], GOOD]), [damaged, good]);
    }

    #[test]
    fn damage_has_its_bytes() {
        let mut log = WireLog::new("left".parse().unwrap());
        let told = logged(&mut log, &[DAMAGED, "0102"]);
        assert_eq!(told[0].1, DAMAGED);
        assert_eq!(told[1], ("(2 bytes outside any frame)".to_owned(), "0102".to_owned()));
    }

    #[test]
    fn listener_that_comes_within_a_frame_sees_no_damage() {
        let mut log = WireLog::new("left".parse().unwrap());
        log.received(Now::read(), &hex::decode(&GOOD[..8]).unwrap());
        assert_eq!(logged(&mut log, &[&GOOD[8..], GOOD]).len(), 1);
    }
}
