//! Updates of the fleet's grippers, sent when more than a gripper's age has changed.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::Notification;
use crate::fleet::{FleetGripper, Peers};
use crate::gripper::Now;

/// Interval at which the fleet is polled, once for all subscribers. Only elapsed time shows that a gateway is gone.
const POLL_EVERY: Duration = Duration::from_millis(100);

/// The newest update of each gripper of the fleet.
#[derive(Debug)]
pub(super) struct FleetNews {
    network: Arc<Peers>,
    known: Mutex<KnownFleet>,
}

#[derive(Debug, Default)]
struct KnownFleet {
    polled_at: Option<Instant>,
    /// Number of changes so far.
    seq: u64,
    grippers: BTreeMap<(String, String), Newest>,
}

#[derive(Debug)]
struct Newest {
    /// Number of the change that this update belongs to.
    seq: u64,
    lasting: FleetGripper,
    update: Notification,
}

impl FleetNews {
    pub(super) fn new(network: Arc<Peers>) -> Self {
        Self { network, known: Mutex::default() }
    }

    /// Returns the newest update of each gripper that has changed since change `seq`, and advances `seq`.
    pub(super) fn since(&self, seq: &mut u64) -> Vec<Notification> {
        // After a panic under the lock, the next poll rebuilds the state.
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let now = Now::read().instant;
        if known.polled_at.is_none_or(|at| now.saturating_duration_since(at) >= POLL_EVERY) {
            known.polled_at = Some(now);
            known.take(self.network.grippers());
        }
        let changed = known.grippers.values().filter(|newest| newest.seq > *seq);
        let updates = changed.map(|newest| newest.update.clone()).collect();
        *seq = known.seq;
        updates
    }
}

impl KnownFleet {
    fn take(&mut self, grippers: Vec<FleetGripper>) {
        let mut before = std::mem::take(&mut self.grippers);
        for gripper in grippers {
            let name = gripper.name();
            let lasting = gripper.lasting();
            let newest = before.remove(&name).filter(|newest| newest.lasting == lasting).or_else(|| {
                let update = Notification::new("fleet", &gripper)?;
                self.seq += 1;
                Some(Newest { seq: self.seq, lasting, update })
            });
            self.grippers.extend(newest.map(|newest| (name, newest)));
        }
    }
}
