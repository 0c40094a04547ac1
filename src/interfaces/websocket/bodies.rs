//! Parameters and result of `subscribe`.

use std::collections::BTreeSet;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use crate::events::{DEFAULT_HZ, MAX_HZ, Subscription, Topic};
use crate::model::{Name, State};
use crate::operations::parameters::json;
use crate::operations::parameters::values::Whole;
use crate::operations::{Gateway, Problem};

/// Maximum rate, per second.
type MaxHz = Whole<1, MAX_HZ>;

/// A subscription, which replaces the previous one. Without topics it ends all updates.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"grippers": ["left"], "topics": ["state", "events"], "max_hz": 20}))]
pub struct Subscribe {
    /// Names of the grippers; all grippers if omitted. Events that concern no gripper are sent only if this is omitted.
    grippers: Option<Vec<String>>,
    /// Topics to subscribe to.
    topics: BTreeSet<Topic>,
    /// Maximum rate of states and telemetry for each gripper, per second. The fleet's rate is always 10.
    #[schema(default = 10)]
    max_hz: Option<MaxHz>,
}

/// The accepted subscription and the current states, from which the notifications continue.
#[derive(Debug, Serialize, ToSchema)]
pub struct Subscribed {
    /// The subscribed topics.
    topics: BTreeSet<Topic>,
    /// Maximum rate of states and telemetry for each gripper, per second.
    #[schema(minimum = 1, maximum = 100)]
    max_hz: u64,
    /// `seq` of the newest event; notifications start after it.
    #[schema(minimum = 0)]
    event_seq: i64,
    /// Current states of the grippers.
    states: Vec<Arc<State>>,
}

/// A subscription and the rate of its states.
pub struct Following {
    pub updates: Subscription,
    pub max_hz: u64,
}

pub fn subscribe(gateway: &Gateway, params: &Value) -> Result<(Subscribed, Following), Problem> {
    let Subscribe { grippers, topics, max_hz } = json::parse(params.to_string().as_bytes())?;
    let names = grippers.map(|names| names.iter().map(|name| known(gateway, name)).collect()).transpose()?;
    let max_hz = max_hz.map_or(Ok(DEFAULT_HZ), |max_hz| max_hz.checked("max_hz"))?;
    let mut updates = gateway.updates.subscribe(names.as_ref(), topics.iter().copied());
    let event_seq = updates.event_seq();
    let states = updates.snapshot();
    Ok((Subscribed { topics, max_hz, event_seq, states }, Following { updates, max_hz }))
}

fn known(gateway: &Gateway, name: &str) -> Result<Name, Problem> {
    let known = name.parse().ok().filter(|name| gateway.grippers.get(name).is_some());
    known.ok_or_else(|| gateway.no_gripper(name, true).field("grippers").value(Some(name.into())))
}
