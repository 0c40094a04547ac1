//! What has to outlive a restart of the gateway: handed to the journal when it changes, and taken in at the start.

use std::sync::Arc;

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::super::Now;
use super::super::latch::LatchState;
use super::super::lease::{Holder, LeaseState};
use super::super::model::{Client, CommandId, Door, FastStopId, Latch, Memory, MemoryKey};
use super::super::observed::HeldPart;
use super::super::recorder::{Recollection, Record};
use super::super::setup::{Wanted, WantedSoftLimits};
use super::Actor;
use super::recording::Recording;
use crate::wsg::{Acceleration, Force, SoftLimits, Width};

/// So many leases may have been taken, or FAST STOPs latched, and not been written down, when the gateway was killed.
const EPOCHS_SKIPPED: u64 = 1000;

/// What clients set, as it is remembered.
#[derive(Debug, Serialize, Deserialize)]
struct RememberedSettings {
    /// The device that it was set on.
    serial_number: Option<u32>,
    acceleration_mm_s2: Option<f32>,
    force_n: Option<f32>,
    soft_limits_cleared: bool,
    minus_mm: Option<f32>,
    plus_mm: Option<f32>,
}

impl RememberedSettings {
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
        let width = |mm: Option<f32>| mm.and_then(|mm| Width::new(mm).ok());
        let limits = width(self.minus_mm).zip(width(self.plus_mm));
        let soft_limits = match limits.and_then(|(minus, plus)| SoftLimits::new(minus, plus)) {
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

/// The newest lease, as it is remembered.
#[derive(Debug, Serialize, Deserialize)]
struct RememberedLease {
    epoch: u64,
    holder: Option<RememberedHolder>,
}

#[derive(Debug, Serialize, Deserialize)]
struct RememberedHolder {
    name: Arc<str>,
    subject: Arc<str>,
    door: Door,
}

/// The FAST STOP that holds, or the epoch of the last one, as it is remembered.
#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
enum RememberedLatch {
    Holds(HeldLatch),
    Cleared(ClearedLatch),
}

#[derive(Debug, Serialize, Deserialize)]
struct HeldLatch {
    /// Earlier versions wrote none.
    #[serde(default)]
    epoch: u64,
    #[serde(flatten)]
    latch: Latch,
}

/// A latch that can't be read is none of these: it has further fields.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ClearedLatch {
    epoch: u64,
}

/// What the journal was told last.
#[derive(Debug, Default)]
pub(super) struct LastReported {
    latch: (u64, Option<FastStopId>),
    lease: (u64, Option<Holder>),
    grip: Option<CommandId>,
}

impl Actor {
    /// Takes in what was remembered of an earlier run, before the first link.
    pub fn recollect(&mut self, now: Now, recollection: Recollection) {
        if let Some(settings) = self.remembered::<RememberedSettings>(recollection.settings.as_deref()) {
            self.settings.wanted = settings.wanted();
            self.settings.known_serial = settings.serial_number;
        }
        let skipped = if recollection.unclean { EPOCHS_SKIPPED } else { 0 };
        let latch = match self.remembered(recollection.latch.as_deref()) {
            Some(RememberedLatch::Holds(HeldLatch { epoch, latch })) => Some((epoch, Some(latch))),
            Some(RememberedLatch::Cleared(ClearedLatch { epoch })) => Some((epoch, None)),
            None => None,
        };
        if let Some((epoch, latch)) = latch {
            self.recording.reported.latch = (epoch, latch.as_ref().map(|latch| latch.id));
            self.latch.recollect(now.instant, epoch.saturating_add(skipped), latch);
        }
        let grip = self.remembered(recollection.holding.as_deref());
        self.recording.reported.grip = grip;
        self.observed.part = HeldPart { is_held: grip.is_some(), grip };
        if let Some(RememberedLease { epoch, holder }) = self.remembered(recollection.lease.as_deref()) {
            let client = |holder: &RememberedHolder| Client { subject: holder.subject.clone(), door: holder.door };
            let holder = holder.map(|holder| Holder { client: client(&holder), name: holder.name });
            self.lease.recollect(epoch.saturating_add(skipped), holder);
        }
        self.link.unannounced = recollection.unclean && self.link.properties.connection_oriented;
        for request in recollection.requests {
            self.commands.bind_again(now, request);
        }
        self.after_input(now);
    }

    pub(super) fn remember_settings(&mut self) {
        let remembered = RememberedSettings::new(self.settings.known_serial, &self.settings.wanted);
        self.recording.persist(MemoryKey::Settings, Some(&remembered));
    }

    fn remembered<T: DeserializeOwned>(&self, value: Option<&str>) -> Option<T> {
        serde_json::from_str(value?)
            .inspect_err(|error| {
                tracing::warn!(gripper = %self.config.name, %error, value, "what was remembered is not understood");
            })
            .ok()
    }
}

impl Recording {
    pub(super) fn persist<T: Serialize>(&mut self, key: MemoryKey, value: Option<&T>) {
        // Such structures are always JSON.
        let value = value.and_then(|value| serde_json::to_string(value).ok());
        let gripper = self.gripper().clone();
        self.push(Record::Memory(Memory { gripper, key, value }));
    }

    /// Persists the changes of the latch, the lease and the part that is held.
    pub(super) fn persist_changes(&mut self, latch: &LatchState, lease: &LeaseState, grip: Option<CommandId>) {
        if self.reported.grip != grip {
            self.reported.grip = grip;
            self.persist(MemoryKey::Holding, grip.as_ref());
        }
        let epoch = latch.epoch();
        if self.reported.latch != (epoch, latch.id()) {
            self.reported.latch = (epoch, latch.id());
            let latch = match latch.current().cloned() {
                Some(latch) => RememberedLatch::Holds(HeldLatch { epoch, latch }),
                None => RememberedLatch::Cleared(ClearedLatch { epoch }),
            };
            self.persist(MemoryKey::Latch, Some(&latch));
        }
        // A gripper that was reserved, or held by a client that is gone with the gateway, is reserved again.
        let holder = lease.holder().or(lease.reserved());
        if (self.reported.lease.0, self.reported.lease.1.as_ref()) != (lease.epoch(), holder) {
            self.reported.lease = (lease.epoch(), holder.cloned());
            let holder = holder.map(|Holder { name, client }| RememberedHolder {
                name: name.clone(),
                subject: client.subject.clone(),
                door: client.door,
            });
            self.persist(MemoryKey::Lease, Some(&RememberedLease { epoch: lease.epoch(), holder }));
        }
    }
}
