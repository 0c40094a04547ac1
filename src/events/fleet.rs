//! The fleet, gripper by gripper, where one of them says more than that time goes by.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::Notification;
use crate::fleet::{FleetGripper, Peers};
use crate::gripper::Now;

/// How often it is looked at, for all who follow it: that a gateway is gone is seen by the time alone.
const LOOKED_AT_EVERY: Duration = Duration::from_millis(100);

/// What was told of it.
#[derive(Debug)]
pub(super) struct FleetNews {
    network: Arc<Peers>,
    known: Mutex<Known>,
}

#[derive(Debug, Default)]
struct Known {
    looked_at: Option<Instant>,
    /// How often anything has changed.
    seq: u64,
    grippers: BTreeMap<(String, String), Newest>,
}

#[derive(Debug)]
struct Newest {
    /// Which change it is.
    seq: u64,
    lasting: FleetGripper,
    told: Notification,
}

impl FleetNews {
    pub(super) fn new(network: Arc<Peers>) -> Self {
        Self { network, known: Mutex::default() }
    }

    /// Of each gripper the newest, where it has changed since that change, which becomes the last one.
    pub(super) fn since(&self, seq: &mut u64) -> Vec<Notification> {
        // A panic while it was locked has left what is looked at again.
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Now::read().instant;
        if known.looked_at.is_none_or(|at| now.saturating_duration_since(at) >= LOOKED_AT_EVERY) {
            known.looked_at = Some(now);
            known.take(self.network.grippers());
        }
        let changed = known.grippers.values().filter(|newest| newest.seq > *seq);
        let told = changed.map(|newest| newest.told.clone()).collect();
        *seq = known.seq;
        told
    }
}

impl Known {
    fn take(&mut self, grippers: Vec<FleetGripper>) {
        let mut before = std::mem::take(&mut self.grippers);
        for gripper in grippers {
            let (name, lasting) = (gripper.name(), gripper.lasting());
            let newest = before.remove(&name).filter(|newest| newest.lasting == lasting).or_else(|| {
                let told = Notification::new("fleet", &gripper)?;
                self.seq += 1;
                Some(Newest { seq: self.seq, lasting, told })
            });
            self.grippers.extend(newest.map(|newest| (name, newest)));
        }
    }
}
