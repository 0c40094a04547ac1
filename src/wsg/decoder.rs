//! Finding frames in a byte stream.
//!
//! [`Decoder`] resynchronises after garbage, damage or a truncated frame. It allocates nothing per frame.
//!
//! # Rejected frames
//!
//! An apparent frame is rejected if its checksum is wrong, or if its rest does not arrive. Nobody then knows what is
//! damaged: its payload, or its size field, so that it contains the frames behind it. The id decides:
//!
//! - Most replies have short payloads of numbers, which contain no frames. The decoder continues one byte after the
//!   rejected header, so that only the damaged frame is lost. A size above what the id allows rejects the frame at
//!   once.
//! - The payload of an *opaque* id is anybody's bytes, also whole frames: that of each request, and of a reply to Loop,
//!   to a script or with finger data. Ruling: a rejected frame is dropped, since a motion in its payload must not be
//!   executed. Nothing says where its payload ends. So the next frame begins directly behind the announced end, or
//!   behind a [pause](Decoder::pause); until then, all bytes are dropped. Such frames have any size of 16 bits
//!   (`fw4-en 1.2.1`). One that is longer than its limit is checked and counted, but not kept.
//! - A whole FAST STOP in the dropped bytes of requests is reported. It may be one behind a damaged size field, and a
//!   stop too many does less harm than a stop too few.

use super::frame::{ChecksumEvaluation, Frame, HEADER_BYTES, OVERHEAD_BYTES, PREAMBLE};
use super::missed_fast_stop::MissedFastStop;
use super::{crc, id};

/// Length of a Disconnect Announcement with a size field of one byte, checksum included.
const SHORT_ANNOUNCEMENT_BYTES: usize = 7;

/// A finding of a [`Decoder`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decoded<'a> {
    /// A valid frame.
    Frame(Frame<'a>),
    /// A valid frame of an opaque id whose payload exceeds the limit of the id, so that it was not kept.
    TooLong {
        /// Command id.
        id: u8,
        /// Size of the payload in bytes.
        payload_bytes: usize,
    },
    /// An apparent frame with a wrong checksum.
    Damaged {
        /// Id in the rejected header.
        id: u8,
    },
    /// A whole FAST STOP in the dropped bytes of requests.
    MissedFastStop,
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
    opaque: OpaqueIds,
    /// Whether a Disconnect Announcement can have a size field of one byte.
    has_short_announcements: bool,
    boundary: Boundary,
    /// The frame that is being received, but not kept.
    long: Option<LongFrame>,
    missed: MissedFastStop,
    in_sync: bool,
    counters: DecoderCounters,
}

/// Ids whose payloads can contain frames.
#[derive(Debug)]
enum OpaqueIds {
    /// Every id: the frames are requests.
    All,
    /// The ids of expected replies.
    Some(Vec<u8>),
}

/// Position at which the next frame can begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Boundary {
    /// At any preamble.
    Anywhere,
    /// At the next byte, or later at [`Boundary::Lost`].
    Here,
    /// Behind a pause.
    Lost,
}

/// A frame of an opaque id, longer than the limit.
#[derive(Debug)]
struct LongFrame {
    id: u8,
    payload_bytes: usize,
    received_bytes: usize,
    /// Checksum of the received bytes.
    crc: u16,
}

impl LongFrame {
    fn missing_bytes(&self) -> usize {
        self.payload_bytes + OVERHEAD_BYTES - self.received_bytes
    }
}

enum Candidate {
    Oversized { id: u8 },
    Complete { id: u8, payload: std::ops::Range<usize>, end: usize },
    Long(LongFrame),
    FastStop,
}

impl Decoder {
    /// Creates a decoder of replies with payloads of up to `max_payload_bytes(id)` bytes. No id is opaque until
    /// [`Decoder::expect_opaque`] names some.
    #[must_use]
    pub fn new(max_payload_bytes: fn(u8) -> usize, evaluation: ChecksumEvaluation) -> Self {
        Self {
            buffer: Vec::new(),
            start: 0,
            max_payload_bytes,
            evaluation,
            opaque: OpaqueIds::Some(Vec::new()),
            has_short_announcements: false,
            boundary: Boundary::Anywhere,
            long: None,
            missed: MissedFastStop::new(evaluation),
            in_sync: true,
            counters: DecoderCounters::default(),
        }
    }

    /// Creates a decoder of requests, whose ids are all opaque. It keeps payloads of up to
    /// [`id::MAX_OPAQUE_BYTES`].
    #[must_use]
    pub fn of_requests(evaluation: ChecksumEvaluation) -> Self {
        Self { opaque: OpaqueIds::All, ..Self::new(id::max_request_bytes, evaluation) }
    }

    /// Accepts a Disconnect Announcement (07h) with a size field of one byte, which one existing client sends.
    #[must_use]
    pub fn with_short_announcements(self) -> Self {
        Self { has_short_announcements: true, ..self }
    }

    /// Names the opaque ids of the replies that can arrive now.
    pub fn expect_opaque(&mut self, ids: impl Iterator<Item = u8>) {
        if let OpaqueIds::Some(expected) = &mut self.opaque {
            expected.clear();
            expected.extend(ids);
        }
    }

    /// Appends received bytes. After each call, call [`Decoder::next`] until it returns `None`.
    pub fn push(&mut self, bytes: &[u8]) {
        self.buffer.drain(..self.start);
        self.start = 0;
        self.buffer.extend_from_slice(bytes);
        self.counters.bytes += bytes.len() as u64;
    }

    /// Notes that the sender has paused, so that its next byte can begin a frame. Call it before [`Decoder::push`].
    pub fn pause(&mut self) {
        if self.boundary == Boundary::Lost {
            self.boundary = Boundary::Here;
        }
    }

    /// Whether a frame can begin only behind a pause.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.boundary == Boundary::Lost
    }

    /// Lets the next frame begin anywhere.
    pub fn resynchronise(&mut self) {
        self.boundary = Boundary::Anywhere;
    }

    /// Returns the next finding in the pushed bytes, or `None` until more bytes arrive.
    #[allow(clippy::should_implement_trait, reason = "the result borrows from the decoder, unlike an Iterator's item")]
    pub fn next(&mut self) -> Option<Decoded<'_>> {
        let (id, payload, end) = loop {
            match self.candidate()? {
                Candidate::Oversized { id } => {
                    self.counters.oversized += 1;
                    self.discard(1);
                    if self.is_opaque(id) {
                        self.boundary = Boundary::Lost;
                    }
                }
                Candidate::FastStop => return Some(Decoded::MissedFastStop),
                Candidate::Long(long) => return Some(self.end_of_long_frame(&long)),
                Candidate::Complete { id, payload, end } => break (id, payload, end),
            }
        };
        if self.evaluation == ChecksumEvaluation::On && crc::checksum(&self.buffer[self.start..end]) != 0 {
            self.counters.checksum_errors += 1;
            if self.is_opaque(id) {
                self.drop_bytes(end - self.start);
                self.boundary = Boundary::Here;
            } else {
                self.discard(1);
            }
            return Some(Decoded::Damaged { id });
        }
        self.accept();
        self.start = end;
        Some(Decoded::Frame(Frame { id, payload: &self.buffer[payload] }))
    }

    /// Whether the start of a frame is waiting for its remaining bytes.
    #[must_use]
    pub fn is_partial(&self) -> bool {
        self.partial_bytes() > 0
    }

    /// Number of received bytes of a frame that is still incomplete.
    #[must_use]
    pub fn partial_bytes(&self) -> usize {
        self.buffer.len() - self.start + self.long.as_ref().map_or(0, |long| long.received_bytes)
    }

    /// Stream position in bytes of the first unclassified byte.
    #[must_use]
    pub fn position(&self) -> u64 {
        self.counters.bytes - self.partial_bytes() as u64
    }

    /// Gives up an incomplete frame whose remaining bytes did not arrive in time. Call [`Decoder::next`] afterwards,
    /// because a whole frame can follow a false start.
    pub fn give_up_partial(&mut self) {
        if !self.is_partial() {
            return;
        }
        self.counters.cut_short += 1;
        if let Some(long) = self.long.take() {
            self.count_skipped(long.received_bytes);
        } else if self.may_be_opaque() {
            self.drop_bytes(self.buffer.len() - self.start);
        } else {
            self.discard(1);
            return;
        }
        self.boundary = Boundary::Lost;
    }

    /// Current counter values.
    #[must_use]
    pub fn counters(&self) -> DecoderCounters {
        self.counters
    }

    /// Advances `start` to the next header whose frame is complete or oversized.
    fn candidate(&mut self) -> Option<Candidate> {
        if self.long.is_some() {
            return self.rest_of_long_frame();
        }
        loop {
            if self.missed.take() {
                return Some(Candidate::FastStop);
            }
            if self.boundary == Boundary::Lost {
                if self.start == self.buffer.len() {
                    return None;
                }
                self.drop_bytes(1);
                continue;
            }
            let rest = &self.buffer[self.start..];
            let matching = rest.iter().zip(PREAMBLE).take_while(|&(&byte, preamble)| byte == preamble).count();
            if matching < PREAMBLE.len() {
                if matching == rest.len() {
                    return None;
                }
                if self.boundary == Boundary::Here {
                    self.boundary = Boundary::Lost;
                } else {
                    self.discard(matching + 1);
                }
                continue;
            }
            let id = *rest.get(3)?;
            if id == PREAMBLE[0] {
                // A fourth AAh: an id AAh is indistinguishable from a run, whose last three bytes are the preamble.
                self.discard(1);
                continue;
            }
            let size = usize::from(u16::from_le_bytes([*rest.get(4)?, *rest.get(5)?]));
            if self.has_short_announcements && id == id::DISCONNECT_ANNOUNCEMENT && rest[4] == 0 && rest[5] != 0 {
                // The second byte of a regular size field is zero. Read as one, it would announce hundreds of bytes.
                let short = rest.get(..SHORT_ANNOUNCEMENT_BYTES)?;
                if self.evaluation == ChecksumEvaluation::Off || crc::checksum(short) == 0 {
                    let end = self.start + SHORT_ANNOUNCEMENT_BYTES;
                    return Some(Candidate::Complete { id, payload: end..end, end });
                }
            }
            if size > (self.max_payload_bytes)(id) {
                // Above a limit of the manual, the size field is damaged for certain.
                if !self.is_opaque(id) || (self.max_payload_bytes)(id) < id::MAX_OPAQUE_BYTES {
                    return Some(Candidate::Oversized { id });
                }
                self.long = Some(LongFrame { id, payload_bytes: size, received_bytes: 0, crc: crc::INITIAL });
                return self.rest_of_long_frame();
            }
            let payload = self.start + HEADER_BYTES..self.start + HEADER_BYTES + size;
            let end = self.start + size + OVERHEAD_BYTES;
            return (self.buffer.len() >= end).then_some(Candidate::Complete { id, payload, end });
        }
    }

    /// Checks further bytes of a long frame. Returns the frame once all have arrived.
    fn rest_of_long_frame(&mut self) -> Option<Candidate> {
        let long = self.long.as_mut()?;
        let available = long.missing_bytes().min(self.buffer.len() - self.start);
        let bytes = &self.buffer[self.start..self.start + available];
        long.crc = crc::update(long.crc, bytes);
        long.received_bytes += available;
        if matches!(self.opaque, OpaqueIds::All) {
            self.missed.look_at(bytes);
        }
        self.start += available;
        if long.missing_bytes() > 0 { None } else { self.long.take().map(Candidate::Long) }
    }

    fn end_of_long_frame(&mut self, long: &LongFrame) -> Decoded<'static> {
        if self.evaluation == ChecksumEvaluation::On && long.crc != 0 {
            self.counters.checksum_errors += 1;
            self.count_skipped(long.received_bytes);
            self.boundary = Boundary::Here;
            return Decoded::Damaged { id: long.id };
        }
        self.accept();
        Decoded::TooLong { id: long.id, payload_bytes: long.payload_bytes }
    }

    /// Notes a valid frame.
    fn accept(&mut self) {
        self.counters.frames += 1;
        self.boundary = Boundary::Anywhere;
        self.missed.clear();
        if !self.in_sync {
            self.in_sync = true;
            self.counters.resynchronisations += 1;
        }
    }

    fn is_opaque(&self, id: u8) -> bool {
        match &self.opaque {
            OpaqueIds::All => true,
            OpaqueIds::Some(ids) => ids.contains(&id),
        }
    }

    /// Whether the incomplete frame has an opaque id, which may not have arrived yet.
    fn may_be_opaque(&self) -> bool {
        match (self.buffer.get(self.start + PREAMBLE.len()), &self.opaque) {
            (Some(&id), _) => self.is_opaque(id),
            (None, OpaqueIds::All) => true,
            (None, OpaqueIds::Some(ids)) => !ids.is_empty(),
        }
    }

    /// Drops bytes of rejected frames of opaque ids.
    fn drop_bytes(&mut self, bytes: usize) {
        if matches!(self.opaque, OpaqueIds::All) {
            self.missed.look_at(&self.buffer[self.start..self.start + bytes]);
        }
        self.discard(bytes);
    }

    fn discard(&mut self, bytes: usize) {
        self.start += bytes;
        self.count_skipped(bytes);
    }

    fn count_skipped(&mut self, bytes: usize) {
        self.in_sync = false;
        self.counters.skipped_bytes += bytes as u64;
    }
}

#[cfg(test)]
#[path = "decoder_tests.rs"]
mod tests;
