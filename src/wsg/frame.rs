//! Frames: `AA AA AA | id | size | payload | checksum`, little endian (`fw4-en 1.2.1`).
//!
//! [`encode`] appends a frame to a buffer. [`Decoder`] finds frames in a byte stream, and resynchronises after garbage,
//! damage or a truncated frame. After a rejected header, it continues one byte later in its buffer, so only the damaged
//! frame is lost. It allocates nothing per frame.

use super::crc;

/// First three bytes of every frame.
pub const PREAMBLE: [u8; 3] = [0xAA; 3];

/// Size in bytes of preamble, id and size field.
pub const HEADER_BYTES: usize = 6;

/// Bytes of a frame besides its payload: header and checksum.
pub const OVERHEAD_BYTES: usize = HEADER_BYTES + 2;

/// A frame without its checksum, which was verified unless [`ChecksumEvaluation`] is off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Command id.
    pub id: u8,
    /// Bytes between the size field and the checksum.
    pub payload: &'a [u8],
}

/// Appends the frame of `id` and `payload` to `out`.
///
/// The size field has 16 bits, so a longer payload is truncated to 65535 bytes. No type of this crate can hold one.
pub fn encode(id: u8, payload: &[u8], out: &mut Vec<u8>) {
    encode_with(id, out, |out| out.extend_from_slice(payload));
}

/// Appends a frame of `id` with the payload that `write` appends.
pub fn encode_with(id: u8, out: &mut Vec<u8>, write: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    out.extend_from_slice(&PREAMBLE);
    out.extend_from_slice(&[id, 0, 0]);
    write(out);
    out.truncate(start + HEADER_BYTES + usize::from(u16::MAX));
    let size = (out.len() - start - HEADER_BYTES) as u16;
    out[start + 4..start + HEADER_BYTES].copy_from_slice(&size.to_le_bytes());
    let checksum = crc::checksum(&out[start..]);
    out.extend_from_slice(&checksum.to_le_bytes());
}

/// Whether a receiver evaluates checksums. Only a device can be configured not to (`fw4-en 1.4.1`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ChecksumEvaluation {
    /// Frames with a wrong checksum are rejected.
    #[default]
    On,
    /// The two checksum bytes must be present, but can have any value.
    Off,
}

/// A finding of a [`Decoder`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decoded<'a> {
    /// A valid frame.
    Frame(Frame<'a>),
    /// An apparent frame with a wrong checksum. Decoding continues one byte after its start.
    Damaged {
        /// Id in the rejected header.
        id: u8,
    },
}

/// Counters of a [`Decoder`] since its creation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DecoderCounters {
    /// Bytes received.
    pub bytes: u64,
    /// Valid frames.
    pub frames: u64,
    /// Frames rejected because of a wrong checksum.
    pub checksum_errors: u64,
    /// Frames rejected because their size exceeds the limit of their id.
    pub oversized: u64,
    /// Frames given up because the remaining bytes did not arrive.
    pub cut_short: u64,
    /// Bytes that belonged to no valid frame.
    pub skipped_bytes: u64,
    /// Number of times a valid frame followed skipped bytes.
    pub resynchronisations: u64,
}

/// Frame decoder for a byte stream.
#[derive(Debug)]
pub struct Decoder {
    buffer: Vec<u8>,
    /// Index in `buffer` of the first byte that is not yet classified.
    start: usize,
    max_payload_bytes: fn(u8) -> usize,
    evaluation: ChecksumEvaluation,
    in_sync: bool,
    counters: DecoderCounters,
}

impl Decoder {
    /// Creates a decoder that accepts payloads of up to `max_payload_bytes(id)` bytes. A larger size field counts as
    /// damage and ends the frame at once, so that it cannot swallow the frames after it.
    #[must_use]
    pub fn new(max_payload_bytes: fn(u8) -> usize, evaluation: ChecksumEvaluation) -> Self {
        let counters = DecoderCounters::default();
        Self { buffer: Vec::new(), start: 0, max_payload_bytes, evaluation, in_sync: true, counters }
    }

    /// Appends received bytes. After each call, call [`Decoder::next`] until it returns `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
        self.counters.bytes += bytes.len() as u64;
    }

    /// Returns the next finding in the pushed bytes, or `None` until more bytes arrive.
    #[allow(clippy::should_implement_trait, reason = "the result borrows from the decoder, unlike an Iterator's item")]
    pub fn next(&mut self) -> Option<Decoded<'_>> {
        let (id, end) = loop {
            let candidate = self.candidate()?;
            match candidate {
                Candidate::Oversized => {
                    self.counters.oversized += 1;
                    self.discard(1);
                }
                Candidate::Complete { id, end } => break (id, end),
            }
        };
        if self.evaluation == ChecksumEvaluation::On && crc::checksum(&self.buffer[self.start..end]) != 0 {
            self.counters.checksum_errors += 1;
            self.discard(1);
            return Some(Decoded::Damaged { id });
        }
        if !self.in_sync {
            self.in_sync = true;
            self.counters.resynchronisations += 1;
        }
        self.counters.frames += 1;
        let payload = self.start + HEADER_BYTES..end - 2;
        self.start = end;
        Some(Decoded::Frame(Frame { id, payload: &self.buffer[payload] }))
    }

    /// Whether the start of a frame is waiting for its remaining bytes.
    #[must_use]
    pub fn is_partial(&self) -> bool {
        self.start < self.buffer.len()
    }

    /// Received bytes of a frame that is still incomplete.
    #[must_use]
    pub fn partial(&self) -> &[u8] {
        self.buffer.get(self.start..).unwrap_or_default()
    }

    /// Stream position in bytes of the first unclassified byte.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.counters.bytes - (self.buffer.len() - self.start) as u64
    }

    /// Gives up an incomplete frame whose remaining bytes did not arrive in time. Call [`Decoder::next`] afterwards,
    /// because a whole frame can follow a false start.
    pub fn give_up_partial(&mut self) {
        if self.is_partial() {
            self.counters.cut_short += 1;
            self.discard(1);
        }
    }

    /// Current counter values.
    #[must_use]
    pub fn counters(&self) -> DecoderCounters {
        self.counters
    }

    /// Advances `start` to the next header whose frame is complete or oversized.
    fn candidate(&mut self) -> Option<Candidate> {
        loop {
            let rest = &self.buffer[self.start..];
            let matching = rest.iter().zip(PREAMBLE).take_while(|&(&byte, preamble)| byte == preamble).count();
            if matching < PREAMBLE.len() {
                if matching == rest.len() {
                    return None;
                }
                self.discard(matching + 1);
                continue;
            }
            let id = *rest.get(3)?;
            if id == PREAMBLE[0] {
                // A fourth AAh: an id AAh is indistinguishable from a run, whose last three bytes are the preamble.
                self.discard(1);
                continue;
            }
            let size = usize::from(u16::from_le_bytes([*rest.get(4)?, *rest.get(5)?]));
            if size > (self.max_payload_bytes)(id) {
                return Some(Candidate::Oversized);
            }
            let end = self.start + size + OVERHEAD_BYTES;
            return (self.buffer.len() >= end).then_some(Candidate::Complete { id, end });
        }
    }

    fn discard(&mut self, bytes: usize) {
        self.start += bytes;
        self.in_sync = false;
        self.counters.skipped_bytes += bytes as u64;
    }
}

enum Candidate {
    Oversized,
    Complete { id: u8, end: usize },
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decoder() -> Decoder {
        Decoder::new(|_| 300, ChecksumEvaluation::On)
    }

    fn frames(decoder: &mut Decoder) -> Vec<(u8, Vec<u8>)> {
        let mut found = Vec::new();
        while let Some(decoded) = decoder.next() {
            if let Decoded::Frame(frame) = decoded {
                found.push((frame.id, frame.payload.to_vec()));
            }
        }
        found
    }

    fn frame(id: u8, payload: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        encode(id, payload, &mut out);
        out
    }

    /// Frames printed in the manuals (`fw4-en 1.2.1`, `1.2.2`, `1.3`). Do not change them.
    #[test]
    fn golden_frames_of_the_manuals() {
        let golden: [(&str, u8, &[u8]); 7] = [
            ("AAAAAA010000E810", 0x01, &[]),
            ("AAAAAA01020012346D66", 0x01, &[0x12, 0x34]),
            ("AAAAAA2002000000B3FD", 0x20, &[0, 0]),
            ("AAAAAA9002000E00FD02", 0x90, &[0x0E, 0]),
            ("AAAAAA2102001A0067CB", 0x21, &[0x1A, 0]),
            ("AAAAAA21020000002804", 0x21, &[0, 0]),
            ("AAAAAA310600000000001643 1CAF", 0x31, &[0, 0, 0, 0, 0x16, 0x43]),
        ];
        for (printed, id, payload) in golden {
            let bytes = hex::decode(printed.replace(' ', "")).unwrap();
            assert_eq!(frame(id, payload), bytes, "{printed}");
            let mut decoder = decoder();
            decoder.push(&bytes);
            assert_eq!(frames(&mut decoder), [(id, payload.to_vec())], "{printed}");
        }
    }

    /// The reply to Get Acceleration is printed with one 00h missing (`fw4-en 1.2.2`, example 3).
    #[test]
    fn ruling_the_damaged_printed_frame_is_a_frame_cut_short() {
        let printed = hex::decode("AAAAAA3006000000001643DCCB").unwrap();
        let mut decoder = decoder();
        decoder.push(&printed);
        assert_eq!(frames(&mut decoder), []);
        assert!(decoder.is_partial());
        decoder.push(&frame(0x20, &[0, 0]));
        assert_eq!(frames(&mut decoder), [(0x20, vec![0, 0])], "the next frame is found");
        assert_eq!(decoder.counters().checksum_errors, 1);

        let restored = hex::decode("AAAAAA300600000000001643DCCB").unwrap();
        assert_eq!(frame(0x30, &[0, 0, 0, 0, 0x16, 0x43]), restored, "with the 00h its checksum is right");
    }

    #[test]
    fn frame_split_at_any_byte_is_found() {
        let bytes = [frame(0x43, &[0, 0, 1, 2, 3, 4]), frame(0x06, &[0xAA; 20])].concat();
        for split in 0..bytes.len() {
            let mut decoder = decoder();
            decoder.push(&bytes[..split]);
            let mut found = frames(&mut decoder);
            decoder.push(&bytes[split..]);
            found.extend(frames(&mut decoder));
            assert_eq!(found, [(0x43, vec![0, 0, 1, 2, 3, 4]), (0x06, vec![0xAA; 20])], "split at {split}");
            assert_eq!(decoder.counters().skipped_bytes, 0);
        }
    }

    #[test]
    fn garbage_and_runs_of_aa_lose_no_frame() {
        let mut decoder = decoder();
        let good = frame(0x41, &[0, 0, 4]);
        let stream = [&[0x00, 0xAA, 0xAA, 0x01][..], &good, &[0xAA; 5], &good, &[0xAA], &good].concat();
        decoder.push(&stream);
        assert_eq!(frames(&mut decoder).len(), 3);
        assert_eq!(decoder.counters().resynchronisations, 3);
        assert_eq!(decoder.counters().skipped_bytes, 4 + 5 + 1);
    }

    #[test]
    fn oversized_frame_ends_at_once() {
        let mut decoder = decoder();
        decoder.push(&[0xAA, 0xAA, 0xAA, 0x40, 0xFF, 0xFF]);
        decoder.push(&frame(0x40, &[0, 0, 1, 0, 0, 0]));
        assert_eq!(frames(&mut decoder).len(), 1);
        assert_eq!(decoder.counters().oversized, 1);
    }

    #[test]
    fn giving_up_partial_frame_reveals_frame_inside() {
        let mut decoder = decoder();
        decoder.push(&[0xAA, 0xAA, 0xAA, 0x06, 0x20, 0x00]);
        decoder.push(&frame(0x41, &[0, 0, 4]));
        assert_eq!(frames(&mut decoder), []);
        decoder.give_up_partial();
        assert_eq!(frames(&mut decoder), [(0x41, vec![0, 0, 4])]);
        assert!(!decoder.is_partial());
        assert_eq!(decoder.counters().cut_short, 1);
    }

    #[test]
    fn evaluation_off_accepts_any_checksum_but_requires_one() {
        let mut decoder = Decoder::new(|_| 300, ChecksumEvaluation::Off);
        let mut bytes = frame(0x22, &[]);
        bytes[6..].copy_from_slice(&[0x12, 0x34]);
        decoder.push(&bytes[..7]);
        assert_eq!(frames(&mut decoder), []);
        decoder.push(&bytes[7..]);
        assert_eq!(frames(&mut decoder), [(0x22, vec![])]);
    }
}
