//! The requests in a client's bytes.

use std::time::{Duration, Instant};

use crate::wsg::id::{self, Parameters};
use crate::wsg::{ChecksumEvaluation, Command, Decoded, Decoder, InvalidRequest, Status};

/// How long the rest of a frame is waited for: longer than a lost segment takes to be repeated.
const PARTIAL_WITHIN: Duration = Duration::from_millis(500);

/// How a 07h begins whose size field has one byte: what follows are the two bytes of its checksum. Read as a whole
/// frame it would announce hundreds of parameter bytes.
const SHORT_ANNOUNCEMENT: [u8; 5] = [0xAA, 0xAA, 0xAA, id::DISCONNECT_ANNOUNCEMENT, 0];

/// The same, with its checksum.
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
}

impl Input {
    pub(super) fn new(evaluation: ChecksumEvaluation) -> Self {
        Self { decoder: Decoder::new(max_request_bytes, evaluation), evaluation, partial_until: None }
    }

    /// Takes bytes. Call [`Input::next`] until it returns `None` afterwards.
    pub(super) fn push(&mut self, now: Instant, bytes: &[u8]) {
        self.decoder.push(bytes);
        self.partial_until = Some(now + PARTIAL_WITHIN);
    }

    pub(super) fn next(&mut self) -> Option<Request> {
        let Some(decoded) = self.decoder.next() else {
            self.partial_until = self.partial_until.filter(|_| self.decoder.is_partial());
            return self.short_announcement();
        };
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

    /// One client writes 07h so. Not to understand it would stop the gripper when that client leaves.
    fn short_announcement(&mut self) -> Option<Request> {
        let rest = self.decoder.partial();
        // A zero is the second byte of a whole size field.
        let is_short = rest.starts_with(&SHORT_ANNOUNCEMENT) && rest.get(SHORT_ANNOUNCEMENT.len()) != Some(&0);
        if !is_short || rest.len() < SHORT_ANNOUNCEMENT_BYTES {
            return None;
        }
        *self = Self::new(self.evaluation);
        Some(Request { id: id::DISCONNECT_ANNOUNCEMENT, command: Ok(Command::DisconnectAnnouncement) })
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

/// A 07h is read on, however long it says it is: it may be a [`SHORT_ANNOUNCEMENT`].
fn max_request_bytes(id: u8) -> usize {
    if id == id::DISCONNECT_ANNOUNCEMENT { u16::MAX.into() } else { id::max_request_bytes(id) }
}
