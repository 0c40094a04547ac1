//! The book of commands: every command of the last hour by its id, and which request became which command.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::error::Conflict;
use super::handle::Ticket;
use super::model::{Action, Command, CommandId, Outcome, Phase, RequestId, Submission};

/// How long an ended command can be asked for.
const KEPT_FOR: Duration = Duration::from_secs(3600);

/// How many commands are kept at most: at one a second, more than an hour of them.
const MAX_COMMANDS: usize = 4096;

/// How long a request id stands for its command.
const REPLAYED_FOR: Duration = Duration::from_secs(600);

#[derive(Debug, Default)]
pub(super) struct Book {
    /// In order of admission, since ids are.
    commands: BTreeMap<CommandId, Entry>,
    requests: HashMap<Key, Bound>,
}

#[derive(Debug)]
struct Entry {
    record: watch::Sender<Arc<Command>>,
    admitted_at: Instant,
    key: Option<Key>,
}

/// A request id counts for its subject alone.
type Key = (Arc<str>, RequestId);

#[derive(Debug)]
struct Bound {
    command: CommandId,
    action: Action,
    since: Instant,
}

impl Book {
    /// The command that this very request has become before, if it has.
    pub(super) fn replay(&self, now: Instant, submission: &Submission) -> Result<Option<Ticket>, Conflict> {
        let Some(key) = key(submission) else { return Ok(None) };
        let Some(bound) = self.requests.get(&key).filter(|bound| now < bound.since + REPLAYED_FOR) else {
            return Ok(None);
        };
        if bound.action != submission.action {
            return Err(Conflict::RequestIdReused);
        }
        Ok(self.find(bound.command).map(|ticket| Ticket { replayed: true, ..ticket }))
    }

    /// Enters an admitted command.
    pub(super) fn enter(&mut self, now: Instant, command: Command, submission: &Submission) -> Ticket {
        self.forget_old(now);
        let key = key(submission);
        if let Some(key) = &key {
            let bound = Bound { command: command.id, action: submission.action.clone(), since: now };
            self.requests.insert(key.clone(), bound);
        }
        let id = command.id;
        let (record, receiver) = watch::channel(Arc::new(command));
        self.commands.insert(id, Entry { record, admitted_at: now, key });
        Ticket { record: receiver, replayed: false }
    }

    pub(super) fn find(&self, id: CommandId) -> Option<Ticket> {
        self.commands.get(&id).map(|entry| Ticket { record: entry.record.subscribe(), replayed: false })
    }

    /// Ends a command. A second end of the same command does nothing.
    pub(super) fn end(
        &mut self,
        now: Instant,
        id: CommandId,
        fill_in: impl FnOnce(&mut Command),
    ) -> Option<Arc<Command>> {
        let entry = self.commands.get(&id)?;
        let mut command = Command::clone(&entry.record.borrow());
        if command.phase == Phase::Done {
            return None;
        }
        command.phase = Phase::Done;
        command.duration_ms = Some(now.saturating_duration_since(entry.admitted_at).as_millis() as u64);
        fill_in(&mut command);
        if command.outcome == Some(Outcome::Refused)
            && let Some(key) = &entry.key
        {
            // A refused request binds nothing.
            self.requests.remove(key);
        }
        let command = Arc::new(command);
        entry.record.send_replace(command.clone());
        Some(command)
    }

    fn forget_old(&mut self, now: Instant) {
        self.requests.retain(|_, bound| now < bound.since + REPLAYED_FOR);
        while let Some(first) = self.commands.first_entry() {
            let entry = first.get();
            let old = now >= entry.admitted_at + KEPT_FOR;
            let ended = entry.record.borrow().phase == Phase::Done;
            if !ended || !(old || self.commands.len() >= MAX_COMMANDS) {
                break;
            }
            self.commands.pop_first();
        }
    }
}

fn key(submission: &Submission) -> Option<Key> {
    submission.request_id.clone().map(|request_id| (submission.client.subject.clone(), request_id))
}
