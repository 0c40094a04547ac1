//! The writing thread. All waiting records become one transaction, so that the cost per record falls when many wait for
//! a slow disk. After a failure the write is retried, together with newer records.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::chain::{Chain, Tip};
use super::check::check_newest;
use super::clock::{ClockCheck, TimeServer};
use super::head::{Head, HeadFile};
use super::kept_events;
use super::presence::CHECK_EVERY;
use super::prune::Pruning;
use super::reading::query::grip;
use super::restored;
use super::row::{self, GripUpdate, Row, Stored};
use super::shared::{Senders, Shared};
use super::store::{PersistedValues, Store};
use super::{Retention, places};
use crate::gripper::recorder::Record;
use crate::model::{CommandId, Detail, Event, GatewayEvent, GripRecord};

/// Maximum number of records per transaction: some milliseconds of work, for which the first record has to wait.
const MAX_BATCH: usize = 1024;

/// Records kept in memory while the disk fails: more than a minute at 100 a second, in some megabytes.
const MAX_HELD: usize = 8192;

/// Time before a failed write is retried.
const RETRY: Duration = Duration::from_secs(1);

/// Time between two attempts to empty the write-ahead log.
const EMPTY_LOG_EVERY: Duration = Duration::from_secs(1);

/// Time between two events with the head.
const HEAD_EVERY: Duration = Duration::from_hours(1);

/// Time for which an orderly end retries failed writes.
const CLOSE_WITHIN: Duration = Duration::from_secs(3);

/// Input of the writing thread.
#[derive(Debug)]
pub(super) enum WriterInput {
    Record(Box<Record>),
    /// Persisted values wait in [`Shared`].
    PersistedValues,
    /// The end of writing: orderly, or as if the process were killed after its last record.
    End {
        orderly: bool,
    },
    /// A person knows of the restored journal.
    ConfirmRestored,
    /// A person trusts the wall clock.
    ConfirmClock,
    /// Limits the file's size, to simulate a full disk.
    #[cfg(test)]
    MaxPages(i64),
}

/// A record that waits for its place in a chain.
#[derive(Debug)]
enum Placed {
    Event(Box<Event>),
    Grip(Box<GripRecord>),
}

impl Placed {
    fn event(event: Event) -> Self {
        Self::Event(Box::new(event))
    }

    /// Gives the record its place after these ends of the chains.
    fn row(&self, ends: &[Tip; 2]) -> serde_json::Result<Row> {
        match self {
            Self::Event(event) => Row::event(ends[Chain::Events as usize], event),
            Self::Grip(grip) => Row::grip(ends[Chain::Grips as usize], grip),
        }
    }
}

/// Records and persisted values that are not durable yet. Records get their places when they are written.
#[derive(Debug, Default)]
struct Batch {
    records: Vec<Placed>,
    persisted: PersistedValues,
    waiters: Vec<oneshot::Sender<()>>,
}

impl Batch {
    fn is_empty(&self) -> bool {
        self.records.is_empty() && self.persisted.is_empty()
    }
}

/// State of the writing thread.
#[derive(Debug)]
pub(super) struct JournalWriter {
    store: Store,
    shared: Arc<Shared>,
    senders: Senders,
    /// Ends of the chains of events and grip records; `None` after a failed write, until they are read from the file.
    ends: Option<[Tip; 2]>,
    batch: Batch,
    /// Time of the next attempt, while writes fail.
    retry_at: Option<Instant>,
    /// Time of the next check of the journal's files.
    check_at: Instant,
    /// Time of the next attempt to empty the write-ahead log, while it is too large.
    empty_log_at: Option<Instant>,
    /// Lost records that events have reported.
    lost_reported: u64,
    pruning: Pruning,
    clock: ClockCheck,
    time_server: TimeServer,
    /// File of the head; `None` for a journal in memory.
    head: Option<HeadFile>,
    /// Head as it was last written.
    written: Head,
    /// Time of the next event with the head, and the newest event at the last one.
    head_due: Instant,
    head_seq: i64,
}

impl JournalWriter {
    /// Writes the events that complete the last run. If the disk fails, they wait for the next attempt.
    pub(super) fn new(
        store: Store,
        head: Option<HeadFile>,
        retention: Retention,
        last_run: Vec<Event>,
    ) -> rusqlite::Result<Self> {
        let ends = store.ends()?;
        let started = Instant::now();
        let clock = ClockCheck::new(&store.connection, started)?;
        let (shared, senders) = Shared::new(ends[Chain::Events as usize].seq);
        let shared = Arc::new(shared);
        let mut batch = Batch::default();
        check_newest(&store.source.place, &store.connection, &shared);
        batch.records.extend(last_run.into_iter().map(Placed::event));
        let kept = kept_events::unattested(&store.connection)?;
        batch.records.extend(kept.map(|kept| Placed::event(Event::new(row::now(), None, Detail::Gateway(kept)))));
        let mut writer = Self {
            store,
            shared,
            senders,
            ends: Some(ends),
            batch,
            retry_at: None,
            check_at: Instant::now() + CHECK_EVERY,
            empty_log_at: None,
            lost_reported: 0,
            pruning: Pruning::new(retention, started),
            clock,
            time_server: TimeServer::default(),
            head,
            written: Head::new(ends),
            head_due: started + HEAD_EVERY,
            head_seq: ends[Chain::Events as usize].seq,
        };
        writer.commit(Instant::now());
        Ok(writer)
    }

    /// Returns the head, as far as it is known.
    pub(super) fn head(&self) -> Head {
        Head::new(self.ends.unwrap_or_default())
    }

    pub(super) fn shared(&self) -> Arc<Shared> {
        self.shared.clone()
    }

    /// Writes until the end.
    ///
    /// # Errors
    /// The number of unwritten records, and the cause.
    pub(super) fn run(mut self, inputs: &Receiver<WriterInput>) -> Result<(), String> {
        loop {
            let due = self.empty_log_at.into_iter().chain([self.check_at]).fold(self.pruning.due(), Instant::min);
            let wake = self.retry_at.unwrap_or(due);
            let mut input = match inputs.recv_timeout(wake.saturating_duration_since(Instant::now())) {
                Ok(input) => Some(input),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => Some(WriterInput::End { orderly: false }),
            };
            while let Some(next) = input {
                match next {
                    WriterInput::Record(record) => {
                        self.shared.release_place();
                        self.take(*record);
                    }
                    WriterInput::PersistedValues => {}
                    WriterInput::ConfirmRestored => self.confirm_restored(),
                    WriterInput::ConfirmClock => self.confirm_clock(),
                    WriterInput::End { orderly } => return self.end(orderly),
                    #[cfg(test)]
                    WriterInput::MaxPages(pages) => self.store.limit_pages(pages),
                }
                let room = self.retry_at.is_none() && self.batch.records.len() < MAX_BATCH;
                input = if room { inputs.try_recv().ok() } else { None };
            }
            let now = Instant::now();
            if self.retry_at.is_none_or(|at| now >= at) {
                self.make_room(now);
                self.commit(now);
            }
            self.prune(now);
            self.empty_log(now);
        }
    }

    fn take(&mut self, record: Record) {
        if self.batch.records.len() >= places(&record, MAX_HELD) {
            return self.shared.lose();
        }
        match record {
            Record::Event(event, waiter) => {
                self.batch.records.push(Placed::event(event));
                // While the disk fails, the dropped channel reports that at once.
                self.batch.waiters.extend(waiter.filter(|_| self.retry_at.is_none()));
            }
            Record::Grip(grip) => self.batch.records.push(Placed::Grip(grip)),
            Record::Persisted(value) => self.shared.persist(value),
        }
    }

    /// Takes the ends of the chains. They stay unknown unless the caller puts them back after a successful write.
    fn take_ends(&mut self) -> rusqlite::Result<[Tip; 2]> {
        if let Some(ends) = self.ends.take() {
            return Ok(ends);
        }
        let differences = self.written.differences(&self.store.connection, true)?;
        // The file keeps the last head, so that the next start and a verification notice the difference.
        if !differences.is_empty() && self.head.take().is_some() {
            tracing::error!(differences = differences.join("; "), "journal lacks records that were written");
        }
        self.store.ends()
    }

    /// Gives the batch's records their places, and writes the batch.
    fn write(&mut self) -> rusqlite::Result<Vec<Row>> {
        let mut ends = self.take_ends()?;
        let mut rows = Vec::with_capacity(self.batch.records.len());
        self.batch.records.retain(|record| match record.row(&ends) {
            Ok(row) => {
                ends[row.chain as usize] = row.tip;
                rows.push(row);
                true
            }
            Err(error) => {
                tracing::error!(%error, "record lost: it cannot be encoded as JSON");
                self.shared.lose();
                false
            }
        });
        self.shared.while_watched(|| self.store.commit(&rows, &self.batch.persisted))?;
        self.ends = Some(ends);
        Ok(rows)
    }

    /// Makes the batch durable and broadcasts its events; keeps it on failure.
    fn commit(&mut self, now: Instant) {
        self.check_at = now + CHECK_EVERY;
        if let Err(failure) = self.store.check_files() {
            if self.retry_at.is_none() {
                self.store.rescue();
            }
            return self.fail(failure, now);
        }
        // While the disk fails, losses add up to one number, which is recorded once it works again.
        if self.retry_at.is_none() {
            self.record_head(now);
            self.record_lost();
            self.take_aggregates(now, false);
        }
        self.batch.persisted.extend(self.shared.take_persisted());
        if self.batch.is_empty() {
            if self.retry_at.take().is_some() {
                tracing::info!("journal recovered");
                self.shared.set_failure(None);
            }
            return;
        }
        let rows = match self.write() {
            Ok(rows) => rows,
            Err(error) => return self.fail(self.store.source.describe(&error), now),
        };
        let kept = self.store.check_written();
        self.write_head();
        self.pruning.wrote(&rows, now);
        let batch = std::mem::take(&mut self.batch);
        let records = rows.len();
        for row in rows {
            row.event.into_iter().for_each(|event| self.broadcast(event));
            row.grip.into_iter().for_each(|id| self.broadcast_grip(id));
        }
        if let Err(failure) = kept {
            // The open files have the records, so they are not written again. They are not durable: the waiters drop.
            return self.fail(failure, now);
        }
        if self.retry_at.take().is_some() {
            tracing::info!(records, "journal recovered");
        }
        for waiter in batch.waiters {
            // The receiver may be gone.
            let _ = waiter.send(());
        }
        if self.shared.failing() {
            self.shared.set_failure(None);
            self.commit(now);
        }
    }

    /// Notes a failed write, which is retried.
    fn fail(&mut self, failure: String, now: Instant) {
        if self.retry_at.is_none() {
            tracing::error!(failure, "journal cannot be written");
        }
        self.shared.set_failure(Some(failure));
        self.batch.waiters.clear();
        self.retry_at = Some(now + RETRY);
    }

    /// Broadcasts a durable event, after its sequence number.
    fn broadcast(&self, event: Arc<Stored>) {
        self.shared.set_committed(event.seq);
        // There may be no receivers.
        let _ = self.senders.events.send(event);
    }

    /// Broadcasts the grip record of a command as it is served now, if the record is stored.
    fn broadcast_grip(&self, id: CommandId) {
        if self.senders.grips.receiver_count() == 0 {
            return;
        }
        match grip(&self.store.connection, id) {
            Ok(Some(body)) => match GripUpdate::of(body) {
                Ok(update) => drop(self.senders.grips.send(Arc::new(update))),
                Err(error) => tracing::warn!(%error, command = %id, "damaged grip record not sent to subscribers"),
            },
            // A grip record is written up to a second after the grip. A part that was lost before is in that record.
            Ok(None) => {}
            Err(error) => tracing::warn!(%error, command = %id, "grip record not sent to subscribers"),
        }
    }

    fn take_aggregates(&mut self, now: Instant, all: bool) {
        self.batch.records.extend(self.shared.rates.due(now, all).into_iter().map(Placed::event));
    }

    /// Adds the event with the head in front of the batch, if one is due and there are newer records.
    fn record_head(&mut self, now: Instant) {
        let Some(ends) = self.ends.filter(|_| now >= self.head_due) else { return };
        self.head_due = now + HEAD_EVERY;
        let head = Head::new(ends);
        if head.newest_event() > self.head_seq {
            let event = Event::new(row::now(), None, Detail::Gateway(head.event()));
            self.batch.records.insert(0, Placed::event(event));
            self.head_seq = head.newest_event() + 1;
        }
    }

    fn write_head(&mut self) {
        let Some(ends) = self.ends else { return };
        self.written = Head::new(ends);
        if let Some(file) = &mut self.head {
            file.write(self.written);
        }
    }

    fn confirm_restored(&mut self) {
        if let Err(error) = restored::confirm(&self.store.connection) {
            tracing::warn!(failure = self.store.source.describe(&error), "confirmation not stored");
        }
    }

    fn confirm_clock(&mut self) {
        self.clock.trust(&self.store.connection, row::now(), Instant::now());
        self.shared.set_clock(None);
        self.pruning.is_clock_doubtful = false;
    }

    fn record_lost(&mut self) {
        let lost = self.shared.health.borrow().lost;
        if lost > self.lost_reported {
            self.own(GatewayEvent::RecordsLost { count: lost - self.lost_reported });
            self.lost_reported = lost;
        }
    }

    fn own(&mut self, event: GatewayEvent) {
        self.batch.records.push(Placed::event(Event::new(row::now(), None, Detail::Gateway(event))));
    }

    fn prune(&mut self, now: Instant) {
        if self.retry_at.is_some() || now < self.pruning.due() {
            return;
        }
        match self.remove(now) {
            Ok(Some(event)) => self.broadcast(event),
            Ok(None) => {}
            Err(error) => tracing::warn!(failure = self.store.source.describe(&error), "old records not removed"),
        }
        // A slow or failed removal does not count as a failure of the journal: the next write is tried at once.
        self.shared.set_failure(None);
    }

    /// Removes old records before a failed write is retried, because they may fill the disk.
    fn make_room(&mut self, now: Instant) {
        if self.retry_at.is_none() || self.store.check_files().is_err() {
            return;
        }
        let emptied = self.store.checkpoint();
        match emptied.and_then(|()| self.remove(now)) {
            Ok(event) => event.into_iter().for_each(|event| self.broadcast(event)),
            Err(error) => tracing::debug!(%error, "no records removed"),
        }
    }

    /// Keeps the write-ahead log small, even if readers always use it.
    fn empty_log(&mut self, now: Instant) {
        if self.retry_at.is_some() || self.empty_log_at.is_some_and(|at| now < at) {
            return;
        }
        if self.store.log_is_large() {
            if let Err(error) = self.shared.while_watched(|| self.store.checkpoint()) {
                tracing::warn!(failure = self.store.source.describe(&error), "write-ahead log not emptied");
            }
            // As after a removal, the next write is tried at once.
            self.shared.set_failure(None);
        }
        self.empty_log_at = self.store.log_is_large().then_some(now + EMPTY_LOG_EVERY);
    }

    /// Runs a step of retention, and returns the event that attests a new removal.
    fn remove(&mut self, now: Instant) -> rusqlite::Result<Option<Arc<Stored>>> {
        if self.store.check_files().is_err() {
            // The next commit reports the fault.
            return Ok(None);
        }
        if self.pruning.is_looking() {
            let wall = row::now();
            self.pruning.is_clock_doubtful =
                self.clock.look(&self.store.connection, wall, now, || self.time_server.ask());
            self.shared.set_clock(self.clock.doubt());
        }
        let mut ends = self.take_ends()?;
        let end = ends[Chain::Events as usize];
        let row = self.shared.while_watched(|| self.pruning.step(&mut self.store, end, now))?;
        if let Some(row) = &row {
            ends[Chain::Events as usize] = row.tip;
        }
        self.ends = Some(ends);
        self.write_head();
        if let Some(head) = self.head.as_ref().filter(|_| row.is_some()) {
            head.sync();
        }
        // The next commit finds and reports a fault of the files again.
        let _ = self.store.check_written();
        Ok(row.and_then(|row| row.event))
    }

    fn end(mut self, orderly: bool) -> Result<(), String> {
        let until = Instant::now() + CLOSE_WITHIN;
        if orderly {
            self.take_aggregates(Instant::now(), true);
            // A verification tolerates changes of kept events until they are attested.
            match self.pruning.interrupted(&self.store.connection) {
                Ok(event) => event.into_iter().for_each(|event| self.own(event)),
                Err(error) => tracing::warn!(%error, "kept events not attested"),
            }
            self.own(GatewayEvent::Ended);
        }
        loop {
            self.commit(Instant::now());
            let Some(failure) = self.shared.health.borrow().failure.clone() else { break };
            if !orderly || Instant::now() + RETRY > until {
                return Err(format!("{} records were not written: {failure}", self.batch.records.len()));
            }
            std::thread::sleep(RETRY);
        }
        if orderly && let Err(error) = self.store.checkpoint() {
            tracing::warn!(failure = self.store.source.describe(&error), "write-ahead log not emptied on close");
        }
        Ok(())
    }
}

impl Drop for JournalWriter {
    fn drop(&mut self) {
        self.shared.over();
    }
}

#[cfg(test)]
#[path = "writer_tests.rs"]
mod tests;
