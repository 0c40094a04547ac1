//! Checks for damage: the newest records before the first write, then the whole journal in the background.

use std::fmt;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use rusqlite::{Connection, InterruptHandle};

use super::reading::reader::Reader;
use super::shared::Shared;
use super::source::{JournalLocation, Source};
use super::spawn;
use super::store::OpenError;
use super::verify::{Report, verify_in_parts, verify_newest};

/// Records of each chain that are checked at the start, which takes about 5 ms whatever the file's size. The whole
/// journal takes 10 s per GB from memory, and minutes from an SD card.
const NEWEST: i64 = 1024;

/// Ratio of resting to reading: the check uses at most a fifth of the disk's time.
const REST: u32 = 4;

/// Time between two attempts to end a check.
const INTERRUPT_EVERY: Duration = Duration::from_millis(10);

/// The check of the whole journal, on a thread of its own.
pub(super) struct Check {
    pub(super) thread: JoinHandle<()>,
    interrupt: InterruptHandle,
    stop: Arc<Stop>,
}

impl fmt::Debug for Check {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Check").field("thread", &self.thread).finish_non_exhaustive()
    }
}

/// Ends the check between two of its parts.
#[derive(Debug, Default)]
struct Stop {
    stopped: Mutex<bool>,
    changed: Condvar,
}

impl Stop {
    fn stop(&self) {
        *self.stopped.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.changed.notify_all();
    }

    /// Waits for a time; returns false if the check has to end.
    fn rest(&self, time: Duration) -> bool {
        let stopped = self.stopped.lock().unwrap_or_else(PoisonError::into_inner);
        let rested = self.changed.wait_timeout_while(stopped, time, |stopped| !*stopped);
        !*rested.unwrap_or_else(PoisonError::into_inner).0
    }
}

impl Check {
    /// Starts the check of a file; a journal in memory needs none.
    pub(super) fn start(source: &Source, shared: Arc<Shared>) -> Result<Option<Self>, OpenError> {
        if source.place == JournalLocation::Memory {
            return Ok(None);
        }
        let reader = Reader::connect(source).map_err(|error| OpenError::Unusable(error.to_string()))?;
        let interrupt = reader.interrupt_handle();
        let stop = Arc::new(Stop::default());
        let place = source.place.clone();
        let until = stop.clone();
        let thread = spawn("journal-check", move || {
            // At normal priority: SQLite's connections share locks, and on a busy machine a thread of low priority can
            // keep one for longer than a motion waits for its record.
            if let Some(report) = verify_in_parts(&reader, |took| until.rest(took * REST)) {
                report_damage(&place, &report, &shared);
            }
        })?;
        Ok(Some(Self { thread, interrupt, stop }))
    }

    /// Ends the check, wherever it is.
    pub(super) fn end(self) {
        self.stop.stop();
        while !self.thread.is_finished() {
            // An interrupt just before a statement begins has no effect.
            self.interrupt.interrupt();
            std::thread::sleep(INTERRUPT_EVERY);
        }
        // A check that panicked has found nothing.
        let _ = self.thread.join();
    }
}

/// Checks the newest records before the first write.
pub(super) fn check_newest(place: &JournalLocation, connection: &Connection, shared: &Shared) {
    report_damage(place, &verify_newest(connection, NEWEST), shared);
}

fn report_damage(place: &JournalLocation, report: &Report, shared: &Shared) {
    let Some(first) = report.findings.first() else { return };
    let count = report.findings.len() as u64 + report.more;
    let damage = format!(
        "the journal {place} is damaged ({count} findings, first: {first}), but new records are still written: list \
         the findings with `wsg-gateway journal verify --journal {place}`, export what is needed, stop the gateway, \
         and replace the file with an intact copy or move it away"
    );
    tracing::error!(damage, "journal damaged");
    shared.set_damage(damage);
}
