//! Alarms: conditions of the grippers and of the gateway that a person must know about. All clients share them.
//!
//! An alarm is listed while its condition lasts, and afterwards until somebody acknowledges it. Acknowledging an alarm
//! changes nothing at the device: a FAST STOP stays latched until its own acknowledgement, which ends its alarm too.
//! The list survives a restart. Each step is an event of kind `alarm` in the journal, which is the alarms' history.

mod conditions;
mod list;
#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::watch;
use tokio::time::{MissedTickBehavior, interval};
use tokio_util::sync::CancellationToken;
use utoipa::ToSchema;

use crate::access::ExpiringCredential;
use crate::fleet::{KEPT_FOR, Peers};
use crate::gripper::recorder::{Record, Recorder as _};
use crate::gripper::{Grippers, Now};
use crate::journal::{EventKind, Journal, Stored};
use crate::model::{
    Alarm, AlarmCause, AlarmEvent, AlarmId, AlarmKind, AlarmStep, Client, ClientLabel, Detail, Event, FastStopId, Link,
    Name, PersistedKey, PersistedState,
};
use crate::wear::Wear;
use crate::webhooks::Webhooks;
pub use conditions::BrokerOutage;
use conditions::{of_broker, of_credentials, of_gripper, of_wear, of_webhooks, text};
use list::{AlarmChange, AlarmKey, AlarmList, Conditions};

/// Interval at which conditions are checked. Faults last until a person acts, so none is missed.
const CHECKED_EVERY: Duration = Duration::from_millis(100);

/// Time that the gateway has to reach a device, after a start, a reload or a `connect` request, before an alarm is
/// raised.
const REACHED_WITHIN: Duration = Duration::from_secs(3);

/// The alarms of this gateway.
#[derive(Debug)]
pub struct Alarms {
    gateway: Name,
    journal: Journal,
    known: Mutex<KnownAlarms>,
}

/// Parts of the gateway whose conditions raise alarms.
#[derive(Debug)]
pub struct AlarmSources {
    pub grippers: Grippers,
    pub peers: Arc<Peers>,
    pub wear: Arc<Wear>,
    pub webhooks: Arc<Webhooks>,
    /// The credentials that expire.
    pub expiring: watch::Receiver<Vec<ExpiringCredential>>,
    /// The longest outage of the MQTT broker that has not ended.
    pub broker: watch::Receiver<Option<BrokerOutage>>,
}

/// The alarms that are active or not acknowledged.
#[derive(Debug, Serialize, ToSchema)]
pub struct AlarmReport {
    /// The alarms, by kind, gripper and gateway.
    alarms: Vec<Alarm>,
}

#[derive(Debug, Default)]
struct KnownAlarms {
    list: AlarmList,
    /// Number of changes so far.
    changes: u64,
}

/// The journal's record of an acknowledged FAST STOP.
#[derive(Deserialize)]
struct ClearedLatch {
    gripper: Name,
    subject: Option<Arc<str>>,
    label: Option<ClientLabel>,
    fast_stop_id: Option<FastStopId>,
    cleared: bool,
}

impl Alarms {
    /// Continues the alarms that the last run persisted.
    #[must_use]
    pub fn new(gateway: Name, journal: Journal, persisted: &[PersistedState]) -> Self {
        let mut restored = Vec::new();
        for state in persisted.iter().filter(|state| state.key == PersistedKey::Alarms) {
            let alarms = serde_json::from_str::<Vec<Alarm>>(state.value.as_deref().unwrap_or("[]"));
            match alarms {
                Ok(alarms) => restored.extend(alarms),
                Err(error) => tracing::warn!(%error, "persisted alarms not restored: unknown format"),
            }
            // The gateway had another name in that run.
            if state.gripper != gateway {
                let renamed = PersistedState { gripper: gateway.clone(), ..state.clone() };
                journal.record(Record::Persisted(renamed));
                journal.record(Record::Persisted(PersistedState { value: None, ..state.clone() }));
            }
        }
        let known = KnownAlarms { list: AlarmList::restored(restored), changes: 0 };
        Self { gateway, journal, known: Mutex::new(known) }
    }

    /// Number of changes so far.
    #[must_use]
    pub fn changes(&self) -> u64 {
        self.known().changes
    }

    /// Returns the number of changes so far, and the alarms that are active or not acknowledged.
    #[must_use]
    pub fn read(&self) -> (u64, AlarmReport) {
        let known = self.known();
        (known.changes, AlarmReport { alarms: known.list.alarms() })
    }

    /// Acknowledges the alarms with these ids, and returns those that are listed.
    pub fn acknowledge(&self, ids: &BTreeSet<AlarmId>, client: &Client) -> Vec<Alarm> {
        let mut known = self.known();
        let (alarms, changes) = known.list.acknowledge(ids, client, Now::read().wall);
        for alarm in &alarms {
            match alarm.alarm {
                AlarmKind::JournalRestored => self.journal.confirm_restored(),
                AlarmKind::ClockDoubtful => self.journal.confirm_clock(),
                _ => {}
            }
        }
        self.note(&mut known, changes, Some(client));
        alarms
    }

    /// Follows the conditions until the gateway closes.
    pub async fn watch(self: Arc<Self>, sources: AlarmSources, closing: CancellationToken) {
        let AlarmSources { grippers, peers, wear, webhooks, expiring, broker } = sources;
        let mut events = self.journal.subscribe();
        let started = Now::read().instant;
        let mut connecting = BTreeMap::new();
        let mut ticks = interval(CHECKED_EVERY);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                biased;
                () = closing.cancelled() => return,
                event = events.recv() => match event {
                    Ok(event) => self.take(&event),
                    // A missed acknowledgement shows in the gripper's state.
                    Err(RecvError::Lagged(_)) => {}
                    Err(RecvError::Closed) => return,
                },
                _ = ticks.tick() => {
                    let now = Now::read();
                    let mut conditions = Conditions::new();
                    connecting = of_grippers(&grippers, &wear, now, &connecting, &mut conditions);
                    let running_for = now.instant.saturating_duration_since(started);
                    self.add_of_gateway(&peers, running_for, &mut conditions);
                    of_credentials(&expiring.borrow(), now.wall, &mut conditions);
                    of_webhooks(&webhooks, now.instant, &mut conditions);
                    of_broker(broker.borrow().as_ref(), now.instant, &mut conditions);
                    self.look(now, &conditions);
                }
            }
        }
    }

    /// Adds the conditions of this gateway and of others.
    fn add_of_gateway(&self, peers: &Peers, running_for: Duration, conditions: &mut Conditions) {
        let health = self.journal.health();
        let health = health.borrow();
        if let Some(failure) = &health.failure {
            conditions.insert(AlarmKey::of_gateway(AlarmKind::JournalDown), Some(text(failure)));
        }
        if let Some(cause) = &health.restored {
            conditions.insert(AlarmKey::of_gateway(AlarmKind::JournalRestored), Some(text(cause)));
        }
        if let Some(cause) = &health.clock {
            conditions.insert(AlarmKey::of_gateway(AlarmKind::ClockDoubtful), Some(text(cause)));
        }
        if let Some(damage) = &health.damage {
            conditions.insert(AlarmKey::of_gateway(AlarmKind::JournalDamaged), Some(text(damage)));
        }
        let gateways = peers.gateways();
        for (gateway, _) in gateways.iter().filter(|(_, is_gone)| **is_gone) {
            let key = AlarmKey { gateway: Some(gateway.clone()), ..AlarmKey::of_gateway(AlarmKind::GatewayGone) };
            conditions.insert(key, Some(AlarmCause::default()));
        }
        // A gateway that was gone before this one started is not known to be back.
        if running_for < KEPT_FOR {
            let known = self.known();
            for key in known.list.gone_gateways() {
                if key.gateway.as_ref().is_some_and(|gateway| !gateways.contains_key(gateway)) {
                    conditions.insert(key.clone(), None);
                }
            }
        }
    }

    fn look(&self, now: Now, conditions: &Conditions) {
        let mut known = self.known();
        let changes = known.list.look(now, conditions);
        self.note(&mut known, changes, None);
    }

    /// Takes the acknowledgement of a FAST STOP, on any interface.
    fn take(&self, event: &Stored) {
        if event.kind != EventKind::Acknowledge {
            return;
        }
        let Ok(ClearedLatch { gripper, subject, label, fast_stop_id: Some(id), cleared: true }) =
            serde_json::from_str(&event.body)
        else {
            return;
        };
        let mut known = self.known();
        let changes = known.list.end_fast_stop(&gripper, id, (subject, label), Now::read().wall);
        self.note(&mut known, changes, None);
    }

    /// Persists and records changes.
    fn note(&self, known: &mut KnownAlarms, changes: Vec<AlarmChange>, client: Option<&Client>) {
        if changes.is_empty() {
            return;
        }
        known.changes += 1;
        let value = serde_json::to_string(&known.list.alarms());
        match value {
            Ok(value) => self.journal.record(Record::Persisted(PersistedState {
                gripper: self.gateway.clone(),
                key: PersistedKey::Alarms,
                value: Some(value),
            })),
            Err(error) => tracing::error!(%error, "alarms not persisted: they cannot be encoded as JSON"),
        }
        for (step, alarm) in changes {
            let detail = Detail::Alarm(Box::new(AlarmEvent::of(step, &alarm)));
            let event = Event::new(Now::read().wall, alarm.gripper, detail);
            let event = match (step, client) {
                (AlarmStep::Acknowledged, Some(client)) => event.by(client),
                (AlarmStep::Acknowledged, None) => {
                    Event { subject: alarm.acknowledged_by, label: alarm.acknowledged_label, ..event }
                }
                _ => event,
            };
            self.journal.record(Record::Event(event, None));
        }
    }

    fn known(&self) -> MutexGuard<'_, KnownAlarms> {
        // A panic under the lock leaves at most one change unrecorded.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Adds the conditions of the grippers. Returns those that are still connecting, each with the time at which it began.
fn of_grippers(
    grippers: &Grippers,
    wear: &Wear,
    now: Now,
    connecting: &BTreeMap<Name, Instant>,
    conditions: &mut Conditions,
) -> BTreeMap<Name, Instant> {
    let mut still_connecting = BTreeMap::new();
    for gripper in grippers.all() {
        let name = gripper.name();
        let state = gripper.state();
        let since = connecting.get(name).copied().unwrap_or(now.instant);
        let is_starting = now.instant.saturating_duration_since(since) < REACHED_WITHIN;
        of_gripper(&state, now.instant, is_starting, conditions);
        of_wear(name, wear, conditions);
        if state.link == Link::Connecting {
            still_connecting.insert(name.clone(), since);
        }
    }
    still_connecting
}
