//! Live updates for many subscribers at once, the same over server-sent events and WebSocket.
//!
//! The first subscription to send an update serialises it, and all share its bytes. States and telemetry are not
//! queued: each subscriber gets the newest when it has room. Events and frames come one by one; a subscriber that is
//! too far behind misses some, and a `gap` says how many.

mod fleet;
mod notification;
mod pace;
mod queued;

use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use futures_util::stream::{BoxStream, SelectAll};
use futures_util::{FutureExt as _, StreamExt as _};
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use tokio::sync::watch;
use tokio::task::coop::unconstrained;
use utoipa::ToSchema;

use crate::alarms::Alarms;
use crate::fleet::Peers;
use crate::gripper::{GripperChanges, Grippers, Handle, Now};
use crate::journal::{Journal, Stored};
use crate::model::{Name, State, WireRecord};
use fleet::FleetNews;
use notification::Recent;
use queued::EventPosition;

pub use notification::{Notification, encoded, text_frame};
pub use pace::Pace;
pub use queued::Gap;

/// Topic of a subscription.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    ToSchema,
    EnumMessage,
    VariantArray,
)]
#[serde(rename_all = "lowercase")]
pub enum Topic {
    /// Newest state of each gripper.
    State,
    /// Newest measured values of each gripper.
    Telemetry,
    /// Every event, once it is durable in the journal.
    Events,
    /// Every grip record, once it is durable, and again when its part was lost.
    Grips,
    /// Every frame to and from a device, and damaged bytes from it.
    Frames,
    /// Every frame to and from a device, without its automatic updates.
    Exchanges,
    /// Newest state of each gripper of all gateways.
    Fleet,
    /// All alarms that are active or not acknowledged.
    Alarms,
}

/// Rate of states and telemetry in Hz, unless a client asks for more or less.
pub const DEFAULT_HZ: u64 = 10;

/// Highest rate in Hz, which is that of the devices.
pub const MAX_HZ: u64 = 100;

/// Time after which the next tick repeats an unchanged state, so that its subscriber notices a gateway that has gone
/// silent. It is a little less than one second, so that ticks at 1 Hz repeat the state each time.
const HEARTBEAT: Duration = Duration::from_millis(900);

/// Serialised events that are kept for slower subscriptions.
const RECENT_EVENTS: usize = 64;

/// Serialised frames that are kept of each gripper.
const RECENT_FRAMES: usize = 64;

/// The sources of all topics.
#[derive(Debug)]
pub struct LiveUpdates {
    journal: Journal,
    events: Recent,
    grippers: Grippers,
    sources: Mutex<Vec<Arc<Source>>>,
    fleet: FleetNews,
    alarms: Arc<Alarms>,
    alarm_lists: Recent,
}

/// The updates of one gripper.
#[derive(Debug)]
struct Source {
    handle: Handle,
    state: Recent,
    telemetry: Recent,
    frames: Recent,
}

impl LiveUpdates {
    /// Collects the updates of this gateway's grippers, of the journal, of the fleet's grippers, and of the alarms.
    #[must_use]
    pub fn new(grippers: Grippers, journal: Journal, network: Arc<Peers>, alarms: Arc<Alarms>) -> Self {
        let events = Recent::new(RECENT_EVENTS);
        let fleet = FleetNews::new(network);
        Self { journal, events, grippers, sources: Mutex::default(), fleet, alarms, alarm_lists: Recent::new(1) }
    }

    /// Subscribes to topics of some grippers from now on, or of all with `None`. Only a subscription to all grippers
    /// gets the events that concern no gripper. The fleet is always sent whole.
    #[must_use]
    pub fn subscribe(
        self: &Arc<Self>,
        grippers: Option<&BTreeSet<Name>>,
        topics: impl IntoIterator<Item = Topic>,
    ) -> Subscription {
        let topics: BTreeSet<_> = topics.into_iter().collect();
        let mut queued: SelectAll<BoxStream<'static, Notification>> = SelectAll::new();
        let mut event_position = None;
        if topics.contains(&Topic::Events) {
            let (events, position) = queued::events(self.clone(), grippers.cloned());
            queued.push(events.boxed());
            event_position = Some(position);
        }
        if topics.contains(&Topic::Grips) {
            queued.push(queued::grips(self, grippers.cloned()).boxed());
        }
        let mut subscription = Subscription {
            updates: self.clone(),
            only: grippers.cloned(),
            changes: self.grippers.changes(),
            watched: Vec::new(),
            fleet_seq: 0,
            alarms_seq: None,
            event_position,
            topics,
            queued,
            frames: SelectAll::new(),
        };
        subscription.watch_grippers();
        subscription
    }

    /// Returns the updates of the current grippers.
    fn sources(&self) -> Vec<Arc<Source>> {
        let mut sources = self.sources.lock().unwrap_or_else(PoisonError::into_inner);
        let mut current = Vec::new();
        for handle in self.grippers.all() {
            let known = sources.iter().find(|source| source.handle.is_same(&handle)).cloned();
            current.push(known.unwrap_or_else(|| Arc::new(Source::new(handle))));
        }
        *sources = current;
        sources.clone()
    }

    /// Returns all alarms if they have changed since change `seq`, and advances `seq`.
    fn alarms_since(&self, seq: &mut Option<u64>) -> Option<Notification> {
        if *seq == Some(self.alarms.changes()) {
            return None;
        }
        let (changes, alarms) = self.alarms.read();
        *seq = Some(changes);
        self.alarm_lists.get(changes, || Notification::new("alarms", &alarms))
    }

    fn event(&self, event: &Stored) -> Option<Notification> {
        self.events.get(event.seq.unsigned_abs(), || Some(Notification::of_json("event", &event.body)))
    }
}

impl Source {
    fn new(handle: Handle) -> Self {
        Self { handle, state: Recent::new(1), telemetry: Recent::new(1), frames: Recent::new(RECENT_FRAMES) }
    }

    fn state(&self, state: &State) -> Option<Notification> {
        self.state.get(state.update, || Notification::new("state", state))
    }

    fn telemetry(&self, state: &State) -> Option<Notification> {
        self.telemetry.get(state.update, || Notification::telemetry(state))
    }

    fn frame(&self, record: &WireRecord) -> Option<Notification> {
        self.frames.get(record.seq(), || match record {
            WireRecord::Frame(frame) => Notification::new("frame", frame),
            WireRecord::Damage(damage) => Notification::new("damage", damage),
        })
    }
}

/// A gripper with a subscribed state.
#[derive(Debug)]
struct Watched {
    source: Arc<Source>,
    states: watch::Receiver<Arc<State>>,
    /// Number of the state that was sent last.
    seq: u64,
    /// Time at which the newest state was sent.
    sent_at: Option<Instant>,
}

/// The topics and grippers of one client.
pub struct Subscription {
    updates: Arc<LiveUpdates>,
    /// Names of the grippers; all if `None`.
    only: Option<BTreeSet<Name>>,
    changes: GripperChanges,
    watched: Vec<Watched>,
    /// Number of the fleet's change that was sent last.
    fleet_seq: u64,
    /// Number of the alarms' change that was sent last.
    alarms_seq: Option<u64>,
    /// Position in the events, if they are subscribed to.
    event_position: Option<EventPosition>,
    topics: BTreeSet<Topic>,
    /// Events and grip records.
    queued: SelectAll<BoxStream<'static, Notification>>,
    frames: SelectAll<BoxStream<'static, Notification>>,
}

impl Subscription {
    /// Whether [`Subscription::newest`] can ever return an update.
    #[must_use]
    pub fn has_states(&self) -> bool {
        let has_own = self.topics.contains(&Topic::State) || self.topics.contains(&Topic::Telemetry);
        has_own || self.topics.contains(&Topic::Fleet) || self.topics.contains(&Topic::Alarms)
    }

    /// Takes the grippers of this moment: new ones join the subscription, and removed ones leave it.
    fn watch_grippers(&mut self) {
        let only = self.only.as_ref();
        let mut sources = self.updates.sources();
        sources.retain(|source| only.is_none_or(|names| names.contains(source.handle.name())));
        self.watched.retain(|watched| sources.iter().any(|source| Arc::ptr_eq(source, &watched.source)));
        for source in sources {
            if self.watched.iter().any(|watched| Arc::ptr_eq(&source, &watched.source)) {
                continue;
            }
            let has_updates = self.topics.contains(&Topic::Frames);
            if has_updates || self.topics.contains(&Topic::Exchanges) {
                self.frames.push(queued::frames(source.clone(), has_updates).boxed());
            }
            self.watched.push(Watched { states: source.handle.states(), source, seq: 0, sent_at: None });
        }
    }

    /// Returns the current states, which count as sent.
    pub fn snapshot(&mut self) -> Vec<Arc<State>> {
        let now = Now::read().instant;
        let mut states = Vec::new();
        for watched in &mut self.watched {
            watched.states.mark_unchanged();
            let state = watched.source.handle.state();
            watched.seq = state.seq;
            watched.sent_at = Some(now);
            states.push(state);
        }
        states
    }

    /// Returns the states, telemetry, fleet grippers and alarms that have changed since they were sent, and the number of
    /// states and telemetry dropped in between: at most one per topic and missed tick. An unchanged state and its
    /// telemetry are repeated every `HEARTBEAT`.
    pub fn newest(&mut self, missed_ticks: u64) -> (Vec<Notification>, u64) {
        let mut updates = Vec::new();
        let mut dropped = 0;
        let now = Now::read().instant;
        let has_state = self.topics.contains(&Topic::State);
        let has_telemetry = self.topics.contains(&Topic::Telemetry);
        for Watched { source, states, seq, sent_at } in &mut self.watched {
            let is_changed = states.has_changed().unwrap_or_default();
            if !is_changed && sent_at.is_some_and(|at| now < at + HEARTBEAT) {
                continue;
            }
            *sent_at = Some(now);
            states.mark_unchanged();
            let state = source.handle.state();
            let new = if is_changed {
                [
                    has_state.then(|| source.state(&state)).flatten(),
                    has_telemetry.then(|| source.telemetry(&state)).flatten(),
                ]
            } else {
                // The age grows without an update, so a heartbeat is not shared.
                [
                    has_state.then(|| Notification::new("state", &*state)).flatten(),
                    has_telemetry.then(|| Notification::telemetry(&state)).flatten(),
                ]
            };
            let missed = state.seq.saturating_sub(*seq + 1).min(missed_ticks);
            dropped += missed * new.iter().flatten().count() as u64;
            updates.extend(new.into_iter().flatten());
            *seq = state.seq;
        }
        if self.topics.contains(&Topic::Fleet) {
            updates.extend(self.updates.fleet.since(&mut self.fleet_seq));
        }
        if self.topics.contains(&Topic::Alarms) {
            updates.extend(self.updates.alarms_since(&mut self.alarms_seq));
        }
        (updates, dropped)
    }

    /// Returns the number of the event after which the next ones are sent.
    #[must_use]
    pub fn event_seq(&self) -> i64 {
        self.event_position.as_ref().map_or_else(|| self.updates.journal.last_seq(), EventPosition::get)
    }

    /// Returns what waits to be sent when another subscription replaces this one: events up to the successor's first,
    /// or a gap in their place, and grip records, of which the newest can be sent again. Frames are left out: the
    /// successor's begin at once.
    pub fn rest(&mut self, successor: &Self) -> Vec<Notification> {
        let mut rest = Vec::new();
        let events = self.event_position.clone().zip(successor.event_position.as_ref());
        if let Some((position, first)) = &events
            && self.covers(successor)
        {
            // Events that were sent since the successor was made are not sent again.
            first.set(position.get().max(first.get()));
        }
        while let Some(Some(update)) = unconstrained(self.queued.next()).now_or_never() {
            let is_due = match update.method() {
                "event" => events.as_ref().is_some_and(|(position, first)| position.get() <= first.get()),
                "grip" => successor.topics.contains(&Topic::Grips),
                method => method == "gap",
            };
            rest.extend(is_due.then_some(update));
        }
        if let Some((position, first)) = events {
            let seq = position.get();
            let missed = (first.get() - seq).try_into().unwrap_or_default();
            if missed > 0 {
                rest.extend(Notification::new("gap", &Gap::of_events(seq, missed)));
            }
        }
        rest
    }

    /// Whether all grippers of another subscription belong to this one.
    fn covers(&self, other: &Self) -> bool {
        let Some(only) = &self.only else { return true };
        other.only.as_ref().is_some_and(|others| others.is_subset(only))
    }

    /// Returns the next event, frame or gap. Cancel-safe.
    pub async fn next(&mut self) -> Notification {
        loop {
            tokio::select! {
                biased;
                () = self.changes.wait() => self.watch_grippers(),
                Some(update) = self.queued.next() => return update,
                Some(update) = self.frames.next() => return update,
            }
        }
    }
}

#[cfg(test)]
mod tests;
