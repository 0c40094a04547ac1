//! Wear of the fingers: their use since they were mounted, and the drift of contact widths.
//!
//! Both are computed from grip records and the ends of servo sessions as these become durable, and persisted for each
//! gripper. Records that were missed, e.g. at the end of the last run, are read from the journal. Retention changes
//! neither.

mod drift;
mod finger_set;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::oneshot;
use tokio_util::sync::CancellationToken;

use crate::gripper::Now;
use crate::gripper::recorder::{Record, Recorder as _};
use crate::journal::{
    Cursor, EventKind, EventStream, Filter, GripQuery, GripUpdate, Journal, Limit, Order, StreamItem,
};
use crate::model::{
    AlarmKind, Client, Detail, Event, FingerSetChange, Kind, Name, Outcome, PartId, PersistedKey, PersistedState,
    SettingChange, SettingsEvent,
};
use drift::DriftChart;

pub use drift::DriftLimits;
pub use finger_set::{FingerSet, FingerSetId, MountRequest};

/// Maximum number of charts of a gripper. Beyond that, the least recently used chart is dropped, one that still learns
/// before others.
const MAX_CHARTS: usize = 64;

/// Number of missed records that are read at once.
const CAUGHT_UP_AT_ONCE: u64 = 1000;

/// Pause after events could not be read from the journal.
const READ_AGAIN_AFTER: Duration = Duration::from_secs(10);

/// Longest time from the start of a motion to its record: the slowest motion takes 42 s (210 mm at 5 mm/s). If a motion
/// seems to have begun earlier before the mount, the clock was set back.
const RECORDED_WITHIN: SignedDuration = SignedDuration::from_mins(2);

/// Wear of all grippers.
#[derive(Debug)]
pub struct Wear {
    journal: Journal,
    known: Mutex<KnownWear>,
}

#[derive(Debug, Default)]
struct KnownWear {
    grippers: BTreeMap<Name, GripperWear>,
    /// `None` if drift is not watched.
    limits: Option<DriftLimits>,
}

/// Wear of a gripper's fingers.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
struct GripperWear {
    /// Sequence number of the newest grip record that was counted.
    seq: i64,
    /// Sequence number of the newest end of a servo session that was counted.
    #[serde(default)]
    session_seq: i64,
    finger_set: Option<FingerSet>,
    charts: Vec<DriftChart>,
}

/// Fields of a grip record that wear is computed from.
#[derive(Debug, Deserialize)]
struct WearRecord {
    seq: i64,
    gripper: Name,
    started_at: Timestamp,
    kind: Kind,
    outcome: Outcome,
    part_id: Option<PartId>,
    contact_width_mm: Option<f64>,
    travel_mm: Option<f64>,
    recipe_version: Option<u64>,
}

/// Fields of an event at the end of a servo session that wear is computed from.
#[derive(Debug, Deserialize)]
struct EndedSession {
    seq: i64,
    gripper: Name,
    at: Timestamp,
    #[serde(flatten)]
    end: SessionEnd,
}

/// Tells the end of a servo session from other events of the device.
#[derive(Debug, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum SessionEnd {
    ServoEnded { duration_ms: u32, travel_mm: f64 },
}

/// Condition that a person must know about.
#[derive(Debug, Clone, PartialEq)]
pub struct WearCondition {
    pub alarm: AlarmKind,
    /// Part or gauge whose contact widths drift.
    pub part_id: Option<PartId>,
    /// Description for people.
    pub cause: String,
}

impl Wear {
    /// Continues with the figures that earlier runs persisted.
    #[must_use]
    pub fn new(journal: Journal, limits: Option<DriftLimits>, persisted: &[PersistedState]) -> Self {
        let mut grippers = BTreeMap::new();
        for state in persisted.iter().filter(|state| state.key == PersistedKey::Wear) {
            match serde_json::from_str(state.value.as_deref().unwrap_or_default()) {
                Ok(wear) => drop(grippers.insert(state.gripper.clone(), wear)),
                Err(error) => tracing::warn!(%error, gripper = %state.gripper, "wear of the fingers not restored"),
            }
        }
        Self { journal, known: Mutex::new(KnownWear { grippers, limits }) }
    }

    /// Changes the drift limits; `None` stops watching for drift.
    pub fn set_limits(&self, limits: Option<DriftLimits>) {
        let mut known = self.known();
        known.limits = limits;
        known.grippers.values_mut().flat_map(|wear| &mut wear.charts).for_each(|chart| chart.judge(limits));
    }

    /// Follows grip records and servo sessions until the gateway closes.
    pub async fn watch(self: Arc<Self>, mut grips: Receiver<Arc<GripUpdate>>, closing: CancellationToken) {
        let mut sessions = self.sessions();
        let mut reads_at = tokio::time::Instant::now();
        self.catch_up().await;
        loop {
            tokio::select! {
                biased;
                () = closing.cancelled() => return,
                grip = grips.recv() => match grip {
                    Ok(grip) => self.take(&grip.body),
                    Err(RecvError::Lagged(_)) => self.catch_up().await,
                    Err(RecvError::Closed) => return,
                },
                () = tokio::time::sleep_until(reads_at), if tokio::time::Instant::now() < reads_at => {}
                item = sessions.next(), if tokio::time::Instant::now() >= reads_at => match item {
                    Ok(Some(StreamItem::Event(event))) => self.take_session(&event.body),
                    Ok(Some(StreamItem::Removed { .. })) => {}
                    Ok(None) => return,
                    Err(error) => {
                        tracing::warn!(%error, "motions not counted as wear of the fingers");
                        reads_at = tokio::time::Instant::now() + READ_AGAIN_AFTER;
                    }
                },
            }
        }
    }

    /// The events after the newest session that was counted. Without any, counting begins with the next session.
    fn sessions(&self) -> EventStream {
        let counted = self.known().grippers.values().map(|wear| wear.session_seq).max();
        let filter = Filter { kind: Some(EventKind::Device), ..Filter::default() };
        self.journal.follow(counted.filter(|seq| *seq > 0), filter)
    }

    /// Counts the records after the newest one that was counted. Without any, counting begins with the next motion.
    async fn catch_up(&self) {
        loop {
            let counted = self.known().grippers.values().map(|wear| wear.seq).max();
            let Some(counted) = counted.filter(|seq| *seq > 0) else { return };
            let limit = Limit::new(CAUGHT_UP_AT_ONCE).unwrap_or_default();
            let cursor = Some(Cursor::after(counted));
            let query = GripQuery { cursor, limit, order: Order::Oldest, ..GripQuery::default() };
            match self.journal.grips(query).await {
                Ok(page) => {
                    page.bodies.iter().for_each(|body| self.take(body));
                    if page.next_cursor.is_none() {
                        return;
                    }
                }
                Err(error) => {
                    tracing::warn!(%error, "motions not counted as wear of the fingers");
                    return;
                }
            }
        }
    }

    /// Counts a grip record. A change of a record that was already counted is ignored.
    fn take(&self, body: &str) {
        let Ok(record) = serde_json::from_str::<WearRecord>(body) else { return };
        let mut known = self.known();
        let gripper = record.gripper.clone();
        let limits = known.limits;
        let wear = known.grippers.entry(gripper.clone()).or_default();
        if record.seq <= wear.seq {
            return;
        }
        wear.take(record, limits);
        self.persist(&gripper, wear);
    }

    /// Counts the way of a servo session that has ended. Other events are ignored.
    fn take_session(&self, body: &str) {
        let Ok(session) = serde_json::from_str::<EndedSession>(body) else { return };
        let mut known = self.known();
        let wear = known.grippers.entry(session.gripper.clone()).or_default();
        if session.seq <= wear.session_seq {
            return;
        }
        wear.take_session(&session);
        self.persist(&session.gripper, wear);
    }

    /// Returns the gripper's finger set, if it is known.
    #[must_use]
    pub fn finger_set(&self, gripper: &Name) -> Option<FingerSet> {
        self.known().grippers.get(gripper)?.finger_set.clone()
    }

    /// Notes the finger set of a gripper. Another set, or the same one with `reset`, counts from zero, and its contact
    /// widths are learned again.
    ///
    /// Returns the set, and a channel that resolves once it is durable.
    pub fn mount(&self, gripper: &Name, mounted: MountRequest, by: &Client) -> (FingerSet, oneshot::Receiver<()>) {
        let at = Now::read().wall;
        let mut known = self.known();
        let wear = known.grippers.entry(gripper.clone()).or_default();
        let same = wear.finger_set.take().filter(|set| set.id == mounted.id && !mounted.reset);
        if same.is_none() {
            wear.charts.clear();
        }
        let set = mounted.into_finger_set(same, at, by);
        wear.finger_set = Some(set.clone());
        self.persist(gripper, wear);
        let change = FingerSetChange {
            finger_set: set.id.clone(),
            mounted_at: set.mounted_at,
            maintenance_cycles: set.maintenance_cycles,
            maintenance_travel_m: set.maintenance_travel_m,
        };
        let setting = SettingChange::FingerSet(Box::new(change));
        let detail = Detail::Settings(SettingsEvent { restored: false, setting });
        let (waiter, durable) = oneshot::channel();
        self.journal.record(Record::Event(Event::new(at, Some(gripper.clone()), detail).by(by), Some(waiter)));
        (set, durable)
    }

    /// Returns the present conditions of a gripper.
    #[must_use]
    pub fn conditions(&self, gripper: &Name) -> Vec<WearCondition> {
        let known = self.known();
        let Some(wear) = known.grippers.get(gripper) else { return Vec::new() };
        let due = wear.finger_set.as_ref().filter(|set| set.is_maintenance_due());
        let due =
            due.map(|set| WearCondition { alarm: AlarmKind::MaintenanceDue, part_id: None, cause: set.to_string() });
        let charts = wear.charts.iter().filter(|chart| known.limits.is_some() && chart.is_drifting());
        let drifting = charts.map(|chart| WearCondition {
            alarm: AlarmKind::DriftWarning,
            part_id: Some(chart.part_id.clone()),
            cause: chart.to_string(),
        });
        due.into_iter().chain(drifting).collect()
    }

    fn persist(&self, gripper: &Name, wear: &GripperWear) {
        match serde_json::to_string(wear) {
            Ok(value) => self.journal.record(Record::Persisted(PersistedState {
                gripper: gripper.clone(),
                key: PersistedKey::Wear,
                value: Some(value),
            })),
            Err(error) => {
                tracing::error!(%error, %gripper, "wear of the fingers not persisted: it cannot be encoded as JSON");
            }
        }
    }

    fn known(&self) -> MutexGuard<'_, KnownWear> {
        // A panic under the lock leaves at most one motion uncounted.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl GripperWear {
    fn take_session(&mut self, session: &EndedSession) {
        self.session_seq = session.seq;
        let Some(set) = &mut self.finger_set else { return };
        let SessionEnd::ServoEnded { duration_ms, travel_mm } = session.end;
        let began_at = session.at - SignedDuration::from_millis(duration_ms.into());
        // Its event can become durable after others were mounted. A later mount means that the clock was set back.
        if !(began_at..session.at + RECORDED_WITHIN).contains(&set.mounted_at) {
            set.count_motion(false, travel_mm);
        }
    }

    fn take(&mut self, record: WearRecord, limits: Option<DriftLimits>) {
        let WearRecord { seq, started_at, kind, outcome, part_id, contact_width_mm, travel_mm, recipe_version, .. } =
            record;
        self.seq = seq;
        // The record of a grip appears a second after its end, when other fingers can be mounted.
        let mounted_after = self.finger_set.as_ref().map(|set| set.mounted_at.duration_since(started_at));
        if mounted_after.is_some_and(|time| time.is_positive() && time < RECORDED_WITHIN) {
            return;
        }
        if let Some(set) = &mut self.finger_set {
            set.count_motion(kind.is_grip(), travel_mm.unwrap_or_default());
        }
        // The width of a wrong part says nothing about the fingers.
        let (Some(part_id), Some(width_mm), Outcome::PartHeld) = (part_id, contact_width_mm, outcome) else { return };
        let index = self.charts.iter().position(|chart| chart.kind == kind && chart.part_id == part_id);
        let chart = index.map(|index| self.charts.remove(index));
        // A new version of the recipe can grip at another speed or force.
        let chart =
            chart.filter(|chart| chart.recipe_version.zip(recipe_version).is_none_or(|(known, given)| known == given));
        let mut chart = chart.unwrap_or_else(|| DriftChart::new(kind, part_id));
        chart.recipe_version = recipe_version.or(chart.recipe_version);
        chart.take(width_mm, limits);
        // The charts are in the order of their use.
        self.charts.push(chart);
        if self.charts.len() > MAX_CHARTS {
            // Parts that are gripped once, such as those with serial numbers, do not push out others.
            let others = &self.charts[..MAX_CHARTS];
            let dropped = others.iter().position(DriftChart::is_learning).unwrap_or_default();
            self.charts.remove(dropped);
        }
    }
}
