//! Recovery after a restart: persisted values, recent requests, and records that complete a run without an orderly end.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use jiff::SignedDuration;
use rusqlite::{Connection, OptionalExtension};

use super::chain::memory_hash;
use super::identity::NO_GRIPPER;
use super::reading::commands::CommandBody;
use super::row::{milliseconds, now};
use crate::gripper::recorder::{PastRequest, UnknownPast};
use crate::model::{
    CommandEvent, CommandId, CommandReport, Detail, Done, Event, GatewayEvent, Outcome, PersistedState, Phase,
};

/// Time for which a request id stands for its command.
pub(super) const REPLAYED_FOR: SignedDuration = SignedDuration::from_mins(10);

/// Maximum number of recovered requests, the newest: more than ten minutes at 100 a second.
const MAX_REQUESTS: usize = 65_536;

/// Largest step back between two neighbouring records, in ms, that merging explains. A larger one means that the clock
/// was set back.
const SET_BACK_MS: i64 = 60_000;

/// Data of earlier runs.
#[derive(Debug, Default)]
pub struct Recovered {
    /// Persisted values of the grippers.
    pub memory: Vec<PersistedState>,
    /// Whether the last run ended without an orderly shutdown.
    pub unclean: bool,
    /// Commands that were running; each gets a record that it ended as `UNKNOWN`.
    pub running: Vec<CommandId>,
    /// Requests with an id from the last ten minutes, in the order of their admission. Refused ones are left out,
    /// because they bind nothing.
    pub requests: Vec<PastRequest>,
    /// The time without records, if the journal was restored.
    pub unknown_past: Option<Arc<UnknownPast>>,
}

/// Reads the data of earlier runs, and returns the events that complete the last one.
pub(super) fn recover(connection: &Connection) -> rusqlite::Result<(Recovered, Vec<Event>)> {
    let running = running(connection)?;
    let ids: Vec<_> = running.iter().map(|body| body.command_id).collect();
    let unclean = !ended(connection)?;
    let mut events: Vec<_> = running.into_iter().map(unknown).collect();
    if unclean {
        let event = GatewayEvent::UncleanEnd { running: ids.clone() };
        events.push(Event::new(now(), None, Detail::Gateway(event)));
    }
    let memory = memory(connection)?;
    let mut requests = requests(connection)?;
    for request in requests.iter_mut().filter(|request| ids.contains(&request.command.id)) {
        request.command = unknown_command(request.command.clone());
    }
    Ok((Recovered { memory, unclean, running: ids, requests, unknown_past: None }, events))
}

/// Reads the data of this run and of earlier ones, for grippers that are added while the gateway runs.
pub(super) fn recall(connection: &Connection) -> rusqlite::Result<Recovered> {
    let memory = memory(connection)?;
    let requests = requests(connection)?;
    Ok(Recovered { memory, requests, ..Recovered::default() })
}

/// Reads the admission records of commands without an end.
fn running(connection: &Connection) -> rusqlite::Result<Vec<CommandBody>> {
    let sql = "SELECT body FROM running JOIN events USING (seq) ORDER BY seq";
    let mut statement = connection.prepare(sql)?;
    let bodies = statement.query_map([], |row| row.get::<_, String>(0))?.collect::<Result<Vec<_>, _>>()?;
    Ok(bodies.iter().filter_map(|body| parsed(body)).collect())
}

fn parsed(body: &str) -> Option<CommandBody> {
    let parsed = serde_json::from_str(body);
    parsed.inspect_err(|error| tracing::warn!(body, %error, "damaged journal record skipped")).ok()
}

/// Ends a command as `UNKNOWN`.
fn unknown_command(running: CommandReport) -> CommandReport {
    let mut command = CommandReport { phase: Phase::Done, ..running };
    command.set_outcome(Outcome::Unknown);
    command
}

/// Makes the second record of a command that has only the first.
fn unknown(admitted: CommandBody) -> Event {
    let part_id = match &admitted.event {
        CommandEvent::Admitted(admitted) => admitted.parameters.part_id.clone(),
        CommandEvent::Done(done) => done.part_id.clone(),
    };
    let subject = Some(admitted.subject.clone());
    let door = admitted.door;
    let gripper = Some(admitted.gripper.clone());
    let id = admitted.command_id;
    let command = unknown_command(admitted.command());
    let done = CommandEvent::Done(Box::new(Done::of(&command, part_id)));
    Event { subject, door, ..Event::new(now(), gripper, Detail::Command(done)) }.of(id)
}

/// Whether the last record is an orderly end. Also true of an empty journal.
fn ended(connection: &Connection) -> rusqlite::Result<bool> {
    let sql = "SELECT kind = 'gateway' AND body ->> '$.event' = 'ended' FROM events ORDER BY seq DESC LIMIT 1";
    Ok(connection
        .query_row(sql, [], |row| row.get::<_, Option<bool>>(0))
        .optional()?
        .is_none_or(|ended| ended == Some(true)))
}

fn memory(connection: &Connection) -> rusqlite::Result<Vec<PersistedState>> {
    let mut statement =
        connection.prepare("SELECT gripper, key, value, hash FROM memory WHERE gripper <> ? ORDER BY gripper, key")?;
    let mut rows = statement.query([NO_GRIPPER])?;
    let mut persisted = Vec::new();
    while let Some(row) = rows.next()? {
        let gripper: String = row.get(0)?;
        let key: String = row.get(1)?;
        let value: String = row.get(2)?;
        let intact = row.get_ref(3)?.as_blob().is_ok_and(|hash| hash == memory_hash(&gripper, &key, &value));
        match (gripper.parse(), serde_json::from_value(key.clone().into())) {
            (Ok(gripper), Ok(key)) if intact => persisted.push(PersistedState { gripper, key, value: Some(value) }),
            _ => tracing::warn!(gripper, key, value, "damaged persisted value in the journal skipped"),
        }
    }
    Ok(persisted)
}

fn requests(connection: &Connection) -> rusqlite::Result<Vec<PastRequest>> {
    let mut statement =
        connection.prepare("SELECT body FROM events WHERE kind = 'command' AND seq >= ? ORDER BY seq")?;
    let mut rows = statement.query([first_recent(connection)?])?;
    let mut requests = Requests::default();
    while let Some(row) = rows.next()? {
        if let Some(body) = parsed(row.get_ref(0)?.as_str()?) {
            requests.take(body);
        }
    }
    Ok(requests.in_order.into_values().collect())
}

/// Returns the sequence number of the first record within [`REPLAYED_FOR`]. Neither a clock that was set back nor a step
/// ahead that was taken back adds to a record's age.
fn first_recent(connection: &Connection) -> rusqlite::Result<i64> {
    let mut statement = connection.prepare("SELECT seq, at FROM events ORDER BY seq DESC")?;
    let mut rows = statement.query([])?;
    let mut first = i64::MAX;
    let mut earliest = milliseconds(now());
    let mut age_ms = 0;
    // The time at which the clock was set back, with the age there.
    let mut set_back = None;
    while let Some(row) = rows.next()? {
        let at: i64 = row.get(1)?;
        if at > earliest + SET_BACK_MS {
            set_back.get_or_insert((earliest, age_ms));
            earliest = at;
        } else if let Some((time, age)) = set_back.take_if(|(time, _)| at <= *time + SET_BACK_MS) {
            // Before the clock was set ahead.
            (earliest, age_ms) = (at, age_ms.max(age + (time - at).max(0)));
        } else if at < earliest {
            age_ms += earliest - at;
            earliest = at;
        }
        if i128::from(age_ms) > REPLAYED_FOR.as_millis() {
            break;
        }
        first = row.get(0)?;
    }
    Ok(first)
}

/// Requests in the order of their records. Their ids and times come from a wall clock, which can jump.
#[derive(Default)]
struct Requests {
    in_order: BTreeMap<u64, PastRequest>,
    numbers: HashMap<CommandId, u64>,
    next_number: u64,
}

impl Requests {
    fn take(&mut self, body: CommandBody) {
        let id = body.command_id;
        match &body.event {
            CommandEvent::Admitted(admitted) => {
                let parameters = admitted.parameters.clone();
                let request_id = admitted.request_id.clone();
                if let Some(request_id) = request_id {
                    let request = PastRequest { request_id, parameters, command: body.command() };
                    self.in_order.insert(self.next_number, request);
                    self.numbers.insert(id, self.next_number);
                    self.next_number += 1;
                }
            }
            CommandEvent::Done(done) if done.outcome == Outcome::Refused => {
                if let Some(number) = self.numbers.remove(&id) {
                    self.in_order.remove(&number);
                }
            }
            CommandEvent::Done(_) => {
                let number = self.numbers.get(&id);
                if let Some(request) = number.and_then(|number| self.in_order.get_mut(number)) {
                    request.command = body.command();
                }
            }
        }
        if self.in_order.len() > MAX_REQUESTS
            && let Some((_, oldest)) = self.in_order.pop_first()
        {
            self.numbers.remove(&oldest.command.id);
        }
    }
}
