//! Automatic updates (`fw4-en 3.4.1` to `3.4.6`): by period, or on change with the period as the shortest interval.

use std::time::{Duration, Instant};

use super::{Data, Updates, id};

/// The shortest period (fw4). fw2 names none; a period of 0 can't be kept, so it is the shortest there too.
const MIN_PERIOD_MS: u16 = 10;

/// The ids that have automatic updates, in the order in which they are sent.
const IDS: [u8; 5] = [id::GET_SYSTEM_STATE, id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED, id::GET_FORCE];

#[derive(Debug)]
struct Subscription {
    id: u8,
    on_change: bool,
    period: Duration,
    last_at: Instant,
    last: Data,
}

/// The automatic updates that are switched on.
#[derive(Debug, Default)]
pub struct Subscriptions(Vec<Subscription>);

impl Subscriptions {
    /// Switches the updates of `id` on or off; `now` its value is `value`. Those of one period come in one cycle, so that
    /// their values are of one instant.
    pub fn set(&mut self, id: u8, updates: Updates, value: Data, now: Instant) {
        self.0.retain(|subscription| subscription.id != id);
        if let Updates::On { on_change, period_ms } = updates {
            let period = Duration::from_millis(period_ms.max(MIN_PERIOD_MS).into());
            let is_in_step = |other: &&Subscription| !on_change && !other.on_change && other.period == period;
            let last_at = self.0.iter().find(is_in_step).map_or(now, |other| other.last_at);
            self.0.push(Subscription { id, on_change, period, last_at, last: value });
            self.0.sort_by_key(|subscription| IDS.iter().position(|&id| id == subscription.id));
        }
    }

    /// Switches all of them off.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Which of them are on.
    pub fn ids(&self) -> impl Iterator<Item = u8> {
        self.0.iter().map(|subscription| subscription.id)
    }

    /// Whether some of them wait for a change.
    #[must_use]
    pub fn watch(&self) -> bool {
        self.0.iter().any(|subscription| subscription.on_change)
    }

    /// When the next update is due, by the values that `read` tells; never before it is allowed.
    pub fn due(&self, read: impl Fn(u8) -> Data) -> Option<Instant> {
        let due = |subscription: &Subscription| {
            let waits = subscription.on_change && !has_changed(&subscription.last, &read(subscription.id));
            (!waits).then(|| subscription.last_at + subscription.period)
        };
        self.0.iter().filter_map(due).min()
    }

    /// The updates that are due at `now`.
    pub fn take_due(&mut self, now: Instant, read: impl Fn(u8) -> Data) -> Vec<(u8, Data)> {
        let mut taken = Vec::new();
        for subscription in &mut self.0 {
            let value = read(subscription.id);
            let waits = subscription.on_change && !has_changed(&subscription.last, &value);
            if waits || now < subscription.last_at + subscription.period {
                continue;
            }
            // Who was not asked in time leaves out what was missed.
            let next = subscription.last_at + subscription.period;
            let is_late = now >= next + subscription.period;
            subscription.last_at = if subscription.on_change || is_late { now } else { next };
            subscription.last = value.clone();
            taken.push((subscription.id, value));
        }
        taken
    }
}

/// By the manual's thresholds.
fn has_changed(last: &Data, value: &Data) -> bool {
    match (last, value) {
        (Data::Width(last), Data::Width(value)) => differ(last.mm(), value.mm(), 0.01),
        (Data::Speed(last), Data::Speed(value)) => differ(last.mm_s(), value.mm_s(), 0.05),
        (Data::Force(last), Data::Force(value)) => differ(last.n(), value.n(), 0.05),
        (last, value) => last != value,
    }
}

fn differ(last: f32, value: f32, threshold: f32) -> bool {
    (value - last).abs() >= threshold
}
