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

/// Active automatic updates.
#[derive(Debug, Default)]
pub struct Subscriptions(Vec<Subscription>);

impl Subscriptions {
    /// Switches the updates of `id` on or off; `value` is the current value, if it is known. Periodic updates of equal
    /// periods share one cycle, so that their values are from the same instant.
    pub fn set(&mut self, id: u8, updates: Updates, value: Option<Data>, now: Instant) {
        self.0.retain(|subscription| subscription.id != id);
        if let Updates::On { on_change, period_ms } = updates {
            let period = Duration::from_millis(period_ms.max(MIN_PERIOD_MS).into());
            let in_step = self.0.iter().find(|other| !on_change && !other.on_change && other.period == period);
            let last_at = in_step.map_or(now, |other| other.last_at);
            self.0.push(Subscription { id, on_change, period, last_at, last: value });
            self.0.sort_by_key(|subscription| IDS.iter().position(|&id| id == subscription.id));
        }
    }

    /// Switches all updates off.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Ids whose updates are on.
    pub fn ids(&self) -> impl Iterator<Item = u8> {
        self.0.iter().map(|subscription| subscription.id)
    }

    /// Whether any updates are sent on change.
    #[must_use]
    pub fn has_on_change(&self) -> bool {
        self.0.iter().any(|subscription| subscription.on_change)
    }

    /// Time of the next update, given the current values from `read`. Never earlier than the period allows. Without
    /// `with_changes`, changes wait.
    pub fn due(&self, with_changes: bool, read: impl Fn(u8) -> Option<Data>) -> Option<Instant> {
        let ready = self.0.iter().filter(|subscription| {
            !subscription.on_change
                || (with_changes && has_changed(subscription.last.as_ref(), read(subscription.id).as_ref()))
        });
        ready.map(|subscription| subscription.last_at + subscription.period).min()
    }

    /// Returns the updates due at `now`, with their values from `read`. An unknown value has none. Without
    /// `with_changes`, changes wait.
    pub fn take_due(&mut self, now: Instant, with_changes: bool, read: impl Fn(u8) -> Option<Data>) -> Vec<(u8, Data)> {
        let mut taken = Vec::new();
        for subscription in &mut self.0 {
            let value = read(subscription.id);
            let has_changed = with_changes && has_changed(subscription.last.as_ref(), value.as_ref());
            let waits = subscription.on_change && !has_changed;
            if waits || now < subscription.last_at + subscription.period {
                continue;
            }
            // After a late call, missed updates are skipped.
            let next = subscription.last_at + subscription.period;
            let is_late = now >= next + subscription.period;
            subscription.last_at = if subscription.on_change || is_late { now } else { next };
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
