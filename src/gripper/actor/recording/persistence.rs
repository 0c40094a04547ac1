//! State that outlives a restart of the gateway: persisted when it changes, and restored at the start.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::Recording;
use crate::Now;
use crate::actor::Actor;
use crate::last_command::LastCommand;
use crate::latch::LatchState;
use crate::lease::{Holder, LeaseState};
use crate::observed::HeldPart;
use crate::recorder::{Record, RestoredState};
use crate::setup::{Wanted, WantedSoftLimits};
use model::{CommandId, FastStopId, Latch, PersistedKey, PersistedState};
use wsg::{Acceleration, Force, SoftLimits, Width};

/// Epochs to skip after an unclean end, in which the last epochs may not have been persisted.
const EPOCHS_SKIPPED: u64 = 1000;

/// Epochs skipped after a restoration: more than were ever used, and few enough for 2,000 restorations below 2^53, up to
/// which JSON numbers are exact.
const RESTORED_EPOCHS_SKIPPED: u64 = 1 << 40;

/// Motions to skip in the numbers of a restored journal: more than a device can execute in four months.
const MOTIONS_SKIPPED: u32 = 1 << 28;

/// Numbers that earlier runs may have used without a trace in the journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Skipped {
    Nothing,
    /// The last run did not shut down cleanly.
    NewestRecords,
    /// The journal was restored, at this time in µs since 1970.
    RestoredAt(u64),
}

impl Skipped {
    fn after(restored: &RestoredState, now: Now) -> Self {
        if restored.unknown_past.is_some() {
            Self::RestoredAt(u64::try_from(now.wall.as_microsecond()).unwrap_or_default())
        } else if restored.unclean {
            Self::NewestRecords
        } else {
            Self::Nothing
        }
    }

    /// Whether even the first number may have been used.
    fn is_all(self) -> bool {
        matches!(self, Self::RestoredAt(_))
    }

    /// Returns an epoch that no run has used. No lease is taken each microsecond, so the time is beyond all epochs; a
    /// clock that is behind is made up for.
    fn next(self, epoch: u64) -> u64 {
        match self {
            Self::Nothing => epoch,
            Self::NewestRecords => epoch.saturating_add(EPOCHS_SKIPPED),
            Self::RestoredAt(time) => epoch.saturating_add(RESTORED_EPOCHS_SKIPPED).max(time),
        }
    }

    /// Count of numbers that the next motion skips.
    fn motions(self) -> u32 {
        match self {
            Self::Nothing => 0,
            Self::NewestRecords => EPOCHS_SKIPPED as u32,
            // Two restored copies of the same journal also differ.
            Self::RestoredAt(time) => MOTIONS_SKIPPED + (time / 1_000_000) as u32 % MOTIONS_SKIPPED,
        }
    }
}

#[derive(Debug, Serialize, Deserialize)]
struct PersistedSettings {
    /// Serial number of the device that they were set on.
    serial_number: Option<u32>,
    acceleration_mm_s2: Option<f32>,
    force_n: Option<f32>,
    soft_limits_cleared: bool,
    minus_mm: Option<f32>,
    plus_mm: Option<f32>,
}

impl PersistedSettings {
    fn new(serial_number: Option<u32>, wanted: &Wanted) -> Self {
        let limits = match wanted.soft_limits {
            WantedSoftLimits::Set(limits) => Some(limits),
            _ => None,
        };
        Self {
            serial_number,
            acceleration_mm_s2: wanted.acceleration.map(Acceleration::mm_s2),
            force_n: wanted.force_limit.map(Force::n),
            soft_limits_cleared: wanted.soft_limits == WantedSoftLimits::Cleared,
            minus_mm: limits.map(|limits| limits.minus().mm()),
            plus_mm: limits.map(|limits| limits.plus().mm()),
        }
    }

    fn wanted(&self) -> Wanted {
        let minus = self.minus_mm.and_then(|mm| Width::new(mm).ok());
        let plus = self.plus_mm.and_then(|mm| Width::new(mm).ok());
        let soft_limits = match minus.zip(plus).and_then(|(minus, plus)| SoftLimits::new(minus, plus)) {
            Some(limits) => WantedSoftLimits::Set(limits),
            None if self.soft_limits_cleared => WantedSoftLimits::Cleared,
            None => WantedSoftLimits::AsTheyAre,
        };
        Wanted {
            acceleration: self.acceleration_mm_s2.and_then(|mm_s2| Acceleration::new(mm_s2).ok()),
            force_limit: self.force_n.and_then(|n| Force::new(n).ok()),
            soft_limits,
        }
    }
}

#[derive(Debug, Default, Serialize, Deserialize)]
struct PersistedLease {
    epoch: u64,
    holder: Option<Holder>,
}

/// The latched FAST STOP, or the epoch of the last one.
#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum PersistedLatch {
    Holds(HeldLatch),
    Cleared(ClearedLatch),
}

#[derive(Debug, Serialize, Deserialize)]
struct HeldLatch {
    /// Absent in values of earlier versions.
    #[serde(default)]
    epoch: u64,
    #[serde(flatten)]
    latch: Latch,
}

/// Epoch of a cleared latch. Denies unknown fields, so that an unreadable [`HeldLatch`] does not parse as cleared.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ClearedLatch {
    epoch: u64,
}

/// State as last persisted.
#[derive(Debug, Default)]
pub(in crate::actor) struct LastReported {
    latch: (u64, Option<FastStopId>),
    lease: PersistedLease,
    grip: Option<CommandId>,
    last: LastCommand,
}

impl Actor {
    /// Restores the state of an earlier run, before the first link.
    pub fn restore(&mut self, now: Now, restored: RestoredState) {
        if let Some(settings) = self.parse::<PersistedSettings>(restored.settings.as_deref()) {
            self.settings.wanted = settings.wanted();
            self.settings.known_serial = settings.serial_number;
        }
        let skipped = Skipped::after(&restored, now);
        let latch = match self.parse(restored.latch.as_deref()) {
            Some(PersistedLatch::Holds(HeldLatch { epoch, latch })) => Some((epoch, Some(latch))),
            Some(PersistedLatch::Cleared(ClearedLatch { epoch })) => Some((epoch, None)),
            None => None,
        };
        if let Some((epoch, latch)) = latch {
            self.recording.reported.latch = (epoch, latch.as_ref().map(|latch| latch.id));
            self.latch.restore(now.instant, skipped.next(epoch), latch);
        } else if skipped.is_all() {
            self.latch.restore(now.instant, skipped.next(0), None);
        }
        let grip = self.parse(restored.holding.as_deref());
        self.recording.reported.grip = grip;
        self.observed.part = HeldPart { is_held: grip.is_some(), grip };
        let lease: Option<PersistedLease> = self.parse(restored.lease.as_deref());
        if lease.is_some() || skipped.is_all() {
            let PersistedLease { epoch, holder } = lease.unwrap_or_default();
            self.lease.restore(skipped.next(epoch), holder);
        }
        if let Some(last) = self.parse::<LastCommand>(restored.last_command.as_deref()) {
            self.recording.reported.last = last.clone();
            self.commands.last = last.restored(skipped.motions());
        } else if skipped.is_all() {
            self.commands.last = LastCommand::default().restored(skipped.motions());
        }
        self.link.unannounced = restored.unclean && self.link.properties.connection_oriented;
        self.commands.unknown_past = restored.unknown_past;
        for request in restored.requests {
            self.commands.bind_again(now, request);
        }
        self.after_input(now);
    }

    pub(in crate::actor) fn persist_settings(&mut self) {
        let settings = PersistedSettings::new(self.settings.known_serial, &self.settings.wanted);
        self.recording.persist(PersistedKey::Settings, Some(&settings));
    }

    fn parse<T: DeserializeOwned>(&self, value: Option<&str>) -> Option<T> {
        match serde_json::from_str(value?) {
            Ok(parsed) => Some(parsed),
            Err(error) => {
                tracing::warn!(gripper = %self.config.name, %error, value, "persisted value ignored");
                None
            }
        }
    }
}

impl Recording {
    pub(super) fn persist<T: Serialize>(&mut self, key: PersistedKey, value: Option<&T>) {
        // These structures always serialize to JSON.
        let value = value.and_then(|value| serde_json::to_string(value).ok());
        self.push(Record::Persisted(PersistedState { gripper: self.gripper.clone(), key, value }));
    }

    /// Persists changes of the latch, the lease, the held part and the newest motion.
    pub(in crate::actor) fn persist_changes(
        &mut self,
        latch: &LatchState,
        lease: &LeaseState,
        grip: Option<CommandId>,
        last: &LastCommand,
    ) {
        if self.reported.last != *last {
            self.reported.last = last.clone();
            self.persist(PersistedKey::LastCommand, Some(last));
        }
        if self.reported.grip != grip {
            self.reported.grip = grip;
            self.persist(PersistedKey::Holding, grip.as_ref());
        }
        let epoch = latch.epoch();
        if self.reported.latch != (epoch, latch.id()) {
            self.reported.latch = (epoch, latch.id());
            let latch = match latch.current().cloned() {
                Some(latch) => PersistedLatch::Holds(HeldLatch { epoch, latch }),
                None => PersistedLatch::Cleared(ClearedLatch { epoch }),
            };
            self.persist(PersistedKey::Latch, Some(&latch));
        }
        // After a restart, the gripper is reserved for its last holder, or for the client of an earlier reservation.
        let holder = lease.holder().or(lease.reserved());
        if (self.reported.lease.epoch, self.reported.lease.holder.as_ref()) != (lease.epoch(), holder) {
            let lease = PersistedLease { epoch: lease.epoch(), holder: holder.cloned() };
            self.persist(PersistedKey::Lease, Some(&lease));
            self.reported.lease = lease;
        }
    }
}
