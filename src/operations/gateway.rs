//! The gateway, as operations see it.

use std::sync::Arc;

use super::audit::Audit;
use super::reload_requests::Reloads;
use crate::access::Access;
use crate::alarms::Alarms;
use crate::events::LiveUpdates;
use crate::fleet::Peers;
use crate::gripper::Grippers;
use crate::gripper::model::Name;
use crate::journal::Journal;
use crate::recipes::Recipes;
use crate::trends::Trends;
use crate::wear::Wear;
use crate::webhooks::Webhooks;

/// State that operations work on.
#[derive(Debug, Clone)]
pub struct Gateway {
    pub name: Name,
    /// The gateway's own grippers.
    pub grippers: Grippers,
    /// Stored events and grip records.
    pub journal: Journal,
    /// Record of refused requests.
    pub audit: Arc<Audit>,
    /// The other gateways.
    pub peers: Arc<Peers>,
    pub alarms: Arc<Alarms>,
    pub recipes: Arc<Recipes>,
    pub wear: Arc<Wear>,
    pub updates: Arc<LiveUpdates>,
    pub webhooks: Arc<Webhooks>,
    pub trends: Arc<Trends>,
    /// Credentials of clients.
    pub access: Arc<Access>,
    pub reloads: Reloads,
}

#[cfg(test)]
impl Gateway {
    /// Returns a gateway with these grippers and a journal in memory.
    pub(crate) fn of(grippers: impl IntoIterator<Item = crate::gripper::Handle>) -> Arc<Self> {
        let (journal, _) =
            Journal::open(crate::journal::JournalLocation::Memory, crate::journal::Retention::default()).unwrap();
        let (name, grippers): (Name, _) = ("wsg".parse().unwrap(), Grippers::new(grippers));
        let audit = Arc::new(Audit::new(journal.clone()));
        let peers = Arc::new(Peers::new(name.clone(), grippers.clone(), None));
        let alarms = Arc::new(Alarms::new(name.clone(), journal.clone(), &[]));
        let recipes = Arc::new(Recipes::new(name.clone(), journal.clone(), &[]));
        let wear = Arc::new(Wear::new(journal.clone(), None, &[]));
        let updates = Arc::new(LiveUpdates::new(grippers.clone(), journal.clone(), peers.clone(), alarms.clone()));
        Arc::new(Self {
            name,
            grippers,
            journal,
            audit,
            peers,
            alarms,
            recipes,
            wear,
            updates,
            webhooks: Arc::default(),
            trends: Arc::default(),
            access: Arc::default(),
            reloads: Reloads::channel().0,
        })
    }
}
