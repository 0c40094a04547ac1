//! Requests that clients repeat without effect: recorded once, then counted per second, so that a flood of requests
//! does not fill the disk.

use std::time::{Duration, Instant};

use super::Recording;
use crate::Now;
use crate::actor::Actor;
use crate::handle::Ticket;
use model::error::{Failure, Rejection};
use model::{Client, CommandId, Detail, Event, FastStopEvent, Outcome, Submission};

/// Time for which repeated requests are counted.
const COUNTED_FOR: Duration = Duration::from_secs(1);

/// Clients distinguished within that time. FAST STOPs of further clients are counted together, and their Stops count as
/// new.
const MAX_CLIENTS: usize = 16;

/// Requests that were recorded within the last second.
#[derive(Debug, Default)]
pub(in crate::actor) struct Repeats {
    fast_stops: Option<FastStops>,
    /// Stops that had nothing to stop, and the time until which another Stop of the same client counts as a repetition.
    stops: Vec<(Instant, Client, CommandId)>,
}

/// FAST STOPs within one second.
#[derive(Debug)]
struct FastStops {
    until: Instant,
    /// Clients whose first FAST STOP was recorded.
    clients: Vec<Client>,
    /// Number of FAST STOPs since then, the newest one, and its confirmation by the device's flags.
    more: u64,
    newest: Option<Event>,
    confirmed: Option<Event>,
}

impl Repeats {
    /// Takes the event of a requested FAST STOP. Returns it if it has to be recorded now; otherwise it is counted.
    fn fast_stop(&mut self, now: Instant, client: &Client, event: Event) -> Option<Event> {
        let opened =
            || FastStops { until: now + COUNTED_FOR, clients: Vec::new(), more: 0, newest: None, confirmed: None };
        let second = self.fast_stops.get_or_insert_with(opened);
        if second.clients.len() < MAX_CLIENTS && !second.clients.contains(client) {
            second.clients.push(client.clone());
            return Some(event);
        }
        second.more += 1;
        second.newest = Some(event);
        second.confirmed = None;
        None
    }

    /// Takes any other FAST STOP event. Returns it, unless it has to wait for the counted ones to be recorded first.
    fn behind_fast_stops(&mut self, event: Event) -> Option<Event> {
        match &mut self.fast_stops {
            Some(second) if second.newest.is_some() => {
                second.confirmed = Some(event);
                None
            }
            _ => Some(event),
        }
    }

    fn stop(&mut self, now: Instant, client: &Client) -> Option<CommandId> {
        self.stops.retain(|(until, ..)| now < *until);
        self.stops.iter().find(|(_, stopper, _)| stopper == client).map(|(.., id)| *id)
    }

    pub(in crate::actor) fn next_timeout(&self) -> Option<Instant> {
        self.fast_stops.as_ref().map(|second| second.until)
    }
}

impl Recording {
    /// Records a FAST STOP event now, or together with the counted ones.
    pub(super) fn record_or_count(&mut self, now: Now, event: Event, by: Option<&Client>) {
        let event = match by {
            Some(client) => self.repeats.fast_stop(now.instant, client, event),
            None => self.repeats.behind_fast_stops(event),
        };
        if let Some(event) = event {
            self.record(event);
        }
    }

    /// Records the counted FAST STOPs: the newest, with the count.
    pub(in crate::actor) fn record_repeats(&mut self) {
        let Some(FastStops { more, newest, confirmed, .. }) = self.repeats.fast_stops.take() else { return };
        if let Some(Event { detail: Detail::FastStop(fast_stop), .. }) = &newest {
            let detail = Detail::FastStop(FastStopEvent { count: more, ..fast_stop.clone() });
            for event in newest.map(|newest| Event { detail, ..newest }).into_iter().chain(confirmed) {
                self.record(event);
            }
        }
    }
}

impl Actor {
    /// An earlier Stop of the same client within a second, while there is nothing to stop.
    pub(in crate::actor) fn repeated_stop(&mut self, now: Now, submission: &Submission) -> Option<Ticket> {
        if submission.request_id.is_some() || self.check_link().is_err() || self.is_moving(now.instant) {
            return None;
        }
        let ticket = self.commands.find(self.recording.repeats.stop(now.instant, &submission.client)?)?;
        let may_succeed = matches!(ticket.now().outcome, None | Some(Outcome::Success));
        may_succeed.then_some(Ticket { replayed: true, ..ticket })
    }

    /// For a Stop that found the queue full, the newest pending Stop, which stops the fingers as well.
    pub(in crate::actor) fn join_stop(&mut self, now: Now, not_taken: Rejection) -> Result<Ticket, Rejection> {
        let is_full = matches!(not_taken, Rejection::Failure(Failure::Overloaded { .. }));
        let ticket =
            self.link.newest_stop().filter(|_| is_full).and_then(|id| self.commands.find(id)).ok_or(not_taken)?;
        self.withdraw_waiting_motion(now);
        Ok(Ticket { replayed: true, ..ticket })
    }

    /// Notes an admitted Stop that had nothing to stop.
    pub(in crate::actor) fn note_stop(&mut self, now: Now, client: &Client, id: CommandId) {
        let stops = &mut self.recording.repeats.stops;
        if stops.len() < MAX_CLIENTS {
            stops.push((now.instant + COUNTED_FOR, client.clone(), id));
        }
    }
}
