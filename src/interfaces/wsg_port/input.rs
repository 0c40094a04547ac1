//! Parser of the requests in a client's bytes.

use std::time::{Duration, Instant};

use crate::wsg::id::{self, LengthRule};
use crate::wsg::timed_decoder::RESYNC_PAUSE;
use crate::wsg::{ChecksumEvaluation, Command, Decoded, Decoder, InvalidRequest, Status, TimedDecoder};

/// Time limit for the rest of a frame: longer than TCP takes to retransmit a lost segment.
const FRAME_WITHIN: Duration = Duration::from_millis(500);

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
    decoder: TimedDecoder,
    /// Damaged frames since the last good one.
    damaged: u32,
}

/// Consecutive damaged frames after which a client's bytes are no longer read.
const MAX_DAMAGED: u32 = 64;

impl PortInput {
    pub(super) fn new(evaluation: ChecksumEvaluation) -> Self {
        let decoder = Decoder::of_requests(evaluation).with_short_announcements();
        Self { decoder: TimedDecoder::new(decoder, FRAME_WITHIN, RESYNC_PAUSE), damaged: 0 }
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
        self.decoder.push(now, bytes);
    }

    pub(super) fn next(&mut self) -> Option<ReceivedRequest> {
        if self.is_garbage() {
            return None;
        }
        let decoded = self.decoder.next()?;
        self.damaged = if matches!(decoded, Decoded::Damaged { .. }) { self.damaged + 1 } else { 0 };
        Some(match decoded {
            Decoded::Frame(frame) => ReceivedRequest { id: frame.id, command: parse(frame.id, frame.payload) },
            Decoded::TooLong { id, payload_bytes } => {
                let command = Command::parse_too_long(id, payload_bytes).map_err(Unusable::from);
                ReceivedRequest { id, command }
            }
            Decoded::Damaged { id } => ReceivedRequest { id, command: Err(Unusable::Checksum) },
            Decoded::MissedFastStop => ReceivedRequest { id: id::FAST_STOP, command: Ok(Command::FastStop) },
        })
    }

    /// Drops an incomplete frame at the end of a datagram.
    pub(super) fn end_datagram(&mut self) {
        self.decoder.end_datagram();
    }

    /// Returns the time at which the rest of a frame counts as lost.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.decoder.deadline().filter(|_| !self.is_garbage())
    }

    /// Drops a frame whose rest is overdue.
    pub(super) fn handle_timeout(&mut self, now: Instant) {
        self.decoder.handle_timeout(now);
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

    /// Bytes of a move.
    fn motion() -> Vec<u8> {
        frame(id::PRE_POSITION, &[0; 9])
    }

    fn all(input: &mut PortInput) -> Vec<(u8, Result<Command, Unusable>)> {
        std::iter::from_fn(|| input.next()).map(|request| (request.id, request.command)).collect()
    }

    #[test]
    fn request_of_any_size_is_one_request() {
        let payload = [&[0; 10][..], &motion(), &frame(id::FAST_STOP, &[]), &[0; 5000]].concat();
        let cases = [
            (id::LOOP, Status::E_CMD_FORMAT_ERROR),
            (id::SET_DEVICE_TAG, Status::E_OVERRUN),
            (id::DISCONNECT_ANNOUNCEMENT, Status::E_NO_PARAM_EXPECTED),
            (id::PRE_POSITION, Status::E_CMD_FORMAT_ERROR),
            (0xB0, Status::E_OVERRUN),
        ];
        for (id, status) in cases {
            let bytes = [frame(id, &payload), frame(id::GET_SYSTEM_INFO, &[])].concat();
            for in_pieces_of in [1, 1000, bytes.len()] {
                let found = requests(ChecksumEvaluation::On, &bytes, in_pieces_of);
                assert_eq!(found.len(), 2, "{id:02X}h: {found:?}");
                assert_eq!((found[0].0, found[0].1.as_ref().unwrap_err().status()), (id, status));
                assert_eq!(found[1], (id::GET_SYSTEM_INFO, Ok(Command::GetSystemInfo)));
            }
        }
        let stop = requests(ChecksumEvaluation::On, &frame(id::FAST_STOP, &payload), 1000);
        assert_eq!(stop, [(id::FAST_STOP, Ok(Command::FastStop))]);
    }

    #[test]
    fn damaged_request_is_dropped_with_its_payload() {
        for behind in [0, 5000] {
            let mut bytes = frame(id::LOOP, &[&[0; 10][..], &motion(), &vec![0; behind]].concat());
            *bytes.last_mut().unwrap() ^= 1;
            bytes.extend(frame(id::GET_SYSTEM_INFO, &[]));
            let found = requests(ChecksumEvaluation::On, &bytes, 1000);
            let next = (id::GET_SYSTEM_INFO, Ok(Command::GetSystemInfo));
            assert_eq!(found, [(id::LOOP, Err(Unusable::Checksum)), next]);
        }
    }

    /// A client that pauses in a frame may send its rest later.
    #[test]
    fn request_given_up_is_dropped_with_its_payload() {
        for evaluation in [ChecksumEvaluation::On, ChecksumEvaluation::Off] {
            let bytes = frame(id::LOOP, &[&[0; 10][..], &motion(), &[0; 9], &motion(), &[0; 200]].concat());
            let mut input = PortInput::new(evaluation);
            let begin = Instant::now();
            input.push(begin, &bytes[..40]);
            assert_eq!(all(&mut input), []);
            assert_eq!(input.deadline(), Some(begin + FRAME_WITHIN));
            input.handle_timeout(begin + FRAME_WITHIN);
            assert_eq!((all(&mut input), input.deadline()), (vec![], None));
            input.push(begin + FRAME_WITHIN, &bytes[40..]);
            assert_eq!(all(&mut input), [], "the rest does not begin with a preamble");
            input.push(begin + FRAME_WITHIN + RESYNC_PAUSE, &frame(id::GET_SYSTEM_INFO, &[]));
            assert_eq!(all(&mut input), [(id::GET_SYSTEM_INFO, Ok(Command::GetSystemInfo))]);
        }
    }

    #[test]
    fn damaged_size_hides_no_fast_stop_for_long() {
        let fast_stop = (id::FAST_STOP, Ok(Command::FastStop));
        for id in [id::DISCONNECT_ANNOUNCEMENT, id::GET_SYSTEM_STATE, 0xB5] {
            let mut input = PortInput::new(ChecksumEvaluation::On);
            let begin = Instant::now();
            input.push(begin, &[0xAA, 0xAA, 0xAA, id, 0xFF, 0xFF]);
            let until = begin + FRAME_WITHIN;
            // Further requests do not extend the time.
            for n in 1..=5 {
                input.push(begin + n * FRAME_WITHIN / 6, &[frame(id::FAST_STOP, &[]), motion()].concat());
                assert_eq!(all(&mut input), []);
                assert_eq!(input.deadline(), Some(until));
            }
            input.handle_timeout(until);
            assert_eq!(all(&mut input), slice(&fast_stop), "one for all");
            assert_eq!(input.deadline(), None);
            input.push(until, &frame(id::FAST_STOP, &[]));
            assert_eq!(all(&mut input), slice(&fast_stop), "without a pause, too");
        }
    }

    /// Requests in a datagram.
    fn datagram(input: &mut PortInput, now: Instant, bytes: &[u8]) -> Vec<(u8, Result<Command, Unusable>)> {
        input.push(now, bytes);
        let mut found = all(input);
        input.end_datagram();
        found.extend(all(input));
        found
    }

    #[test]
    fn datagram_cut_short_hides_no_further_ones() {
        let mut input = PortInput::new(ChecksumEvaluation::On);
        let now = Instant::now();
        for id in [id::LOOP, id::GET_SYSTEM_STATE, 0xB5] {
            let long = frame(id, &[&[0; 10][..], &motion(), &[0; 200]].concat());
            for end in [4, 10, 100] {
                assert_eq!(datagram(&mut input, now, &long[..end]), [], "{id:02X}h cut at {end}");
                assert_eq!(input.deadline(), None);
                let next = datagram(&mut input, now, &frame(id::GET_SYSTEM_INFO, &[]));
                assert_eq!(next, [(id::GET_SYSTEM_INFO, Ok(Command::GetSystemInfo))], "{id:02X}h cut at {end}");
            }
        }
        let with_stop = [&frame(id::LOOP, &[0; 99])[..40], &frame(id::FAST_STOP, &[])].concat();
        let found = datagram(&mut input, now, &with_stop);
        assert_eq!(found, [(id::FAST_STOP, Ok(Command::FastStop))], "a stop too many does less harm");
    }

    fn slice<T>(one: &T) -> &[T] {
        std::slice::from_ref(one)
    }

    #[test]
    fn garbage_is_bounded() {
        let mut input = PortInput::new(ChecksumEvaluation::On);
        let damaged = [0xAA, 0xAA, 0xAA, 0xB5, 0, 0, 0, 0];
        input.push(Instant::now(), &damaged.repeat(4000));
        let damaged = std::iter::from_fn(|| input.next()).count();
        assert_eq!(damaged, MAX_DAMAGED as usize);
        assert!(input.is_garbage());
        assert_eq!(input.deadline(), None);
    }
}
