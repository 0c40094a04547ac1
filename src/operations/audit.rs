//! Audit of refused requests.
//!
//! The first refusal of a kind is recorded at once; repeats are counted and recorded once a second, so a client that
//! floods the gateway does not fill the disk. Answers to such a client are delayed, so that it takes no processor time
//! from a FAST STOP.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::Semaphore;

use crate::gripper::Now;
use crate::gripper::model::{Client, Detail, Event, Name, RefusedEvent, Urgency};
use crate::gripper::recorder::{Record, Recorder as _};
use crate::journal::Journal;

/// Interval at which counted repeats are recorded.
pub const COUNTED_FOR: Duration = Duration::from_secs(1);

/// Kinds of refusals that are counted separately within a second. The rest are counted together.
const MAX_KINDS: usize = 256;

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

/// Counts the refusals of the current second.
#[derive(Debug)]
pub struct Audit {
    journal: Journal,
    /// Newest cause of each kind, and the number of repeats after the first.
    counted: Mutex<HashMap<RefusedRequest, (String, u64)>>,
    held_back: Semaphore,
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
        let mut counted = self.counted.lock().unwrap_or_else(PoisonError::into_inner);
        if counted.len() >= MAX_KINDS && !counted.contains_key(&refusal) {
            let others = Client::new("others", refusal.client.door);
            refusal = RefusedRequest { gripper: None, client: others, command: "others".to_owned(), ..refusal };
        }
        match counted.entry(refusal) {
            Entry::Occupied(mut entry) => {
                let repeats = entry.get().1 + 1;
                *entry.get_mut() = (cause, repeats);
                (repeats >= MAX_PROMPT).then_some(HELD_BACK_FOR)
            }
            Entry::Vacant(entry) => {
                self.write(entry.key(), cause.clone(), 1);
                entry.insert((cause, 0));
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

    /// Records the counted repeats once a second, for as long as it is polled.
    pub async fn count(&self) {
        loop {
            tokio::time::sleep(COUNTED_FOR).await;
            self.write_down();
        }
    }

    /// Records the repeats counted so far.
    pub fn write_down(&self) {
        let counted = std::mem::take(&mut *self.counted.lock().unwrap_or_else(PoisonError::into_inner));
        for (refusal, (cause, count)) in counted.into_iter().filter(|(_, (_, count))| *count > 0) {
            self.write(&refusal, cause, count);
        }
    }

    fn write(&self, refusal: &RefusedRequest, cause: String, count: u64) {
        let RefusedRequest { gripper, client, command, code } = refusal.clone();
        let detail = Detail::Refused(RefusedEvent { command, code, cause, count });
        self.journal.record(Record::Event(Event::new(Now::read().wall, gripper, detail).by(&client), None));
    }
}
