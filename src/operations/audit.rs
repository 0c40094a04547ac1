//! Refused requests, written down: the first of a kind at once, and those that repeat counted by the second, so that a
//! client that floods the gateway fills no disk; and held back, so that it takes no processor time from a FAST STOP.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::sync::Semaphore;

use crate::gripper::Now;
use crate::gripper::model::{Client, Detail, Event, Name, RefusedEvent, Urgency};
use crate::gripper::recorder::{Record, Recorder as _};
use crate::journal::Journal;

/// How often what was counted is written down.
pub const COUNTED_FOR: Duration = Duration::from_secs(1);

/// Kinds of refusals that are told apart within a second. The rest is counted together.
const MAX_KINDS: usize = 256;

/// How many refusals of a kind are answered at once within a second: who tries again each cycle of a PLC has fewer.
const MAX_PROMPT: u64 = 100;

/// How long the answer to each further one waits.
const HELD_BACK_FOR: Duration = Duration::from_millis(50);

/// And how many wait at a time: they keep connections busy, of which a FAST STOP needs one. More are answered at once.
const MAX_HELD_BACK: usize = 64;

/// A kind of refused request.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct RefusedRequest {
    /// The gripper, where the request names one.
    pub gripper: Option<Name>,
    /// The client.
    pub client: Client,
    /// For what.
    pub command: String,
    /// The problem's code.
    pub code: String,
}

/// The refusals of the running second.
#[derive(Debug)]
pub struct Audit {
    journal: Journal,
    /// With the newest words, and how many came after the first.
    counted: Mutex<HashMap<RefusedRequest, (String, u64)>>,
    held_back: Semaphore,
}

impl Audit {
    /// Returns an audit that writes into this journal.
    #[must_use]
    pub fn new(journal: Journal) -> Self {
        Self { journal, counted: Mutex::default(), held_back: Semaphore::new(MAX_HELD_BACK) }
    }

    /// Records a refused request. The answer to a client that is refused all the time is delayed here, unless the request
    /// is urgent.
    pub async fn record(&self, request: RefusedRequest, cause: &str, urgency: Urgency) {
        let delay = self.take(request, cause.to_owned());
        if let Some(time) = delay.filter(|_| urgency == Urgency::None) {
            self.hold_back(time).await;
        }
    }

    /// Takes one, and says how long its answer is to be held back, if it is.
    pub fn take(&self, mut refusal: RefusedRequest, cause: String) -> Option<Duration> {
        let mut counted = self.counted.lock().unwrap_or_else(PoisonError::into_inner);
        if counted.len() >= MAX_KINDS && !counted.contains_key(&refusal) {
            let others = Client { subject: "others".into(), door: refusal.client.door };
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

    /// Waits before an answer that is to be held back.
    pub async fn hold_back(&self, time: Duration) {
        if let Ok(_place) = self.held_back.try_acquire() {
            tokio::time::sleep(time).await;
        }
    }

    /// Writes down what was counted, second by second, for as long as it is polled.
    pub async fn count(&self) {
        loop {
            tokio::time::sleep(COUNTED_FOR).await;
            self.write_down();
        }
    }

    /// Writes down what was counted until now.
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
