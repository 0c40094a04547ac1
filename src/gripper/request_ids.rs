//! Request ids of the last ten minutes, each with its command, so that a repeated request does not move the gripper
//! twice.
//!
//! Slots are shared fairly. Each subject has its own bound, and if a table is full, the subject with the most slots
//! loses its oldest id. A flood from one subject, or from many invented ones, does not affect the ids of others.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::handle::Ticket;
use model::{CommandReport, Kind, Outcome, Parameters, RequestId};

/// Time for which a request id stands for its command.
pub(super) const REPLAYED_FOR: Duration = Duration::from_mins(10);

/// Memory of one slot: an id, its parameters, its command and their table entries, rounded up. Longer payloads take
/// further slots.
const SLOT_BYTES: usize = 2048;

/// Subject and request id: equal ids of different subjects are independent.
pub(super) type Key = (Arc<str>, RequestId);

/// Bounds of one table, in slots.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct SlotBounds {
    /// Slots of one subject.
    pub per_subject: usize,
    /// Slots of all subjects together.
    pub whole: usize,
}

/// The request ids of one gripper.
#[derive(Debug, Default)]
pub(super) struct RequestIds {
    bounds: SlotBounds,
    ids: HashMap<Key, BoundRequest>,
    /// All ids, oldest first.
    by_age: BTreeMap<u64, Key>,
    /// Ids of each subject, oldest first, and their slots.
    subjects: HashMap<Arc<str>, Subject>,
    /// Subjects, ordered by their slots.
    by_slots: BTreeSet<(usize, Arc<str>)>,
    slots: usize,
    next_number: u64,
}

#[derive(Debug, Default)]
struct Subject {
    slots: usize,
    numbers: BTreeSet<u64>,
}

/// The request behind an id, and its command.
#[derive(Debug)]
struct BoundRequest {
    /// Outlives the command's entry in the registry.
    ticket: Ticket,
    asked: (Kind, Parameters),
    since: Instant,
    /// Number of the id in the order of admission, independent of any clock.
    number: u64,
    slots: usize,
}

impl RequestIds {
    pub(super) fn new(bounds: SlotBounds) -> Self {
        Self { bounds, ..Self::default() }
    }

    /// The request of this id and its command, while the id is valid.
    pub(super) fn find(&self, now: Instant, key: &Key) -> Option<(&(Kind, Parameters), &Ticket)> {
        let bound = self.ids.get(key).filter(|bound| now < bound.since + REPLAYED_FOR)?;
        Some((&bound.asked, &bound.ticket))
    }

    /// Whether another id of this subject fits without an early loss of the subject's own ids.
    pub(super) fn has_room(&self, subject: &Arc<str>) -> bool {
        let own = self.slots_of(subject);
        let largest = self.by_slots.last().map_or(0, |(slots, _)| *slots);
        own < self.bounds.per_subject && (self.slots < self.bounds.whole || largest > own)
    }

    pub(super) fn per_subject(&self) -> usize {
        self.bounds.per_subject
    }

    /// Binds an id to a command. At the subject's bound, the oldest id of this subject is dropped. In a full table, the
    /// oldest id of the subject with the most slots is dropped.
    pub(super) fn bind(&mut self, since: Instant, key: Key, asked: (Kind, Parameters), ticket: Ticket) {
        self.remove(&key);
        let slots = slots_of(asked.1.payload.as_deref()) + slots_of(ticket.record.borrow().payload.as_deref()) + 1;
        while self.slots_of(&key.0) + slots > self.bounds.per_subject && self.forget_oldest_of(&key.0.clone()) {}
        while self.slots + slots > self.bounds.whole
            && let Some((_, subject)) = self.by_slots.last().cloned()
        {
            self.forget_oldest_of(&subject);
        }
        let number = self.next_number;
        self.next_number += 1;
        self.by_age.insert(number, key.clone());
        self.subjects.entry(key.0.clone()).or_default().numbers.insert(number);
        self.count(&key.0, |count| count + slots);
        self.ids.insert(key, BoundRequest { ticket, asked, since, number, slots });
    }

    /// Updates the slots after a command's end: a refused command frees its id, and a script's reply takes slots.
    pub(super) fn ended(&mut self, key: &Key, command: &CommandReport) {
        let Some(bound) = self.ids.get_mut(key).filter(|bound| bound.ticket.id() == command.id) else { return };
        let more = slots_of(command.payload.as_deref());
        if command.outcome == Some(Outcome::Refused) {
            self.remove(key);
        } else if more > 0 {
            bound.slots += more;
            self.count(&key.0, |count| count + more);
        }
    }

    pub(super) fn forget_old(&mut self, now: Instant) {
        while let Some((_, key)) = self.by_age.first_key_value() {
            let key = key.clone();
            if self.ids.get(&key).is_some_and(|bound| now < bound.since + REPLAYED_FOR) {
                return;
            }
            self.remove(&key);
        }
    }

    fn slots_of(&self, subject: &Arc<str>) -> usize {
        self.subjects.get(subject).map_or(0, |subject| subject.slots)
    }

    fn forget_oldest_of(&mut self, subject: &Arc<str>) -> bool {
        let oldest = self.subjects.get(subject).and_then(|subject| subject.numbers.first());
        let key = oldest.and_then(|number| self.by_age.get(number)).cloned();
        key.is_some_and(|key| self.remove(&key))
    }

    fn remove(&mut self, key: &Key) -> bool {
        let Some(bound) = self.ids.remove(key) else { return false };
        self.by_age.remove(&bound.number);
        if let Some(subject) = self.subjects.get_mut(&key.0) {
            subject.numbers.remove(&bound.number);
        }
        self.count(&key.0, |count| count - bound.slots);
        true
    }

    fn count(&mut self, name: &Arc<str>, change: impl Fn(usize) -> usize) {
        let Some(subject) = self.subjects.get_mut(name) else { return };
        let before = subject.slots;
        let after = change(subject.slots);
        subject.slots = after;
        self.by_slots.remove(&(before, name.clone()));
        if subject.numbers.is_empty() {
            self.subjects.remove(name);
        } else {
            self.by_slots.insert((after, name.clone()));
        }
        self.slots = self.slots - before + after;
    }
}

/// Number of slots that a payload takes.
fn slots_of(payload: Option<&str>) -> usize {
    payload.map_or(0, str::len).div_ceil(SLOT_BYTES)
}
