//! The book of commands: every command of the last hour by its id, and which request became which command.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::Now;
use super::error::{Conflict, Failure};
use super::handle::Ticket;
use super::model::{Client, Command, CommandId, Kind, Outcome, Parameters, Phase, RequestId, Submission};
use super::recorder::PastRequest;

/// How long an ended command can be asked for.
const KEPT_FOR: Duration = Duration::from_hours(1);

/// How many commands are kept at most: at one a second, more than an hour of them.
const MAX_COMMANDS: usize = 4096;

/// How many commands of streams are kept: those of the last second or two, of which there are many more than of others.
const MAX_STREAMED: usize = 64;

/// How long a request id stands for its command.
const REPLAYED_FOR: Duration = Duration::from_mins(10);

/// How many request ids are remembered at most: a hundred a second. Beyond, new ones are refused, since to forget one
/// would let its request move the gripper twice.
const MAX_REQUEST_IDS: usize = 65_536;

#[derive(Debug, Default)]
pub(super) struct Book {
    /// In order of admission, since ids are.
    commands: BTreeMap<CommandId, Entry>,
    /// Those of streams, the oldest first.
    streamed: VecDeque<CommandId>,
    requests: HashMap<Key, Bound>,
    /// When each request id was bound, the oldest first.
    bound: VecDeque<(Instant, Key)>,
    /// The commands that have ended, and whose clients have not been told.
    untold: Vec<Arc<Command>>,
}

#[derive(Debug)]
struct Entry {
    record: watch::Sender<Arc<Command>>,
    client: Client,
    admitted_at: Instant,
    key: Option<Key>,
}

/// A request id counts for its subject alone.
type Key = (Arc<str>, RequestId);

#[derive(Debug)]
struct Bound {
    /// Outlives the command's place in the book.
    ticket: Ticket,
    asked: (Kind, Parameters),
    since: Instant,
}

impl Book {
    /// The command that this very request has become before, if it has.
    pub(super) fn replay(&self, now: Instant, submission: &Submission) -> Result<Option<Ticket>, Conflict> {
        let Some(key) = key(submission) else { return Ok(None) };
        let Some(bound) = self.requests.get(&key).filter(|bound| now < bound.since + REPLAYED_FOR) else {
            return Ok(None);
        };
        if bound.asked != asked(submission) {
            return Err(Conflict::RequestIdReused);
        }
        Ok(Some(Ticket { replayed: true, ..bound.ticket.clone() }))
    }

    /// Whether a request with an id of its own can be remembered.
    pub(super) fn check_room(&mut self, now: Instant, submission: &Submission) -> Result<(), Failure> {
        self.forget_old(now);
        if submission.request_id.is_some() && self.bound.len() >= MAX_REQUEST_IDS {
            return Err(Failure::Overloaded { limit: MAX_REQUEST_IDS });
        }
        Ok(())
    }

    /// Enters an admitted command.
    pub(super) fn enter(&mut self, now: Instant, command: Command, submission: &Submission) -> Ticket {
        let key = key(submission);
        let id = command.id;
        let (record, receiver) = watch::channel(Arc::new(command));
        let ticket = Ticket { record: receiver, replayed: false, _keep: None };
        if let Some(key) = &key {
            let bound = Bound { ticket: ticket.clone(), asked: asked(submission), since: now };
            self.requests.insert(key.clone(), bound);
            self.bound.push_back((now, key.clone()));
        }
        self.commands.insert(id, Entry { record, client: submission.client.clone(), admitted_at: now, key });
        ticket
    }

    /// Keeps this command for as long as there are not many like it.
    pub(super) fn keep_few(&mut self, id: CommandId) {
        self.streamed.push_back(id);
        if self.streamed.len() > MAX_STREAMED
            && let Some(oldest) = self.streamed.pop_front()
        {
            self.commands.remove(&oldest);
        }
    }

    /// Whether it is one of those.
    pub(super) fn is_streamed(&self, id: CommandId) -> bool {
        self.streamed.contains(&id)
    }

    /// Who asked for a command.
    pub(super) fn client(&self, id: CommandId) -> Option<Client> {
        self.commands.get(&id).map(|entry| entry.client.clone())
    }

    pub(super) fn find(&self, id: CommandId) -> Option<Ticket> {
        self.commands.get(&id).map(|entry| Ticket { record: entry.record.subscribe(), replayed: false, _keep: None })
    }

    /// Ends a command, which [`Book::tell`] tells its clients. A second end of the same command does nothing.
    pub(super) fn end(
        &mut self,
        now: Instant,
        id: CommandId,
        fill_in: impl FnOnce(&mut Command),
    ) -> Option<(Client, Arc<Command>)> {
        let entry = self.commands.get(&id)?;
        let mut command = Command::clone(&entry.record.borrow());
        if command.phase == Phase::Done || self.untold.iter().any(|ended| ended.id == id) {
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
        self.untold.push(command.clone());
        Some((entry.client.clone(), command))
    }

    /// Takes in a request of an earlier run of the gateway.
    pub(super) fn bind_again(&mut self, now: Now, request: PastRequest) {
        let PastRequest { request_id, parameters, command } = request;
        // A clock that was set back makes it no younger than now.
        let age = Duration::try_from(now.wall.duration_since(command.started_at)).unwrap_or_default();
        let Some(since) = now.instant.checked_sub(age).filter(|_| age < REPLAYED_FOR) else { return };
        if command.outcome == Some(Outcome::Refused) {
            return;
        }
        let (key, asked) = ((command.client.clone(), request_id), (command.kind, parameters));
        let command = Arc::new(Command { recorded: true, ..command });
        let ticket = Ticket { record: watch::channel(command).1, replayed: false, _keep: None };
        self.requests.insert(key.clone(), Bound { ticket, asked, since });
        self.bound.push_back((since, key));
    }

    /// The device has accepted a command: its clients are told at once.
    pub(super) fn accepted(&self, id: CommandId) {
        if let Some(entry) = self.commands.get(&id) {
            entry.record.send_modify(|command| Arc::make_mut(command).accepted = true);
        }
    }

    /// A command's record is durable, or is not waited for any longer: its client may be told of it.
    pub(super) fn recorded(&mut self, id: CommandId) {
        if let Some(entry) = self.commands.get(&id) {
            entry.record.send_modify(|command| Arc::make_mut(command).recorded = true);
        }
    }

    /// Tells clients of the commands that have ended: after the state was published, so that who reads it next reads
    /// none of before the end.
    pub(super) fn tell(&mut self) {
        let untold = std::mem::take(&mut self.untold);
        for command in untold {
            match self.commands.get(&command.id) {
                Some(entry) if entry.record.borrow().recorded => {
                    entry.record.send_replace(Arc::new(Command { recorded: true, ..Command::clone(&command) }));
                }
                Some(_) => self.untold.push(command),
                None => {}
            }
        }
    }

    fn forget_old(&mut self, now: Instant) {
        while let Some((since, key)) = self.bound.pop_front_if(|(since, _)| now >= *since + REPLAYED_FOR) {
            // Refused and asked for again, it is bound anew.
            if self.requests.get(&key).is_some_and(|bound| bound.since == since) {
                self.requests.remove(&key);
            }
        }
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

fn asked(submission: &Submission) -> (Kind, Parameters) {
    (submission.action.kind(), Parameters::from(&submission.action))
}

fn key(submission: &Submission) -> Option<Key> {
    submission.request_id.clone().map(|request_id| (submission.client.subject.clone(), request_id))
}

#[cfg(test)]
mod tests {
    use jiff::Timestamp;

    use super::super::model::{Action, Client, Door, IdSource};
    use super::*;

    fn submission(request_id: Option<&str>) -> Submission {
        let client = Client { subject: "test".into(), door: Door::Http };
        let request_id = request_id.and_then(RequestId::new);
        Submission { client, action: Action::Stop, request_id, lease: None }
    }

    /// Ids in order of admission.
    #[derive(Default)]
    struct Ids(i64);

    fn command(ids: &mut Ids, submission: &Submission) -> Command {
        ids.0 += 1;
        let id = IdSource::new(1).command_id(Timestamp::from_millisecond(ids.0).unwrap());
        Command::admitted(id, "g".parse().unwrap(), submission, Timestamp::UNIX_EPOCH)
    }

    fn enter(book: &mut Book, now: Instant, ids: &mut Ids, request_id: Option<&str>) -> CommandId {
        let submission = submission(request_id);
        book.check_room(now, &submission).unwrap();
        let ticket = book.enter(now, command(ids, &submission), &submission);
        let id = ticket.now().id;
        book.recorded(id);
        book.end(now, id, |command| command.outcome = Some(Outcome::Success));
        book.tell();
        id
    }

    #[test]
    fn a_request_id_outlives_its_commands_place_in_the_book() {
        let (mut book, mut ids, start) = (Book::default(), Ids::default(), Instant::now());
        let first = enter(&mut book, start, &mut ids, Some("r1"));
        for _ in 0..=MAX_COMMANDS {
            enter(&mut book, start, &mut ids, None);
        }
        assert!(book.find(first).is_none() && book.commands.len() <= MAX_COMMANDS);
        let replayed = book.replay(start + REPLAYED_FOR / 2, &submission(Some("r1"))).unwrap().unwrap().now();
        assert_eq!((replayed.id, replayed.replayed), (first, true));
        assert!(book.replay(start + REPLAYED_FOR, &submission(Some("r1"))).unwrap().is_none());
    }

    #[test]
    fn request_ids_are_bounded_and_none_is_forgotten_early() {
        let (mut book, mut ids, start) = (Book::default(), Ids::default(), Instant::now());
        for number in 0..MAX_REQUEST_IDS {
            enter(&mut book, start, &mut ids, Some(&number.to_string()));
        }
        let one_more = submission(Some("one more"));
        assert_eq!(book.check_room(start, &one_more), Err(Failure::Overloaded { limit: MAX_REQUEST_IDS }));
        assert!(book.check_room(start, &submission(None)).is_ok());
        assert!(book.replay(start, &submission(Some("0"))).unwrap().is_some());
        assert!(book.check_room(start + REPLAYED_FOR, &one_more).is_ok());
        assert!(book.requests.is_empty() && book.bound.is_empty());
    }
}
