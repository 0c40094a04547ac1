//! A measured value: what a getter of the device last returned, when its frame arrived, and how long it stays good.

use std::fmt;
use std::time::{Duration, Instant};

use wsg::Status;

/// A value of the device. It counts as known until its renewals fail to arrive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured<T> {
    /// The newest value with the time at which its frame arrived, whatever its age.
    newest: Option<(Instant, T)>,
    standing: Standing,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Standing {
    /// The device is not expected to report the value, for example an opening width before homing.
    NotExpected,
    /// The first value has to arrive before this time.
    Awaited(Instant),
    /// The value is good until this time.
    Known(Instant),
    Missing(Missing),
}

/// Reason that a value is not known, although the device should report it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Missing {
    /// No frame has renewed the value in time.
    Silent,
    /// The getter was answered with an error status.
    Refused(Status),
    /// The device sent a number that no gripper can have.
    Impossible,
    /// A reply of the getter could not be read.
    Unreadable,
}

impl fmt::Display for Missing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silent => f.write_str("not sent by the device"),
            Self::Refused(status) => write!(f, "the device answers {status} ({})", status.code()),
            Self::Impossible => f.write_str("the device sends a number that no gripper can have"),
            Self::Unreadable => f.write_str("the device sends a reply that cannot be read"),
        }
    }
}

impl<T> Default for Measured<T> {
    fn default() -> Self {
        Self { newest: None, standing: Standing::NotExpected }
    }
}

impl<T: Copy + PartialEq> Measured<T> {
    /// The value, unless it is unknown at `now`.
    #[must_use]
    pub fn at(&self, now: Instant) -> Option<T> {
        match self.standing {
            Standing::Known(until) if now < until => self.last(),
            _ => None,
        }
    }

    /// The newest value, however old it is. Only for comparison with the next one, and for decisions that are on the
    /// safe side with an old value: it is never shown.
    #[must_use]
    pub fn last(&self) -> Option<T> {
        self.newest.map(|(_, value)| value)
    }

    /// Time at which the frame of the newest value arrived.
    #[must_use]
    pub fn arrived_at(&self) -> Option<Instant> {
        self.newest.map(|(arrived_at, _)| arrived_at)
    }

    /// Reason that the value is not known at `now`, although it should be.
    #[must_use]
    pub fn missing(&self, now: Instant) -> Option<Missing> {
        match self.standing {
            Standing::Awaited(until) | Standing::Known(until) if until <= now => Some(Missing::Silent),
            Standing::Missing(missing) => Some(missing),
            _ => None,
        }
    }

    /// Whether the device is expected to report the value.
    #[must_use]
    pub fn is_expected(&self) -> bool {
        self.standing != Standing::NotExpected
    }

    /// Time at which the value becomes unknown without a further frame.
    #[must_use]
    pub fn ends_at(&self) -> Option<Instant> {
        match self.standing {
            Standing::Awaited(until) | Standing::Known(until) => Some(until),
            Standing::NotExpected | Standing::Missing(_) => None,
        }
    }

    /// Whether both say the same. Their times can differ.
    #[must_use]
    pub fn is_like(&self, other: &Self) -> bool {
        match (self.standing, other.standing) {
            (Standing::Known(_), Standing::Known(_)) => self.last() == other.last(),
            (Standing::Missing(one), Standing::Missing(other)) => one == other,
            (Standing::Known(_) | Standing::Missing(_), _) | (_, Standing::Known(_) | Standing::Missing(_)) => false,
            _ => true,
        }
    }

    /// Takes a value whose frame arrived at `arrived_at`.
    pub fn take(&mut self, arrived_at: Instant, value: T, good_for: Duration) {
        self.newest = Some((arrived_at, value));
        self.standing = Standing::Known(arrived_at + good_for);
    }

    /// Notes that the device should report the value from now on: the first one before `until`. A missing value stays
    /// missing until it arrives.
    pub fn expect(&mut self, until: Instant) {
        if !matches!(self.standing, Standing::Known(_) | Standing::Missing(_)) {
            self.standing = Standing::Awaited(until);
        }
    }

    /// Notes that the device reports something else instead of the value.
    pub fn lose(&mut self, missing: Missing) {
        if self.is_expected() {
            self.standing = Standing::Missing(missing);
        }
    }

    /// Notes that the device is not expected to report the value any more.
    pub fn forget(&mut self) {
        self.standing = Standing::NotExpected;
    }

    /// Marks the value as missing if it has not been renewed in time.
    pub fn expire(&mut self, now: Instant) {
        if let Some(missing) = self.missing(now) {
            self.standing = Standing::Missing(missing);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD_FOR: Duration = Duration::from_millis(500);

    #[test]
    fn value_is_known_until_its_renewal_is_overdue() {
        let mut width: Measured<f32> = Measured::default();
        let start = Instant::now();
        assert_eq!((width.at(start), width.missing(start)), (None, None));
        width.take(start, 80.0, GOOD_FOR);
        assert_eq!(width.at(start + GOOD_FOR / 2), Some(80.0));
        let overdue = start + GOOD_FOR;
        assert_eq!(width.at(overdue), None, "also before anybody calls `expire`");
        assert_eq!(width.missing(overdue), Some(Missing::Silent));
        let shown = width;
        width.expire(overdue);
        assert!(!width.is_like(&shown), "a state without the value is a new state");
        assert_eq!((width.at(start), width.last(), width.ends_at()), (None, Some(80.0), None));
        width.take(overdue, 12.0, GOOD_FOR);
        assert_eq!(width.at(overdue), Some(12.0));
    }

    #[test]
    fn error_ends_a_value_at_once() {
        let mut force: Measured<f32> = Measured::default();
        let now = Instant::now();
        force.lose(Missing::Impossible);
        assert_eq!(force.missing(now), None, "not expected yet");
        force.expect(now + GOOD_FOR);
        assert_eq!((force.at(now), force.missing(now)), (None, None));
        assert_eq!(force.missing(now + GOOD_FOR), Some(Missing::Silent));
        force.take(now, 3.0, GOOD_FOR);
        force.lose(Missing::Impossible);
        assert_eq!((force.at(now), force.missing(now)), (None, Some(Missing::Impossible)));
        force.forget();
        assert_eq!((force.at(now), force.missing(now)), (None, None));
    }
}
