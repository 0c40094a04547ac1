//! Parser of the requests in a client's bytes.

use std::time::{Duration, Instant};

use crate::wsg::crc;
use crate::wsg::id::{self, LengthRule};
use crate::wsg::{ChecksumEvaluation, Command, Decoded, Decoder, InvalidRequest, Status};

/// Time limit for the rest of a frame: longer than TCP takes to retransmit a lost segment.
const PARTIAL_WITHIN: Duration = Duration::from_millis(500);

/// First bytes of a 07h.
const ANNOUNCEMENT: [u8; 4] = [0xAA, 0xAA, 0xAA, id::DISCONNECT_ANNOUNCEMENT];

/// Length of a 07h with a one-byte size field, checksum included. Parsed as a regular frame, it would announce hundreds
/// of parameter bytes and swallow the following frames.
const SHORT_ANNOUNCEMENT_BYTES: usize = 7;

/// A request as received.
#[derive(Debug)]
pub(super) struct ReceivedRequest {
    pub id: u8,
    pub command: Result<Command, Unusable>,
}

/// Reason that a request is refused before it reaches the gripper.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub(super) enum Unusable {
    #[error("frame damaged: its checksum is wrong")]
    Checksum,
    #[error(transparent)]
    Invalid(#[from] InvalidRequest),
    #[error("motion withdrawn by a Stop or a FAST STOP")]
    Withdrawn,
}

impl Unusable {
    /// Status with which a device would refuse the request.
    pub(super) const fn status(self) -> Status {
        match self {
            Self::Checksum => Status::E_CHECKSUM_ERROR,
            Self::Invalid(invalid) => invalid.status(),
            Self::Withdrawn => Status::E_CMD_ABORTED,
        }
    }
}

#[derive(Debug)]
pub(super) struct PortInput {
    decoder: Decoder,
    evaluation: ChecksumEvaluation,
    /// Time of the newest bytes, or of the last time-out.
    heard: Option<Instant>,
    /// Position of an incomplete frame, and the time limit for its rest. Further bytes do not extend it: a damaged size
    /// field must not hide the FAST STOPs behind it for long.
    partial: Option<(u64, Instant)>,
    /// Damaged frames since the last good one.
    damaged: u32,
}

/// Consecutive damaged frames after which a client's bytes are no longer read. Each can cost a checksum over 4 KiB.
const MAX_DAMAGED: u32 = 64;

impl PortInput {
    pub(super) fn new(evaluation: ChecksumEvaluation) -> Self {
        Self {
            decoder: Decoder::new(max_request_bytes, evaluation),
            evaluation,
            heard: None,
            partial: None,
            damaged: 0,
        }
    }

    /// Whether too many consecutive frames were damaged, so that no more bytes are read.
    pub(super) fn is_garbage(&self) -> bool {
        self.damaged >= MAX_DAMAGED
    }

    /// Takes bytes. Call [`PortInput::next`] until it returns `None` afterwards.
    pub(super) fn push(&mut self, now: Instant, bytes: &[u8]) {
        if self.is_garbage() {
            return;
        }
        self.decoder.push(bytes);
        self.heard = Some(now);
    }

    pub(super) fn next(&mut self) -> Option<ReceivedRequest> {
        if self.is_garbage() {
            return None;
        }
        if let Some(announcement) = self.short_announcement() {
            return Some(announcement);
        }
        let Some(decoded) = self.decoder.next() else {
            self.watch_partial();
            // A short announcement can follow garbage.
            return self.short_announcement();
        };
        self.damaged = if matches!(decoded, Decoded::Damaged { .. }) { self.damaged + 1 } else { 0 };
        Some(match decoded {
            Decoded::Frame(frame) => ReceivedRequest { id: frame.id, command: parse(frame.id, frame.payload) },
            Decoded::Damaged { id } => ReceivedRequest { id, command: Err(Unusable::Checksum) },
        })
    }

    /// Returns the time at which the rest of a frame counts as lost.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.partial.map(|(_, until)| until).filter(|_| !self.is_garbage())
    }

    fn watch_partial(&mut self) {
        let position = self.decoder.position();
        self.partial = match self.partial {
            _ if !self.decoder.is_partial() => None,
            Some((same, until)) if same == position => Some((same, until)),
            _ => self.heard.map(|heard| (position, heard + PARTIAL_WITHIN)),
        };
    }

    /// Discards a frame whose rest is overdue.
    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if self.partial.is_some_and(|(_, until)| until <= now) {
            self.heard = Some(now);
            self.decoder.give_up_partial();
        }
    }

    /// Returns a 07h with a one-byte size field, which one existing client sends. If it were not understood, the
    /// gripper would stop when that client disconnects. A frame that only looks like one counts as damaged, so that a
    /// FAST STOP behind it does not wait for its rest.
    fn short_announcement(&mut self) -> Option<ReceivedRequest> {
        let waiting = self.decoder.partial();
        let short = waiting.get(..SHORT_ANNOUNCEMENT_BYTES).filter(|short| short.starts_with(&ANNOUNCEMENT))?;
        // The second byte of a regular size field is zero.
        let (size, begins_checksum) = (short.get(4)?, short.get(5)? != &0);
        if !begins_checksum {
            return None;
        }
        let is_valid = self.evaluation == ChecksumEvaluation::Off || crc::checksum(short) == 0;
        let command = if *size == 0 && is_valid {
            let behind = waiting.get(SHORT_ANNOUNCEMENT_BYTES..).unwrap_or_default().to_vec();
            self.decoder = Decoder::new(max_request_bytes, self.evaluation);
            self.decoder.push(&behind);
            Ok(Command::DisconnectAnnouncement)
        } else {
            self.decoder.give_up_partial();
            Err(Unusable::Checksum)
        };
        Some(ReceivedRequest { id: id::DISCONNECT_ANNOUNCEMENT, command })
    }
}

/// Parses a command. Some clients omit the three parameter bytes of a state query, which then count as zeros.
fn parse(id: u8, payload: &[u8]) -> Result<Command, Unusable> {
    let zeros = [0; 3];
    let payload = match id::describe(id).map(|description| description.parameters) {
        Some(LengthRule::Exactly(bytes)) if payload.is_empty() && is_query(id) => zeros.get(..bytes).unwrap_or(payload),
        _ => payload,
    };
    Ok(Command::parse(id, payload)?)
}

fn is_query(id: u8) -> bool {
    id::has_updates(id) || id == id::GET_STATISTICS
}

/// Returns the maximum size of a request. A 07h can have any announced size, since its size field can be short.
fn max_request_bytes(id: u8) -> usize {
    if id == id::DISCONNECT_ANNOUNCEMENT { u16::MAX.into() } else { id::max_request_bytes(id) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: [u8; 7] = [0xAA, 0xAA, 0xAA, 0x07, 0x00, 0x62, 0xD1];

    fn requests(
        evaluation: ChecksumEvaluation,
        bytes: &[u8],
        in_pieces_of: usize,
    ) -> Vec<(u8, Result<Command, Unusable>)> {
        let mut input = PortInput::new(evaluation);
        let mut requests = Vec::new();
        for piece in bytes.chunks(in_pieces_of) {
            input.push(Instant::now(), piece);
            requests.extend(std::iter::from_fn(|| input.next()).map(|request| (request.id, request.command)));
        }
        requests
    }

    fn frame(id: u8, payload: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        crate::wsg::frame::encode(id, payload, &mut bytes);
        bytes
    }

    #[test]
    fn fast_stop_after_short_announcement_is_found() {
        let announced = (id::DISCONNECT_ANNOUNCEMENT, Ok(Command::DisconnectAnnouncement));
        let damaged = (id::DISCONNECT_ANNOUNCEMENT, Err(Unusable::Checksum));
        let fast_stop = (id::FAST_STOP, Ok(Command::FastStop));
        let mut wrong = SHORT;
        wrong[5..].copy_from_slice(&[0x01, 0x22]);
        let (on, off) = (ChecksumEvaluation::On, ChecksumEvaluation::Off);
        for (evaluation, short, expected) in
            [(on, SHORT, &announced), (off, SHORT, &announced), (off, wrong, &announced), (on, wrong, &damaged)]
        {
            // Enough bytes follow to complete the frame that the size field would announce.
            let bytes = [&short[..], &frame(id::FAST_STOP, &[]), &[0; 300]].concat();
            for in_pieces_of in [1, 5, 8, bytes.len()] {
                let found = requests(evaluation, &bytes, in_pieces_of);
                assert_eq!(found, [expected.clone(), fast_stop.clone()], "{evaluation:?} {short:x?} {in_pieces_of}");
            }
        }
        let behind_garbage = [&[0x00, 0xAA, 0x01][..], &SHORT, &frame(id::FAST_STOP, &[])].concat();
        assert_eq!(requests(on, &behind_garbage, 4), [announced.clone(), fast_stop.clone()]);
        let whole = [frame(id::DISCONNECT_ANNOUNCEMENT, &[]), frame(id::FAST_STOP, &[])].concat();
        assert_eq!(requests(on, &whole, whole.len()), [announced, fast_stop]);
    }

    #[test]
    fn announcement_with_impossible_size_swallows_nothing() {
        let bytes = [&[0xAA, 0xAA, 0xAA, 0x07, 0xFF, 0xFF][..], &frame(id::FAST_STOP, &[])].concat();
        let found = requests(ChecksumEvaluation::On, &bytes, bytes.len());
        assert_eq!(found.last(), Some(&(id::FAST_STOP, Ok(Command::FastStop))));
    }

    #[test]
    fn further_requests_do_not_extend_the_wait_for_a_damaged_frame() {
        let mut input = PortInput::new(ChecksumEvaluation::On);
        let begin = Instant::now();
        // Announces more bytes than follow.
        input.push(begin, &[0xAA, 0xAA, 0xAA, 0xB5, 0x00, 0x10]);
        assert!(input.next().is_none());
        let until = begin + PARTIAL_WITHIN;
        for n in 1..=5 {
            input.push(begin + n * PARTIAL_WITHIN / 6, &frame(id::FAST_STOP, &[]));
            assert!(input.next().is_none());
            assert_eq!(input.deadline(), Some(until));
        }
        input.handle_timeout(until);
        let found = std::iter::from_fn(|| input.next()).map(|request| request.id).collect::<Vec<_>>();
        assert_eq!((found, input.deadline()), (vec![id::FAST_STOP; 5], None));
    }

    #[test]
    fn garbage_is_bounded() {
        let mut input = PortInput::new(ChecksumEvaluation::On);
        let header = [0xAA, 0xAA, 0xAA, 0xB5, 0x00, 0x10];
        input.push(Instant::now(), &header.repeat(4000));
        let damaged = std::iter::from_fn(|| input.next()).count();
        assert_eq!(damaged, MAX_DAMAGED as usize);
        assert!(input.is_garbage());
        assert_eq!(input.deadline(), None);
    }
}
