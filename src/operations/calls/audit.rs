//! Audit of refused requests.
//!
//! The first refusal of a kind is recorded at once. Repeats are counted, and recorded together: after a second at first,
//! and after twice as long each time, up to an hour. A client that repeats a refused request for days therefore does not
//! fill the journal, nor the event stream and webhooks that follow it. Answers to a client that floods the gateway are
//! delayed, so that it takes no processor time from a FAST STOP.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::Semaphore;
use tokio::time::Instant;

use crate::gripper::Now;
use crate::gripper::recorder::{Record, Recorder as _};
use crate::journal::Journal;
use crate::model::{Client, Detail, Event, Name, RefusedEvent, Urgency};

/// Interval at which due repeats are recorded, and time for which the first repeats of a kind are counted.
const COUNTED_FOR: Duration = Duration::from_secs(1);

/// Longest time for which repeats of a kind are counted. A kind that has not been seen for as long is a new one.
const COUNTED_FOR_AT_MOST: Duration = Duration::from_hours(1);

/// Kinds of refusals that are counted separately. The rest are counted together.
const MAX_KINDS: usize = 256;

/// Time after which a kind without counted repeats makes way for another one if there are too many. With it, a client
/// that varies its requests causes few records, too.
const KEPT_FOR: Duration = Duration::from_mins(1);

/// Refusals of one kind that are answered at once in each second. A PLC that retries in every cycle causes fewer.
const MAX_PROMPT: u64 = 100;

/// Delay of each further answer.
const HELD_BACK_FOR: Duration = Duration::from_millis(50);

/// Maximum number of answers delayed at the same time; further ones are sent at once. Each delayed answer occupies a
/// connection, and a FAST STOP needs a free one.
const MAX_HELD_BACK: usize = 64;

/// A kind of refused request.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct RefusedRequest {
    /// The gripper, if the request names one.
    pub gripper: Option<Name>,
    pub client: Client,
    pub command: String,
    pub code: String,
}

/// Records refusals, and counts their repeats.
#[derive(Debug)]
pub struct Audit {
    journal: Journal,
    counted: Mutex<HashMap<RefusedRequest, Repeats>>,
    held_back: Semaphore,
}

/// Repeats of a kind of refusal since its newest record.
#[derive(Debug)]
struct Repeats {
    /// Cause of the newest refusal.
    cause: String,
    count: u64,
    /// Number of repeats in the current second.
    in_second: u64,
    /// Time for which repeats are counted.
    pause: Duration,
    /// Time of the next record, if there are repeats.
    due: Instant,
    /// Time of the newest refusal.
    seen: Instant,
}

impl Repeats {
    fn begin(now: Instant, cause: String) -> Self {
        Self { cause, count: 0, in_second: 0, pause: COUNTED_FOR, due: now + COUNTED_FOR, seen: now }
    }

    fn add(&mut self, now: Instant, cause: String) {
        self.cause = cause;
        self.count += 1;
        self.in_second += 1;
        self.seen = now;
    }

    /// Begins to count anew, for longer than before.
    fn recorded(&mut self, now: Instant) {
        self.count = 0;
        self.pause = (self.pause * 2).min(COUNTED_FOR_AT_MOST);
        self.due = now + self.pause;
    }

    /// Whether there are repeats to record, or were refusals within this time.
    fn is_active(&self, now: Instant, time: Duration) -> bool {
        self.count > 0 || now.duration_since(self.seen) < time
    }
}

impl Audit {
    #[must_use]
    pub fn new(journal: Journal) -> Self {
        Self { journal, counted: Mutex::default(), held_back: Semaphore::new(MAX_HELD_BACK) }
    }

    /// Records a refused request. Delays the answer to a client that is refused continually, unless the request is
    /// urgent.
    pub async fn record(&self, request: RefusedRequest, cause: &str, urgency: Urgency) {
        let delay = self.take(request, cause.to_owned());
        if let Some(time) = delay.filter(|_| urgency == Urgency::None) {
            self.hold_back(time).await;
        }
    }

    /// Counts a refused request, and returns the delay of its answer, if any.
    pub fn take(&self, mut refusal: RefusedRequest, cause: String) -> Option<Duration> {
        let now = Instant::now();
        let mut counted = self.counted.lock().unwrap_or_else(PoisonError::into_inner);
        if counted.len() >= MAX_KINDS && !counted.contains_key(&refusal) {
            counted.retain(|_, repeats| repeats.is_active(now, KEPT_FOR));
        }
        if counted.len() >= MAX_KINDS && !counted.contains_key(&refusal) {
            let others = Client::new("others", refusal.client.door);
            refusal = RefusedRequest { gripper: None, client: others, command: "others".to_owned(), ..refusal };
        }
        match counted.entry(refusal) {
            Entry::Occupied(mut entry) => {
                let repeats = entry.get_mut();
                repeats.add(now, cause);
                (repeats.in_second >= MAX_PROMPT).then_some(HELD_BACK_FOR)
            }
            Entry::Vacant(entry) => {
                self.write(entry.key(), cause.clone(), 1);
                entry.insert(Repeats::begin(now, cause));
                None
            }
        }
    }

    /// Delays an answer, unless `MAX_HELD_BACK` others are delayed.
    pub async fn hold_back(&self, time: Duration) {
        if let Ok(_place) = self.held_back.try_acquire() {
            tokio::time::sleep(time).await;
        }
    }

    /// Looks once a second for repeats to record, for as long as it is polled.
    pub async fn count(&self) {
        loop {
            tokio::time::sleep(COUNTED_FOR).await;
            self.write_due(Instant::now());
        }
    }

    /// Records the repeats that are due, and forgets the kinds that have not been seen for long.
    fn write_due(&self, now: Instant) {
        let mut counted = self.counted.lock().unwrap_or_else(PoisonError::into_inner);
        counted.retain(|refusal, repeats| {
            repeats.in_second = 0;
            if repeats.count > 0 && repeats.due <= now {
                self.write(refusal, repeats.cause.clone(), repeats.count);
                repeats.recorded(now);
            }
            repeats.is_active(now, COUNTED_FOR_AT_MOST)
        });
    }

    /// Records all repeats counted so far.
    pub fn write_down(&self) {
        let counted = std::mem::take(&mut *self.counted.lock().unwrap_or_else(PoisonError::into_inner));
        for (refusal, repeats) in counted.into_iter().filter(|(_, repeats)| repeats.count > 0) {
            self.write(&refusal, repeats.cause, repeats.count);
        }
    }

    fn write(&self, refusal: &RefusedRequest, cause: String, count: u64) {
        let RefusedRequest { gripper, client, command, code } = refusal.clone();
        let detail = Detail::Refused(RefusedEvent { command, code, cause, count });
        self.journal.record(Record::Event(Event::new(Now::read().wall, gripper, detail).by(&client), None));
    }
}

#[cfg(test)]
mod tests {
    use serde_json::Value;

    use super::*;
    use crate::journal::{EventQuery, Limit, Order};
    use crate::model::Door;
    use crate::operations::Gateway;

    const A_DAY: Duration = Duration::from_hours(24);

    fn refusal(label: u64) -> RefusedRequest {
        let client = Client::new(format!("http:10.0.0.{label}"), Door::Http);
        RefusedRequest { gripper: None, client, command: "me".to_owned(), code: "unauthorized".to_owned() }
    }

    /// Refuses requests at this interval for this time, and returns the recorded counts.
    async fn recorded(interval: Duration, time: Duration, labels: u64) -> Vec<u64> {
        let gateway = Gateway::of([]);
        let mut looked = Instant::now();
        let end = Instant::now() + time;
        let mut number = 0;
        while Instant::now() < end {
            gateway.audit.take(refusal(number % labels), "no credential".to_owned());
            number += 1;
            tokio::time::advance(interval).await;
            while looked + COUNTED_FOR <= Instant::now() {
                looked += COUNTED_FOR;
                gateway.audit.write_due(looked);
            }
        }
        gateway.audit.write_down();
        let query = EventQuery { limit: Limit::new(1000).unwrap(), order: Order::Oldest, ..EventQuery::default() };
        // The journal writes on a thread of its own.
        loop {
            let page = gateway.journal.events(query.clone()).await.unwrap();
            let records = page.bodies.iter().map(|body| serde_json::from_str::<Value>(body).unwrap());
            let counts: Vec<_> = records.filter_map(|record| record["count"].as_u64()).collect();
            if counts.iter().sum::<u64>() >= number {
                assert_eq!(counts.iter().sum::<u64>(), number);
                return counts;
            }
        }
    }

    #[tokio::test(start_paused = true)]
    async fn refusals_repeated_for_a_day_cause_few_records() {
        let counts = recorded(Duration::from_millis(1500), A_DAY, 1).await;
        assert!(counts.len() < 50 && counts.starts_with(&[1, 1]), "{counts:?}");
    }

    #[tokio::test(start_paused = true)]
    async fn rare_refusals_are_recorded_one_by_one() {
        let counts = recorded(COUNTED_FOR_AT_MOST + COUNTED_FOR, A_DAY, 1).await;
        assert!(counts.len() > 20 && counts.iter().all(|count| *count == 1), "{counts:?}");
    }

    #[tokio::test(start_paused = true)]
    async fn varied_refusals_are_bounded_in_memory_and_records() {
        let counts = recorded(Duration::from_millis(10), Duration::from_mins(1), 10_000).await;
        assert!(counts.len() <= MAX_KINDS + 20, "{}", counts.len());
    }

    #[tokio::test(start_paused = true)]
    async fn flood_is_answered_with_a_delay_in_its_second_only() {
        let audit = Gateway::of([]).audit.clone();
        let delays = (0..150).filter_map(|_| audit.take(refusal(1), String::new()));
        assert_eq!(delays.count(), 50);
        audit.write_due(Instant::now() + COUNTED_FOR);
        let delays = (0..50).filter_map(|_| audit.take(refusal(1), String::new()));
        assert_eq!(delays.count(), 0);
    }
}
