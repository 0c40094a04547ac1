//! The requests in a client's bytes.

use std::time::{Duration, Instant};

use crate::wsg::crc;
use crate::wsg::id::{self, Parameters};
use crate::wsg::{ChecksumEvaluation, Command, Decoded, Decoder, InvalidRequest, Status};

/// How long the rest of a frame is waited for: longer than a lost segment takes to be repeated.
const PARTIAL_WITHIN: Duration = Duration::from_millis(500);

/// How a 07h begins.
const ANNOUNCEMENT: [u8; 4] = [0xAA, 0xAA, 0xAA, id::DISCONNECT_ANNOUNCEMENT];

/// A 07h whose size field has one byte, with its checksum. Read as a whole frame it would announce hundreds of
/// parameter bytes, and swallow what comes behind it.
const SHORT_ANNOUNCEMENT_BYTES: usize = 7;

/// A request as it came.
#[derive(Debug)]
pub(super) struct Request {
    pub id: u8,
    /// What it asks for, or a device's answer to it as it is.
    pub command: Result<Command, Status>,
}

#[derive(Debug)]
pub(super) struct Input {
    decoder: Decoder,
    evaluation: ChecksumEvaluation,
    partial_until: Option<Instant>,
    /// Damaged frames since the last good one.
    damaged: u32,
}

/// Damaged frames in a row after which a client's bytes are not read any more. Each may cost the checksum of 4 KiB.
const MAX_DAMAGED: u32 = 64;

impl Input {
    pub(super) fn new(evaluation: ChecksumEvaluation) -> Self {
        Self { decoder: Decoder::new(max_request_bytes, evaluation), evaluation, partial_until: None, damaged: 0 }
    }

    /// Whether the bytes make so little sense that no more are read.
    pub(super) fn is_garbage(&self) -> bool {
        self.damaged >= MAX_DAMAGED
    }

    /// Takes bytes. Call [`Input::next`] until it returns `None` afterwards.
    pub(super) fn push(&mut self, now: Instant, bytes: &[u8]) {
        if self.is_garbage() {
            return;
        }
        self.decoder.push(bytes);
        self.partial_until = Some(now + PARTIAL_WITHIN);
    }

    pub(super) fn next(&mut self) -> Option<Request> {
        if self.is_garbage() {
            return None;
        }
        if let Some(announcement) = self.short_announcement() {
            return Some(announcement);
        }
        let Some(decoded) = self.decoder.next() else {
            self.partial_until = self.partial_until.filter(|_| self.decoder.is_partial());
            // It may stand behind garbage.
            return self.short_announcement();
        };
        self.damaged = if matches!(decoded, Decoded::Damaged { .. }) { self.damaged + 1 } else { 0 };
        Some(match decoded {
            Decoded::Frame(frame) => Request { id: frame.id, command: parse(frame.id, frame.payload) },
            Decoded::Damaged { id } => Request { id, command: Err(Status::E_CHECKSUM_ERROR) },
        })
    }

    /// When the rest of a frame counts as lost.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.partial_until
    }

    /// Gives up a frame whose rest is overdue.
    pub(super) fn handle_timeout(&mut self, now: Instant) {
        if self.partial_until.is_some_and(|until| until <= now) {
            self.partial_until = Some(now + PARTIAL_WITHIN);
            self.decoder.give_up_partial();
        }
    }

    /// One client writes 07h so. Not to understand it would stop the gripper when that client leaves. What looks like
    /// one and isn't is damaged, and a FAST STOP behind it doesn't wait for its rest.
    fn short_announcement(&mut self) -> Option<Request> {
        let waiting = self.decoder.partial();
        let short = waiting.get(..SHORT_ANNOUNCEMENT_BYTES).filter(|short| short.starts_with(&ANNOUNCEMENT))?;
        // The second byte of a size field is a zero.
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
            Err(Status::E_CHECKSUM_ERROR)
        };
        Some(Request { id: id::DISCONNECT_ANNOUNCEMENT, command })
    }
}

/// Some ask for a state without the three bytes that the manual wants, and mean zeros.
fn parse(id: u8, payload: &[u8]) -> Result<Command, Status> {
    let zeros = [0; 3];
    let payload = match id::describe(id).map(|description| description.parameters) {
        Some(Parameters::Exactly(bytes)) if payload.is_empty() && is_query(id) => zeros.get(..bytes).unwrap_or(payload),
        _ => payload,
    };
    Command::parse(id, payload).map_err(InvalidRequest::status)
}

fn is_query(id: u8) -> bool {
    id::has_updates(id) || id == id::GET_STATISTICS
}

/// A 07h is read on, however long it says it is: it may be one with a short size field.
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
    ) -> Vec<(u8, Result<Command, Status>)> {
        let mut input = Input::new(evaluation);
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
    fn a_fast_stop_behind_a_short_announcement_is_found() {
        let announced = (id::DISCONNECT_ANNOUNCEMENT, Ok(Command::DisconnectAnnouncement));
        let damaged = (id::DISCONNECT_ANNOUNCEMENT, Err(Status::E_CHECKSUM_ERROR));
        let fast_stop = (id::FAST_STOP, Ok(Command::FastStop));
        let mut wrong = SHORT;
        wrong[5..].copy_from_slice(&[0x01, 0x22]);
        let (on, off) = (ChecksumEvaluation::On, ChecksumEvaluation::Off);
        for (evaluation, short, expected) in
            [(on, SHORT, &announced), (off, SHORT, &announced), (off, wrong, &announced), (on, wrong, &damaged)]
        {
            // With so much behind it, that it could be a whole frame.
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
    fn an_impossible_size_of_an_announcement_swallows_nothing() {
        let bytes = [&[0xAA, 0xAA, 0xAA, 0x07, 0xFF, 0xFF][..], &frame(id::FAST_STOP, &[])].concat();
        let found = requests(ChecksumEvaluation::On, &bytes, bytes.len());
        assert_eq!(found.last(), Some(&(id::FAST_STOP, Ok(Command::FastStop))));
    }

    #[test]
    fn garbage_is_read_within_a_bound() {
        let mut input = Input::new(ChecksumEvaluation::On);
        let header = [0xAA, 0xAA, 0xAA, 0xB5, 0x00, 0x10];
        input.push(Instant::now(), &header.repeat(4000));
        let damaged = std::iter::from_fn(|| input.next()).count();
        assert_eq!(damaged, MAX_DAMAGED as usize);
        assert!(input.is_garbage());
    }
}
