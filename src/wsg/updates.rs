//! Automatic updates (`fw4-en 3.4.1` to `3.4.6`): periodic, or on change with the period as the shortest interval.

use std::time::{Duration, Instant};

use super::{Command, Data, Updates, id};

/// Shortest period in ms (fw4). fw2 names no minimum, but no device can keep a period of 0, so it applies there too.
const MIN_PERIOD_MS: u16 = 10;

/// Ids with automatic updates, in sending order.
const IDS: [u8; 5] = [id::GET_SYSTEM_STATE, id::GET_GRIPPER_STATE, id::GET_WIDTH, id::GET_SPEED, id::GET_FORCE];

impl Command {
    /// The request of a getter with automatic updates; `None` for other ids.
    #[must_use]
    pub fn query(id: u8, updates: Updates) -> Option<Self> {
        Some(match id {
            id::GET_SYSTEM_STATE => Self::GetSystemState(updates),
            id::GET_GRIPPER_STATE => Self::GetGripperState(updates),
            id::GET_WIDTH => Self::GetWidth(updates),
            id::GET_SPEED => Self::GetSpeed(updates),
            id::GET_FORCE => Self::GetForce(updates),
            _ => return None,
        })
    }
}

#[derive(Debug)]
struct Subscription {
    id: u8,
    on_change: bool,
    period: Duration,
    last_at: Instant,
    /// Value sent last; `None` if it was unknown.
    last: Option<Data>,
}

impl Subscription {
    /// Time of the last update of another subscription with the same period, whose updates go evenly between those of
    /// this one: each id has its place in the period.
    fn between(&self, id: u8, now: Instant) -> Instant {
        let places = IDS.len() as u32;
        let offset = (place(id) + places - place(self.id)) % places;
        let last_at = self.last_at + self.period / places * offset;
        if last_at > now { last_at.checked_sub(self.period).unwrap_or(now) } else { last_at }
    }
}

/// Place of an id in the sending order.
fn place(id: u8) -> u32 {
    IDS.iter().position(|&known| known == id).unwrap_or_default() as u32
}

/// Active automatic updates.
#[derive(Debug, Default)]
pub struct Subscriptions {
    active: Vec<Subscription>,
    is_spread: bool,
}

impl Subscriptions {
    /// No updates yet. Those of equal periods will be spread over the period instead of sharing one cycle, for clients
    /// that lose the second of two frames that arrive together.
    #[must_use]
    pub const fn spread() -> Self {
        Self { active: Vec::new(), is_spread: true }
    }

    /// Switches the updates of `id` on or off; `value` is the current value, if it is known. Periodic updates of equal
    /// periods share one cycle, so that their values are from the same instant, unless they are spread.
    pub fn set(&mut self, id: u8, updates: Updates, value: Option<Data>, now: Instant) {
        self.active.retain(|subscription| subscription.id != id);
        if let Updates::On { on_change, period_ms } = updates {
            let period = Duration::from_millis(period_ms.max(MIN_PERIOD_MS).into());
            let same = self.active.iter().find(|other| !on_change && !other.on_change && other.period == period);
            let last_at = match same {
                Some(other) if self.is_spread => other.between(id, now),
                Some(other) => other.last_at,
                None => now,
            };
            self.active.push(Subscription { id, on_change, period, last_at, last: value });
            self.active.sort_by_key(|subscription| place(subscription.id));
        }
    }

    /// Switches all updates off.
    pub fn clear(&mut self) {
        self.active.clear();
    }

    /// Ids whose updates are on.
    pub fn ids(&self) -> impl Iterator<Item = u8> {
        self.active.iter().map(|subscription| subscription.id)
    }

    /// Whether any updates are sent on change.
    #[must_use]
    pub fn has_on_change(&self) -> bool {
        self.active.iter().any(|subscription| subscription.on_change)
    }

    /// Time of the next update, given the current values from `read`. Never earlier than the period allows. Without
    /// `with_changes`, changes wait.
    pub fn due(&self, with_changes: bool, read: impl Fn(u8) -> Option<Data>) -> Option<Instant> {
        let ready = self.active.iter().filter(|subscription| {
            !subscription.on_change
                || (with_changes && has_changed(subscription.last.as_ref(), read(subscription.id).as_ref()))
        });
        ready.map(|subscription| subscription.last_at + subscription.period).min()
    }

    /// Returns the updates due at `now`, with their values from `read`. An unknown value has none. Without
    /// `with_changes`, changes wait.
    pub fn take_due(&mut self, now: Instant, with_changes: bool, read: impl Fn(u8) -> Option<Data>) -> Vec<(u8, Data)> {
        let mut taken = Vec::new();
        for subscription in &mut self.active {
            let value = read(subscription.id);
            let has_changed = with_changes && has_changed(subscription.last.as_ref(), value.as_ref());
            let waits = subscription.on_change && !has_changed;
            if waits || now < subscription.last_at + subscription.period {
                continue;
            }
            let late = now.saturating_duration_since(subscription.last_at);
            let into_period = Duration::from_nanos((late.as_nanos() % subscription.period.as_nanos()) as u64);
            // After a late call, missed updates are skipped, and the next one has its own place in the period.
            subscription.last_at =
                if subscription.on_change { now } else { now.checked_sub(into_period).unwrap_or(now) };
            if let Some(value) = value {
                subscription.last = Some(value.clone());
                taken.push((subscription.id, value));
            }
        }
        taken
    }
}

/// Compares values by the manual's thresholds in mm, mm/s and N. A value that becomes unknown is not a change.
fn has_changed(last: Option<&Data>, value: Option<&Data>) -> bool {
    match (last, value) {
        (_, None) => false,
        (Some(Data::Width(last)), Some(Data::Width(value))) => differ(last.mm(), value.mm(), 0.01),
        (Some(Data::Speed(last)), Some(Data::Speed(value))) => differ(last.mm_s(), value.mm_s(), 0.05),
        (Some(Data::Force(last)), Some(Data::Force(value))) => differ(last.n(), value.n(), 0.05),
        (last, value) => last != value,
    }
}

fn differ(last: f32, value: f32, threshold: f32) -> bool {
    (value - last).abs() >= threshold
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Updates = Updates::On { on_change: false, period_ms: 20 };

    #[allow(clippy::unnecessary_wraps, reason = "the type of a function that reads values")]
    fn same(_: u8) -> Option<Data> {
        Some(Data::None)
    }

    /// Ids of the next updates, with the milliseconds from `start`.
    fn next(subscriptions: &mut Subscriptions, start: Instant, count: usize) -> Vec<(u128, Vec<u8>)> {
        let mut taken = Vec::new();
        for _ in 0..count {
            let at = subscriptions.due(true, same).unwrap();
            let ids = subscriptions.take_due(at, true, same).into_iter().map(|(id, _)| id).collect();
            taken.push(((at - start).as_millis(), ids));
        }
        taken
    }

    #[test]
    fn equal_periods_share_a_cycle_unless_they_are_spread() {
        let start = Instant::now();
        let mut together = Subscriptions::default();
        let mut spread = Subscriptions::spread();
        for (delay_ms, id) in (0..).zip(IDS) {
            let now = start + Duration::from_millis(delay_ms);
            together.set(id, PERIOD, None, now);
            spread.set(id, PERIOD, None, now);
        }
        assert_eq!(next(&mut together, start, 2), [(20, IDS.to_vec()), (40, IDS.to_vec())]);
        let [flags, state, width, speed, force] = IDS.map(|id| vec![id]);
        let apart = [(4, state), (8, width), (12, speed), (16, force), (20, flags.clone())];
        assert_eq!(next(&mut spread, start, 5), apart);
        assert_eq!(next(&mut spread, start, 5).last(), Some(&(40, flags)));
    }

    #[test]
    fn late_call_does_not_bring_spread_updates_together() {
        let start = Instant::now();
        let mut spread = Subscriptions::spread();
        for id in IDS {
            spread.set(id, PERIOD, None, start);
        }
        let late = start + Duration::from_millis(170);
        assert_eq!(spread.take_due(late, true, same).len(), IDS.len(), "missed updates are skipped");
        let after: Vec<_> = next(&mut spread, start, 5).into_iter().map(|(at, ids)| (at, ids.len())).collect();
        assert_eq!(after, [(172, 1), (176, 1), (180, 1), (184, 1), (188, 1)]);
    }
}
