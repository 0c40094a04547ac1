//! Getters without automatic updates, read at most every few seconds, however many clients ask; and those with updates,
//! read after a change that no update has followed yet.
//!
//! A value is served until it is too old or a request could have changed it. Callers that arrive during a read share
//! its reply.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use super::super::Now;
use super::super::automatic_updates;
use super::super::handle::ResultSender;
use super::Actor;
use super::link::Purpose;
use model::Missing;
use model::error::{Failure, Rejection};
use wsg::session::End;
use wsg::{Command, Data, Reply, id};

/// Longest time for which a value is served.
const FRESH_FOR: Duration = Duration::from_secs(2);

/// Most callers that wait for one read, as many as there can be WebSockets and event streams. Further ones are refused.
const MAX_READERS: usize = 1024;

/// Values read, and reads under way, by id.
#[derive(Debug, Default)]
pub(super) struct Reads {
    known: BTreeMap<u8, (Instant, Result<Data, Rejection>)>,
    waiting: BTreeMap<u8, Vec<ResultSender<Data>>>,
    /// Whether the reads under way began before a change. Their replies are passed on but not kept.
    outdated: bool,
}

impl Reads {
    /// Forgets the values after a request that could have changed any of them.
    pub(super) fn forget(&mut self) {
        self.known.clear();
        self.outdated = !self.waiting.is_empty();
    }

    fn fresh(&self, now: Instant, id: u8) -> Option<Result<Data, Rejection>> {
        let (read_at, value) = self.known.get(&id)?;
        (now < *read_at + FRESH_FOR).then(|| value.clone())
    }

    /// Takes the result of a read. Returns the callers that wait for it.
    fn take(&mut self, now: Instant, id: u8, result: &Result<Data, Rejection>) -> Vec<ResultSender<Data>> {
        let waiting = self.waiting.remove(&id).unwrap_or_default();
        if !self.outdated && !matches!(result, Err(Rejection::Failure(_))) {
            self.known.insert(id, (now, result.clone()));
        }
        self.outdated &= !self.waiting.is_empty();
        waiting
    }

    pub(super) fn reject_all(&mut self, rejection: &Rejection) {
        for answer in std::mem::take(&mut self.waiting).into_values().flatten() {
            let _ = answer.send(Err(rejection.clone()));
        }
        self.forget();
    }
}

impl Actor {
    /// Answers with a known value, or with a read of the device.
    pub(super) fn read(&mut self, now: Now, command: Command, answer: ResultSender<Data>) {
        let id = command.id();
        if let Some(result) = self.reads.fresh(now.instant, id) {
            let _ = answer.send(result);
            return;
        }
        self.join_read(now, command, answer);
    }

    /// Answers with a value of a getter with automatic updates that the device measures now.
    pub(super) fn measure(&mut self, now: Now, id: u8, answer: ResultSender<Data>) {
        let rules = self.update_rules();
        // The getter without updates would switch them off.
        if let Some(command) = automatic_updates::switch_on(id, rules, self.link.properties.bytes_per_second) {
            self.join_read(now, command, answer);
        }
    }

    /// Waits for the read of this getter that is under way, or starts one.
    fn join_read(&mut self, now: Now, command: Command, answer: ResultSender<Data>) {
        let id = command.id();
        let waiting = self.reads.waiting.entry(id).or_default();
        if waiting.len() >= MAX_READERS {
            let _ = answer.send(Err(Failure::Overloaded { limit: MAX_READERS }.into()));
            return;
        }
        waiting.push(answer);
        if waiting.len() == 1
            && let Err(not_taken) = self.link.submit(now, command, Purpose::Read(id))
        {
            self.end_read(now, id, &Err(not_taken.0));
        }
    }

    pub(super) fn read_ended(&mut self, now: Now, id: u8, end: End) {
        let result = match end {
            End::Reply(Reply::Success(data)) => {
                // A getter with automatic updates was taken as an update.
                if !id::has_updates(id) {
                    self.observed.take(now.instant, &data);
                }
                Ok(data)
            }
            end => {
                if let End::Reply(Reply::Status(status)) = end {
                    self.observed.lose(id, Missing::Refused(status));
                }
                Err(self.rejection_of(id::name(id).unwrap_or("a getter"), end))
            }
        };
        self.end_read(now, id, &result);
    }

    fn end_read(&mut self, now: Now, id: u8, result: &Result<Data, Rejection>) {
        for answer in self.reads.take(now.instant, id, result) {
            self.answers.add(answer, result.clone());
        }
    }
}

/// Whether a command only reads a value that seldom changes.
pub(super) fn is_slow_getter(command: &Command) -> bool {
    matches!(
        command,
        Command::GetAcceleration
            | Command::GetForceLimit
            | Command::GetSoftLimits
            | Command::GetStatistics { reset: false }
            | Command::GetTemperature
            | Command::GetSystemInfo
            | Command::GetDeviceTag
            | Command::GetSystemLimits
            | Command::GetFingerInfo(_)
            | Command::GetFingerFlags(_)
    )
}
