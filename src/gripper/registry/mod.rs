//! The registry of commands: every command of the last hour by its id, and the command behind each request id.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::Now;
use super::handle::Ticket;
use super::last_command::LastCommand;
use super::recorder::{PastRequest, UnknownPast};
use super::request_ids::{Key, REPLAYED_FOR, RequestIds, SlotBounds};
use model::error::{Conflict, Failure};
use model::{Client, CommandId, CommandReport, Kind, Outcome, Parameters, Phase, RequestId, Submission};

/// Time for which a command can be looked up.
const KEPT_FOR: Duration = Duration::from_hours(1);

/// Most motions kept: more than an hour at one a second. The journal has the rest.
const MAX_MOTIONS: usize = 4096;

/// Most Stops kept. They are counted separately, so that a flood of Stops pushes out no motions.
const MAX_STOPS: usize = 1024;

/// Most streamed commands kept: those of the last second or two, since they are far more frequent than others.
const MAX_STREAMED: usize = 64;

/// Slots for the request ids of motions: 64 MiB in all. One subject has enough for 27 a second over ten minutes, more
/// than the pause between motions allows. A subject beyond its bound is refused, since a forgotten id would let its
/// request move the gripper twice.
const MOTION_IDS: SlotBounds = SlotBounds { per_subject: 16_384, whole: 32_768 };

/// Slots for the request ids of Stops and streamed commands: 8 MiB in all. The oldest ids are dropped first: a Stop is
/// never refused for lack of a slot, and its repetition is harmless. Streamed commands are repeated within a second.
const FREQUENT_IDS: SlotBounds = SlotBounds { per_subject: 512, whole: 4096 };

#[derive(Debug)]
pub(super) struct CommandRegistry {
    commands: HashMap<CommandId, Entry>,
    motions: History,
    stops: History,
    streamed: History,
    motion_ids: RequestIds,
    frequent_ids: RequestIds,
    /// The newest motion.
    pub last: LastCommand,
    /// The time without records, if the journal was restored.
    pub unknown_past: Option<Arc<UnknownPast>>,
    /// Ended commands whose clients have not been notified yet.
    unnotified: Vec<Arc<CommandReport>>,
}

#[derive(Debug)]
struct Entry {
    record: watch::Sender<Arc<CommandReport>>,
    client: Client,
    admitted_at: Instant,
    key: Option<Key>,
}

/// Commands of one sort in the order of their admission, the oldest first.
#[derive(Debug)]
struct History {
    ids: VecDeque<CommandId>,
    limit: usize,
}

impl History {
    fn of(limit: usize) -> Self {
        Self { ids: VecDeque::new(), limit }
    }

    /// Forgets commands beyond the age or the limit, but never a running one.
    fn forget_old(&mut self, now: Instant, commands: &mut HashMap<CommandId, Entry>) {
        for _ in 0..self.ids.len() {
            let Some(id) = self.ids.front().copied() else { return };
            let entry = commands.get(&id);
            if entry.is_some_and(|entry| entry.record.borrow().phase == Phase::Running) {
                // Few entries: one motion runs at a time, and few Stops.
                self.ids.rotate_left(1);
            } else if entry.is_none_or(|entry| now >= entry.admitted_at + KEPT_FOR) || self.ids.len() >= self.limit {
                self.ids.pop_front();
                commands.remove(&id);
            } else {
                return;
            }
        }
    }
}

impl Default for CommandRegistry {
    fn default() -> Self {
        Self {
            commands: HashMap::new(),
            motions: History::of(MAX_MOTIONS),
            stops: History::of(MAX_STOPS),
            streamed: History::of(MAX_STREAMED),
            motion_ids: RequestIds::new(MOTION_IDS),
            frequent_ids: RequestIds::new(FREQUENT_IDS),
            last: LastCommand::default(),
            unknown_past: None,
            unnotified: Vec::new(),
        }
    }
}

impl CommandRegistry {
    /// The earlier command of this request, if the request is a repetition.
    pub(super) fn replay(&self, now: Instant, submission: &Submission) -> Result<Option<Ticket>, Conflict> {
        let Some(key) = key(submission) else { return Ok(None) };
        let found = self.motion_ids.find(now, &key).or_else(|| self.frequent_ids.find(now, &key));
        match found {
            Some((was_asked, ticket)) if is_repetition(was_asked, &asked(submission)) => {
                Ok(Some(Ticket { replayed: true, ..ticket.clone() }))
            }
            Some(_) => Err(Conflict::RequestIdReused),
            None => Ok(None),
        }
    }

    /// Checks that the request id of a motion can be stored.
    pub(super) fn check_room(&mut self, now: Instant, submission: &Submission) -> Result<(), Failure> {
        self.motion_ids.forget_old(now);
        let has_room = submission.request_id.is_none() || self.motion_ids.has_room(&submission.client.subject);
        let limit = self.motion_ids.per_subject();
        if has_room { Ok(()) } else { Err(Failure::RequestIds { limit }) }
    }

    /// Refuses a request id that may belong to a request of a time without records. The request is not a repetition of a
    /// known one.
    pub(super) fn check_past(&self, now: Instant, submission: &Submission) -> Result<(), Conflict> {
        let is_unknown = self.unknown_past.as_ref().is_some_and(|past| past.refuses_ids(now));
        if is_unknown && submission.request_id.is_some() { Err(Conflict::UnknownPast) } else { Ok(()) }
    }

    /// Adds an admitted command. Few streamed commands are kept.
    pub(super) fn enter(
        &mut self,
        now: Instant,
        mut command: CommandReport,
        submission: &Submission,
        is_streamed: bool,
    ) -> Ticket {
        self.forget_old(now);
        let key = key(submission);
        let id = command.id;
        let kind = command.kind;
        if kind != Kind::Stop && !is_streamed {
            command.number = Some(self.last.admitted(id));
        }
        let (record, receiver) = watch::channel(Arc::new(command));
        let ticket = Ticket { record: receiver, replayed: false, _keep: None };
        if let Some(key) = key.clone() {
            self.ids_of(kind, is_streamed).bind(now, key, asked(submission), ticket.clone());
        }
        let history = match kind {
            _ if is_streamed => &mut self.streamed,
            Kind::Stop => &mut self.stops,
            _ => &mut self.motions,
        };
        history.ids.push_back(id);
        self.commands.insert(id, Entry { record, client: submission.client.clone(), admitted_at: now, key });
        ticket
    }

    pub(super) fn is_streamed(&self, id: CommandId) -> bool {
        self.streamed.ids.contains(&id)
    }

    pub(super) fn client(&self, id: CommandId) -> Option<Client> {
        self.commands.get(&id).map(|entry| entry.client.clone())
    }

    pub(super) fn find(&self, id: CommandId) -> Option<Ticket> {
        self.commands.get(&id).map(|entry| Ticket { record: entry.record.subscribe(), replayed: false, _keep: None })
    }

    /// The command of a client's request id, while the id is valid.
    pub(super) fn find_request(&self, now: Instant, subject: &Arc<str>, request_id: &RequestId) -> Option<Ticket> {
        let key = (subject.clone(), request_id.clone());
        let (_, ticket) = self.motion_ids.find(now, &key).or_else(|| self.frequent_ids.find(now, &key))?;
        Some(ticket.watched())
    }

    /// Ends a command. [`CommandRegistry::notify`] sends the end to its clients. A second end of the same command does nothing.
    pub(super) fn end(
        &mut self,
        now: Instant,
        id: CommandId,
        fill_in: impl FnOnce(&mut CommandReport),
    ) -> Option<(Client, Arc<CommandReport>)> {
        let entry = self.commands.get(&id)?;
        let mut command = CommandReport::clone(&entry.record.borrow());
        if command.phase == Phase::Done || self.unnotified.iter().any(|ended| ended.id == id) {
            return None;
        }
        command.phase = Phase::Done;
        command.duration_ms = Some(now.saturating_duration_since(entry.admitted_at).as_millis() as u64);
        fill_in(&mut command);
        self.last.ended(id, command.outcome);
        if let Some(key) = &entry.key {
            self.motion_ids.ended(key, &command);
            self.frequent_ids.ended(key, &command);
        }
        let command = Arc::new(command);
        self.unnotified.push(command.clone());
        Some((entry.client.clone(), command))
    }

    /// Restores a request id of an earlier run of the gateway.
    pub(super) fn bind_again(&mut self, now: Now, request: PastRequest) {
        let PastRequest { request_id, parameters, command } = request;
        // If the wall clock was set back, the age counts as 0.
        let age = Duration::try_from(now.wall.duration_since(command.started_at)).unwrap_or_default();
        let Some(since) = now.instant.checked_sub(age).filter(|_| age < REPLAYED_FOR) else { return };
        if command.outcome == Some(Outcome::Refused) {
            return;
        }
        let key = (command.client.clone(), request_id);
        let asked = (command.kind, parameters);
        let number = self.last.number_of(command.id);
        let ids = self.ids_of(command.kind, false);
        let command = Arc::new(CommandReport { recorded: true, number, ..command });
        ids.bind(since, key, asked, Ticket { record: watch::channel(command).1, replayed: false, _keep: None });
    }

    /// Notifies clients that the device has accepted a command.
    pub(super) fn accepted(&self, id: CommandId) {
        if let Some(entry) = self.commands.get(&id) {
            entry.record.send_modify(|command| Arc::make_mut(command).accepted = true);
        }
    }

    /// Lets clients learn of a command, because its record is durable or no longer awaited.
    pub(super) fn recorded(&mut self, id: CommandId) {
        if let Some(entry) = self.commands.get(&id) {
            entry.record.send_modify(|command| Arc::make_mut(command).recorded = true);
        }
    }

    /// Notifies clients of ended commands. Has to be called after the state was published, so that a client's next read
    /// returns no state from before the end.
    pub(super) fn notify(&mut self) {
        let unnotified = std::mem::take(&mut self.unnotified);
        for command in unnotified {
            match self.commands.get(&command.id) {
                Some(entry) if entry.record.borrow().recorded => {
                    entry
                        .record
                        .send_replace(Arc::new(CommandReport { recorded: true, ..CommandReport::clone(&command) }));
                }
                Some(_) => self.unnotified.push(command),
                None => {}
            }
        }
    }

    fn ids_of(&mut self, kind: Kind, is_streamed: bool) -> &mut RequestIds {
        if is_streamed || kind == Kind::Stop { &mut self.frequent_ids } else { &mut self.motion_ids }
    }

    fn forget_old(&mut self, now: Instant) {
        self.motion_ids.forget_old(now);
        self.frequent_ids.forget_old(now);
        for history in [&mut self.motions, &mut self.stops, &mut self.streamed] {
            history.forget_old(now, &mut self.commands);
        }
    }
}

fn asked(submission: &Submission) -> (Kind, Parameters) {
    (submission.action.kind(), Parameters::from(&submission.action))
}

/// Whether a request repeats an earlier one. The values of its recipe can have changed in between.
fn is_repetition(earlier: &(Kind, Parameters), now: &(Kind, Parameters)) -> bool {
    let [one, other] = [earlier, now].map(|(_, parameters)| &parameters.recipe);
    let has_changed = one.recipe.is_some() && one.recipe == other.recipe && one.recipe_version != other.recipe_version;
    earlier == now || has_changed && earlier.0 == now.0 && earlier.1.part_id == now.1.part_id
}

fn key(submission: &Submission) -> Option<Key> {
    submission.request_id.clone().map(|request_id| (submission.client.subject.clone(), request_id))
}

#[cfg(test)]
mod tests;
