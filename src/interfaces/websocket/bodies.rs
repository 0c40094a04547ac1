//! What `subscribe` takes, and what it answers.

use std::collections::BTreeSet;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use crate::events::{DEFAULT_HZ, MAX_HZ, Subscription, Topic};
use crate::gripper::model::{Name, State};
use crate::operations::values::integer;
use crate::operations::{Gateway, Problem, json};

/// What to follow. It replaces what was followed before; no topic ends it.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"grippers": ["left"], "topics": ["state", "events"], "max_hz": 20}))]
pub struct Subscribe {
    /// Their names; all of them where it is left out. Events that concern no gripper come only then.
    #[schema(nullable = false)]
    grippers: Option<Vec<String>>,
    /// What to be told of.
    topics: BTreeSet<Topic>,
    /// How many states and telemetry a second at most, of each gripper; of the fleet 10 in any case.
    #[schema(value_type = Option<u64>, nullable = false, minimum = 1, maximum = 100, default = 10)]
    max_hz: Option<f64>,
}

/// How things are, from where the notifications go on.
#[derive(Debug, Serialize, ToSchema)]
pub struct Subscribed {
    /// What is followed.
    topics: BTreeSet<Topic>,
    /// How many states and telemetry a second come at most, of each gripper.
    #[schema(minimum = 1, maximum = 100)]
    max_hz: u64,
    /// The newest event: notifications begin behind it.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    event_seq: i64,
    /// The grippers' states now.
    #[schema(value_type = Vec<State>)]
    states: Vec<Arc<State>>,
}

/// A subscription, and how often its states are told.
pub struct Following {
    pub updates: Subscription,
    pub max_hz: u64,
}

/// Follows what is asked for.
pub fn subscribe(gateway: &Gateway, params: &Value) -> Result<(Subscribed, Following), Problem> {
    let Subscribe { grippers, topics, max_hz } = json::parse(params.to_string().as_bytes())?;
    let names = grippers.map(|names| names.iter().map(|name| known(gateway, name)).collect()).transpose()?;
    let max_hz = max_hz.map_or(Ok(DEFAULT_HZ), |number| integer("max_hz", number, 1..=MAX_HZ))?;
    let event_seq = gateway.journal.last_seq();
    let mut updates = gateway.updates.subscribe(names.as_ref(), topics.iter().copied());
    let states = updates.snapshot();
    Ok((Subscribed { topics, max_hz, event_seq, states }, Following { updates, max_hz }))
}

fn known(gateway: &Gateway, name: &str) -> Result<Name, Problem> {
    let known = name.parse().ok().filter(|name| gateway.grippers.get(name).is_some());
    known.ok_or_else(|| Problem::not_found("gripper of this name").field("grippers").value(Some(name.into())))
}
