//! The gateway, as operations see it.

use std::sync::Arc;

use super::calls::audit::Audit;
use super::parameters::values::shortened;
use super::problem::Problem;
use super::reload_requests::Reloads;
use crate::access::Access;
use crate::alarms::Alarms;
use crate::events::LiveUpdates;
use crate::fleet::Peers;
use crate::gripper::Grippers;
use crate::journal::Journal;
use crate::model::Name;
use crate::recipes::Recipes;
use crate::trends::Trends;
use crate::wear::Wear;
use crate::webhooks::Webhooks;

/// Most names of grippers that a problem lists: it has to fit a small client's buffer.
const MAX_LISTED: usize = 8;

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

impl Gateway {
    /// Reports that no gripper has this name. Lists the grippers, unless the caller is unknown.
    pub(crate) fn no_gripper(&self, name: &str, is_known: bool) -> Problem {
        let name = name.parse::<Name>().map_or_else(|_| format!("{:?}", shortened(name)), |name| name.to_string());
        let all = self.grippers.all();
        let remedy = match all.len() {
            _ if !is_known => "check the name".to_owned(),
            0 => "this gateway has none".to_owned(),
            count => {
                let listed: Vec<_> = all.iter().take(MAX_LISTED).map(|gripper| gripper.name().as_str()).collect();
                let more = count.checked_sub(MAX_LISTED).filter(|more| *more > 0);
                let more = more.map(|more| format!(" and {more} more")).unwrap_or_default();
                format!("this gateway has {}{more}", listed.join(", "))
            }
        };
        Problem::not_found(format!("gripper is named {name}: {remedy}")).field("gripper")
    }
}

#[cfg(test)]
impl Gateway {
    /// Returns a gateway with these grippers and a journal in memory.
    pub(crate) fn of(grippers: impl IntoIterator<Item = crate::gripper::Handle>) -> Arc<Self> {
        let (journal, _) =
            Journal::open(crate::journal::JournalLocation::Memory, crate::journal::Retention::default()).unwrap();
        let name: Name = "wsg".parse().unwrap();
        let grippers = Grippers::new(grippers);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gripper::fake::{self, FakeScript};

    #[tokio::test]
    async fn missing_gripper_is_reported_with_a_few_names_of_others() {
        let gateway =
            |names: &[&str]| Gateway::of(names.iter().map(|name| fake::gripper(name, FakeScript::default()).0));
        let said = |names: &[&str], name: &str, is_known| gateway(names).no_gripper(name, is_known).detail().to_owned();
        assert_eq!(said(&["right", "left"], "lefft", true), "no gripper is named lefft: this gateway has left, right");
        let [eight, nine] = [8, 9].map(|count| ["a", "b", "c", "d", "e", "f", "g", "h", "i"][..count].to_vec());
        assert!(said(&eight, "x", true).ends_with("this gateway has a, b, c, d, e, f, g, h"));
        assert!(said(&nine, "x", true).ends_with("this gateway has a, b, c, d, e, f, g, h and 1 more"));
        assert_eq!(said(&["left"], "lefft", false), "no gripper is named lefft: check the name");
        assert_eq!(said(&[], "Left\n", true), "no gripper is named \"Left\\n\": this gateway has none");
    }
}
