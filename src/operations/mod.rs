//! Everything that a client may ask for, once, whichever interface it uses.
//!
//! An [`Operation`] has a name, a path, the role that it needs, an urgency, and a function. [`OPERATIONS`] lists them all;
//! HTTP's paths, WebSocket's methods and Zenoh's command keys come from that table. [`run`] performs an operation for a
//! [`Caller`], and is the one place that records refused requests.
//!
//! Architecture invariant: an operation decides nothing about a gripper. It parses parameters into domain types and hands
//! them to the gripper's handle. The actor refuses what a lease, a latch or a device's limit forbids.

pub mod audit;
mod call;
mod caller;
pub(crate) mod commands;
pub(crate) mod device;
pub(crate) mod fast_stop;
pub(crate) mod fingers;
pub(crate) mod fleet;
pub(crate) mod grippers;
pub(crate) mod json;
pub(crate) mod lease;
pub(crate) mod motion;
mod problem;
pub(crate) mod raw;
mod reply;
mod run;
pub(crate) mod settings;
mod table;
pub(crate) mod values;

use std::sync::Arc;

use crate::events::Updates;
use crate::fleet::Network;
use crate::gripper::Grippers;
use crate::gripper::model::Name;
use crate::journal::Journal;
use audit::Audit;

pub(crate) use call::{Fields, Leased, Params};
pub(crate) use caller::{Caller, DEFAULT_WAIT_MS, MAX_LEASE_BYTES, Presence, Wait, WaitLimiter, wait_ms};
pub(crate) use problem::{Code, Members, Problem};
pub(crate) use reply::{Effect, Reply};
pub(crate) use run::{call, run};
pub use table::{OPERATIONS, Operation, Role};
pub(crate) use table::{find, is_fast_stop, named, subject, urgency};

/// What operations work on.
#[derive(Debug, Clone)]
pub struct Gateway {
    /// The gateway's name.
    pub name: Name,
    /// The gateway's own grippers.
    pub grippers: Grippers,
    /// Stored events and grip records.
    pub journal: Journal,
    /// Record of refused requests.
    pub audit: Arc<Audit>,
    /// The other gateways.
    pub network: Arc<Network>,
    /// Live updates.
    pub updates: Arc<Updates>,
}

#[cfg(test)]
impl Gateway {
    /// Returns a gateway with these grippers and a journal in memory.
    pub(crate) fn of(grippers: impl IntoIterator<Item = crate::gripper::Handle>) -> Arc<Self> {
        let (journal, _) = Journal::open(crate::journal::Place::Memory, crate::journal::Retention::default()).unwrap();
        let (name, grippers): (Name, _) = ("wsg".parse().unwrap(), Grippers::new(grippers));
        let audit = Arc::new(Audit::new(journal.clone()));
        let network = Arc::new(Network::new(name.clone(), grippers.clone()));
        let updates = Arc::new(Updates::new(&grippers, journal.clone(), network.clone()));
        Arc::new(Self { name, grippers, journal, audit, network, updates })
    }
}
