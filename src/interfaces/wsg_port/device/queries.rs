//! Queries and automatic updates of one client.
//!
//! They are served from the newest state. Only a query that follows a change of the same client asks the device if no
//! value has arrived since: a client must see the effect of its own change.

use std::time::Instant;

use super::super::values::{tells_fast_stop, value};
use super::{PortOrder, VirtualDevice};
use crate::model::{Link, State};
use crate::wsg::{Command, Data, Reply, Status, SystemState, Updates, id};

/// Number of unread frames from which automatic updates are skipped, since the next update is newer.
pub(super) const MAX_FRAMES_BEFORE_UPDATES: usize = 16;

impl VirtualDevice {
    /// Takes a query. Switching updates on is answered, too, since some clients wait for the reply.
    pub(super) fn query(&mut self, now: Instant, id: u8, updates: Updates, state: &State) {
        let updates = match updates {
            Updates::Off => Updates::Off,
            Updates::On { on_change, period_ms } => {
                Updates::On { on_change, period_ms: period_ms.max(self.shortest_period_ms) }
            }
        };
        match self.measurement(now, id, state) {
            Some(getter) => {
                self.measured_updates = updates;
                self.order(id, true, PortOrder::Exchange(getter));
            }
            None => self.answer_query(now, id, updates, state),
        }
    }

    /// The request that measures a value again, if the known one is older than the client's last change.
    fn measurement(&self, now: Instant, id: u8, state: &State) -> Option<Command> {
        let changed_at = self.changed_at?;
        // Without a reference, the flags say that the width is 0.
        let is_unreferenced = state.values.has(SystemState::REFERENCED, now) == Some(false);
        let getter = if id == id::GET_WIDTH && is_unreferenced { id::GET_SYSTEM_STATE } else { id };
        let is_known = state.link == Link::Connected && value(getter, state, now, self.has_failed).is_some();
        if !is_known || state.values.is_newer_than(getter, changed_at) {
            return None;
        }
        Command::query(getter, Updates::Off)
    }

    /// Answers the query whose value was measured.
    pub(super) fn measured(&mut self, now: Instant, id: u8, state: &State) {
        self.answer_query(now, id, self.measured_updates, state);
    }

    fn answer_query(&mut self, now: Instant, id: u8, updates: Updates, state: &State) {
        let data = value(id, state, now, self.has_failed);
        self.subscriptions.set(id, updates, data.clone(), now);
        match data {
            Some(data) => {
                self.note_shown(&data, state);
                self.reply(id, &Reply::Success(data));
            }
            None if matches!(state.link, Link::Connected | Link::Unresponsive) => {
                self.status(id, Status::E_NOT_AVAILABLE);
            }
            None => self.status(id, Status::E_IO_ERROR),
        }
    }

    pub(super) fn send_updates(&mut self, now: Instant, state: &State) {
        let can_report = self.can_report();
        let has_failed = self.has_failed;
        let due = self.subscriptions.take_due(now, can_report, |id| value(id, state, now, has_failed));
        for (id, data) in due.into_iter().filter(|_| can_report) {
            self.note_shown(&data, state);
            self.send(id, &Reply::Success(data));
        }
    }

    /// Time of the next automatic update.
    pub(super) fn next_update(&self, now: Instant, state: &State) -> Option<Instant> {
        self.subscriptions.due(self.can_report(), |id| value(id, state, now, self.has_failed))
    }

    /// Whether the client reads fast enough for updates.
    fn can_report(&self) -> bool {
        self.frames.len() < MAX_FRAMES_BEFORE_UPDATES
    }

    /// Notes the FAST STOP that a value shows to the client.
    fn note_shown(&mut self, data: &Data, state: &State) {
        if let Some(latch) = state.latch.as_ref().filter(|_| tells_fast_stop(data)) {
            self.acknowledges.saw(latch.fast_stop_id);
        }
    }
}
