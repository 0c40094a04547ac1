//! Queues of unwritten requests: FAST STOP first, then Stop, then all others, in order within an id.

use std::collections::VecDeque;
use std::time::Instant;

use super::{NotTaken, Request, Token};
use crate::{Command, id};

/// Limit of waiting requests per lane, besides motions and their forces. The gateway uses a few dozen ids with one
/// request in flight each. Only a caller that does not wait for replies exceeds the limit.
pub const MAX_WAITING: usize = 64;

/// Limit of waiting requests of one id, other than Stops and FAST STOPs. It keeps many requests of one kind from
/// causing others to be refused.
pub const MAX_WAITING_PER_ID: usize = 16;

/// A request that has not been written yet.
#[derive(Debug)]
pub(super) struct Waiting {
    pub token: Token,
    pub request: Request,
    /// Time at which the request is given up unwritten.
    pub deadline: Instant,
}

impl Waiting {
    fn id(&self) -> u8 {
        self.request.command.id()
    }
}

#[derive(Debug, Default)]
pub(super) struct Lanes {
    fast_stop: VecDeque<Waiting>,
    stop: VecDeque<Waiting>,
    rest: VecDeque<Waiting>,
}

impl Lanes {
    /// Queues a request.
    ///
    /// # Errors
    /// [`NotTaken::Full`] if too many requests are waiting.
    pub(super) fn push(&mut self, waiting: Waiting) -> Result<(), NotTaken> {
        let id = waiting.request.command.id();
        let (lane, per_id) = match waiting.request.command {
            Command::FastStop => (&mut self.fast_stop, MAX_WAITING),
            Command::Stop => (&mut self.stop, MAX_WAITING),
            _ => (&mut self.rest, MAX_WAITING_PER_ID),
        };
        if !belongs_to_motion(id) && lane.iter().filter(|other| !belongs_to_motion(other.id())).count() >= MAX_WAITING {
            return Err(NotTaken::Full { limit: MAX_WAITING });
        }
        if lane.iter().filter(|other| other.id() == id).count() >= per_id {
            return Err(NotTaken::Full { limit: per_id });
        }
        lane.push_back(waiting);
        Ok(())
    }

    /// Removes the next FAST STOP or Stop that may be written now.
    pub(super) fn pop_urgent(&mut self, is_open: impl Fn(&Waiting) -> bool) -> Option<Waiting> {
        pop_open(&mut self.fast_stop, &is_open).or_else(|| pop_open(&mut self.stop, &is_open))
    }

    /// Removes the next other request that may be written now. Requests of different ids can overtake each other.
    pub(super) fn pop_rest(&mut self, is_open: impl Fn(&Waiting) -> bool) -> Option<Waiting> {
        pop_open(&mut self.rest, &is_open)
    }

    /// Removes an unwritten request. Returns whether there was one.
    pub(super) fn withdraw(&mut self, token: Token) -> bool {
        let lanes = [&mut self.fast_stop, &mut self.stop, &mut self.rest];
        lanes.into_iter().any(|lane| {
            let before = lane.len();
            lane.retain(|waiting| waiting.token != token);
            lane.len() < before
        })
    }

    /// Removes one request whose deadline has passed.
    pub(super) fn pop_expired(&mut self, now: Instant) -> Option<Waiting> {
        let lanes = [&mut self.fast_stop, &mut self.stop, &mut self.rest];
        lanes.into_iter().find_map(|lane| {
            let index = lane.iter().position(|waiting| waiting.deadline <= now)?;
            lane.remove(index)
        })
    }

    pub(super) fn next_deadline(&self) -> Option<Instant> {
        let lanes = [&self.fast_stop, &self.stop, &self.rest];
        lanes.into_iter().flatten().map(|waiting| waiting.deadline).min()
    }

    /// The oldest waiting Stop.
    pub(super) fn first_stop(&self) -> Option<Token> {
        self.stop.front().map(|waiting| waiting.token)
    }

    pub(super) fn has_waiting(&self, id: u8) -> bool {
        [&self.fast_stop, &self.stop, &self.rest].into_iter().flatten().any(|waiting| waiting.id() == id)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.fast_stop.is_empty() && self.stop.is_empty() && self.rest.is_empty()
    }
}

/// Whether a request is a motion, or sets the force of one.
fn belongs_to_motion(id: u8) -> bool {
    id::is_motion(id) || id == id::SET_FORCE_LIMIT
}

fn pop_open(lane: &mut VecDeque<Waiting>, is_open: impl Fn(&Waiting) -> bool) -> Option<Waiting> {
    // A request that is held back for its line time also holds back later ones of its id.
    let index = lane.iter().enumerate().position(|(index, waiting)| {
        is_open(waiting) && lane.iter().take(index).all(|before| before.id() != waiting.id())
    })?;
    lane.remove(index)
}
