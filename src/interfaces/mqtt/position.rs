//! Positions in the journal: what was published, and since when a broker has kept it.
//!
//! A broker that is killed can lose messages that it has acknowledged. A record therefore counts as delivered only once
//! the connection has outlasted its PUBACK by [`SETTLED_AFTER`]. After the loss of a connection, and after a kill of the
//! gateway, the records since then are published again.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

/// Time after its PUBACK in which a record is published again if the connection is lost.
const SETTLED_AFTER: Duration = Duration::from_secs(10);

/// Interval of the positions that are kept for this, so that there are few of them.
const NOTED_EVERY: Duration = Duration::from_secs(1);

/// List of the journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PublishedList {
    Events,
    Grips,
}

/// Sequence number of the newest event and of the newest grip record that were published.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Position {
    pub(super) events: i64,
    pub(super) grips: i64,
}

/// Position as it outlives a restart. A list that was not published has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(super) struct StoredPosition {
    pub(super) events: Option<i64>,
    pub(super) grips: Option<i64>,
}

impl StoredPosition {
    /// Returns the position, with that of `newest` for each list that has none.
    pub(super) fn or(self, newest: Position) -> Position {
        Position { events: self.events.unwrap_or(newest.events), grips: self.grips.unwrap_or(newest.grips) }
    }
}

/// Completes the records of a list up to a sequence number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct RecordStep {
    pub(super) chain: PublishedList,
    pub(super) seq: i64,
}

impl Position {
    pub(super) fn advance(&mut self, step: RecordStep) {
        let position = match step.chain {
            PublishedList::Events => &mut self.events,
            PublishedList::Grips => &mut self.grips,
        };
        *position = step.seq;
    }
}

/// Progress through the journal.
#[derive(Debug)]
pub(super) struct PublishedProgress {
    pub(super) acknowledged: Position,
    settled: Position,
    /// Earlier values of `acknowledged` with their times, oldest first.
    noted: VecDeque<(Instant, Position)>,
}

impl PublishedProgress {
    pub(super) fn at(position: Position) -> Self {
        Self { acknowledged: position, settled: position, noted: VecDeque::new() }
    }

    /// Notes the present position, and returns the one at which a new connection would begin.
    pub(super) fn settle(&mut self, now: Instant) -> Position {
        let is_due = self.noted.back().is_none_or(|(at, _)| now.saturating_duration_since(*at) >= NOTED_EVERY);
        if is_due {
            self.noted.push_back((now, self.acknowledged));
        }
        while let Some((_, position)) =
            self.noted.pop_front_if(|(at, _)| now.saturating_duration_since(*at) >= SETTLED_AFTER)
        {
            self.settled = position;
        }
        self.settled
    }

    /// Goes back to the records that a broker could have lost, and returns their position.
    pub(super) fn go_back(&mut self) -> Position {
        *self = Self::at(self.settled);
        self.settled
    }

    /// Ends with the connection in good order: all acknowledged records count as delivered.
    pub(super) fn end(&mut self) -> Position {
        *self = Self::at(self.acknowledged);
        self.settled
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_before_a_lost_connection_are_published_again() {
        let begin = Instant::now();
        let mut progress = PublishedProgress::at(Position::default());
        let mut settled = Vec::new();
        for second in 0..15 {
            progress.acknowledged = Position { events: second + 1, grips: 0 };
            settled.push(progress.settle(begin + Duration::from_secs(second.unsigned_abs())).events);
        }
        assert_eq!(settled, [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5]);
        assert!(progress.noted.len() <= 10);
        assert_eq!(progress.go_back().events, 5);
        assert_eq!(progress.settle(begin + Duration::from_mins(1)).events, 5);
    }

    #[test]
    fn list_without_a_position_begins_with_its_newest_records() {
        let newest = Position { events: 50, grips: 20 };
        let stored: StoredPosition = serde_json::from_str(r#"{"events":7,"grips":null}"#).unwrap();
        assert_eq!(stored.or(newest), Position { events: 7, grips: 20 });
    }

    #[test]
    fn orderly_end_repeats_nothing() {
        let mut progress = PublishedProgress::at(Position::default());
        progress.acknowledged = Position { events: 9, grips: 4 };
        progress.settle(Instant::now());
        assert_eq!(progress.end(), Position { events: 9, grips: 4 });
    }
}
