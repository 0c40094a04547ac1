//! The list of alarms: a pure state machine, which gets conditions and the time.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use jiff::Timestamp;

use crate::gripper::Now;
use crate::model::{
    Alarm, AlarmCause, AlarmId, AlarmKind, AlarmPriority, AlarmStep, Client, ClientLabel, FastStopId, Name, PartId,
};

/// Time for which a condition has to be absent before its alarm ends. A flickering condition is one alarm.
const ENDS_AFTER: Duration = Duration::from_secs(1);

/// Maximum number of alarms: those of more than fifty grippers with everything wrong, besides drifts.
const MAX_ALARMS: usize = 1024;

/// A condition of a gripper, of a part on it, of another gateway, or of a credential or webhook with this name; of this
/// gateway if all four are absent.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct AlarmKey {
    pub(super) alarm: AlarmKind,
    pub(super) gripper: Option<Name>,
    pub(super) gateway: Option<Name>,
    pub(super) part_id: Option<PartId>,
    pub(super) name: Option<Arc<str>>,
}

impl AlarmKey {
    /// Key of an alarm that was listed.
    fn of(alarm: &Alarm) -> Self {
        Self {
            alarm: alarm.alarm,
            gripper: alarm.gripper.clone(),
            gateway: alarm.gateway.clone(),
            part_id: alarm.cause.part_id.clone(),
            name: alarm.cause.name.clone(),
        }
    }

    /// Key of an alarm that this gateway has at most once.
    pub(super) fn of_gateway(alarm: AlarmKind) -> Self {
        Self { alarm, gripper: None, gateway: None, part_id: None, name: None }
    }

    /// Key of an alarm that a gripper has at most once.
    pub(super) fn of_gripper(alarm: AlarmKind, gripper: &Name) -> Self {
        Self { gripper: Some(gripper.clone()), ..Self::of_gateway(alarm) }
    }
}

/// The present conditions. A condition without a cause is unknown, e.g. a flag of a device without a link; all others
/// are absent.
pub(super) type Conditions = BTreeMap<AlarmKey, Option<AlarmCause>>;

/// A step in the life of an alarm.
pub(super) type AlarmChange = (AlarmStep, Alarm);

#[derive(Debug)]
struct Entry {
    alarm: Alarm,
    /// Time at which the condition was first seen absent, if the alarm has not ended yet.
    absent_since: Option<(Instant, Timestamp)>,
}

/// Alarms that are active, or that nobody has acknowledged: at most one of each condition.
#[derive(Debug, Default)]
pub(super) struct AlarmList(BTreeMap<AlarmKey, Entry>);

impl AlarmList {
    /// Continues the alarms of the last run. Active ones stay active until their condition is known to be absent.
    pub(super) fn restored(alarms: Vec<Alarm>) -> Self {
        let alarms = alarms.into_iter().take(MAX_ALARMS);
        Self(alarms.map(|alarm| (AlarmKey::of(&alarm), Entry { alarm, absent_since: None })).collect())
    }

    pub(super) fn alarms(&self) -> Vec<Alarm> {
        self.0.values().map(|entry| entry.alarm.clone()).collect()
    }

    /// Keys of the active alarms of gateways that are gone.
    pub(super) fn gone_gateways(&self) -> impl Iterator<Item = &AlarmKey> {
        let active = self.0.iter().filter(|(_, entry)| entry.alarm.ended_at.is_none());
        active.map(|(key, _)| key).filter(|key| key.alarm == AlarmKind::GatewayGone)
    }

    /// Compares the list with the present conditions, and returns what has changed.
    pub(super) fn look(&mut self, now: Now, conditions: &Conditions) -> Vec<AlarmChange> {
        let mut changes = Vec::new();
        for (key, cause) in conditions {
            if let Some(cause) = cause {
                self.raise(key, cause, now.wall, &mut changes);
            }
        }
        for (key, entry) in &mut self.0 {
            if conditions.contains_key(key) || entry.alarm.ended_at.is_some() {
                entry.absent_since = None;
                continue;
            }
            let (since, at) = *entry.absent_since.get_or_insert((now.instant, now.wall));
            if now.instant.saturating_duration_since(since) >= ENDS_AFTER {
                entry.alarm.ended_at = Some(at);
                changes.push((AlarmStep::Ended, entry.alarm.clone()));
            }
        }
        self.0.retain(|_, Entry { alarm, .. }| !is_over(alarm));
        changes
    }

    fn raise(&mut self, key: &AlarmKey, cause: &AlarmCause, at: Timestamp, changes: &mut Vec<AlarmChange>) {
        let mut count = 1;
        if let Some(Entry { alarm, .. }) = self.0.get_mut(key) {
            let is_same = alarm.cause.fast_stop_id == cause.fast_stop_id;
            if alarm.ended_at.is_none() && is_same {
                // The figures of a drift change with each grip.
                alarm.cause.clone_from(cause);
                return;
            }
            if alarm.ended_at.is_none() {
                changes.push((AlarmStep::Ended, Alarm { ended_at: Some(at), ..alarm.clone() }));
            }
            if alarm.acknowledged_at.is_none() && is_same {
                count += alarm.count;
            }
        } else if self.0.len() >= MAX_ALARMS && !self.make_room(key.alarm.priority()) {
            return;
        }
        let alarm = Alarm {
            id: AlarmId::generate(),
            alarm: key.alarm,
            priority: key.alarm.priority(),
            gripper: key.gripper.clone(),
            gateway: key.gateway.clone(),
            cause: cause.clone(),
            began_at: at,
            ended_at: None,
            count,
            acknowledged_at: None,
            acknowledged_by: None,
            acknowledged_label: None,
        };
        changes.push((AlarmStep::Raised, alarm.clone()));
        self.0.insert(key.clone(), Entry { alarm, absent_since: None });
    }

    /// Removes the alarm that ended first, or else one of a lower priority. The journal still has it.
    fn make_room(&mut self, priority: AlarmPriority) -> bool {
        let ended = self.0.iter().filter_map(|(key, entry)| Some((entry.alarm.ended_at?, key)));
        let dropped = if let Some((_, key)) = ended.min() {
            key.clone()
        } else {
            let lower = self.0.iter().filter(|(_, entry)| entry.alarm.priority > priority);
            let Some((key, _)) = lower.max_by_key(|(_, entry)| entry.alarm.priority) else { return false };
            key.clone()
        };
        self.0.remove(&dropped).is_some()
    }

    /// Acknowledges the alarms with these ids. Returns those that were listed, with their changes.
    pub(super) fn acknowledge(
        &mut self,
        ids: &BTreeSet<AlarmId>,
        by: &Client,
        at: Timestamp,
    ) -> (Vec<Alarm>, Vec<AlarmChange>) {
        let mut listed = Vec::new();
        let mut changes = Vec::new();
        for Entry { alarm, .. } in self.0.values_mut().filter(|entry| ids.contains(&entry.alarm.id)) {
            if alarm.acknowledged_at.is_none() {
                acknowledge(alarm, Some(by.subject.clone()), by.label.clone(), at);
                changes.push((AlarmStep::Acknowledged, alarm.clone()));
            }
            listed.push(alarm.clone());
        }
        self.0.retain(|_, Entry { alarm, .. }| !is_over(alarm));
        (listed, changes)
    }

    /// Ends the alarm of an acknowledged FAST STOP.
    pub(super) fn end_fast_stop(
        &mut self,
        gripper: &Name,
        id: FastStopId,
        (by, label): (Option<Arc<str>>, Option<ClientLabel>),
        at: Timestamp,
    ) -> Vec<AlarmChange> {
        let key = AlarmKey::of_gripper(AlarmKind::FastStop, gripper);
        let is_it = self.0.get(&key).is_some_and(|entry| entry.alarm.cause.fast_stop_id == Some(id));
        let Some(Entry { mut alarm, .. }) = is_it.then(|| self.0.remove(&key)).flatten() else { return Vec::new() };
        let mut changes = Vec::new();
        if alarm.acknowledged_at.is_none() {
            acknowledge(&mut alarm, by, label, at);
            changes.push((AlarmStep::Acknowledged, alarm.clone()));
        }
        alarm.ended_at = Some(at);
        changes.push((AlarmStep::Ended, alarm));
        changes
    }
}

fn acknowledge(alarm: &mut Alarm, by: Option<Arc<str>>, label: Option<ClientLabel>, at: Timestamp) {
    (alarm.acknowledged_at, alarm.acknowledged_by, alarm.acknowledged_label) = (Some(at), by, label);
}

/// Whether an alarm needs nobody any more. Only an acknowledgement ends a FAST STOP, so its alarm is over with it.
fn is_over(alarm: &Alarm) -> bool {
    alarm.ended_at.is_some() && (alarm.acknowledged_at.is_some() || alarm.alarm == AlarmKind::FastStop)
}
