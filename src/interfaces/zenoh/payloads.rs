//! The JSON of queries and of their replies.

use serde::Deserialize;
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use super::clients::Bond;
use crate::operations::parameters::json::{self, MAX_BODY_BYTES};
use crate::operations::{Code, Problem};

/// Field of the reply to `lease.take` that says what binds the lease.
const BOUND_TO: &str = "bound_to";

/// Parses a query's payload, within the bounds of a request's body.
pub fn body(payload: &[u8]) -> Result<Map<String, Value>, Problem> {
    if payload.len() > MAX_BODY_BYTES {
        let bytes = payload.len();
        let max = MAX_BODY_BYTES;
        let detail = format!("the payload has {bytes} bytes; at most {max} are allowed");
        return Err(Problem::new(Code::TooLarge, detail).value(Some(bytes.into())).limits(None, Some(max.into())));
    }
    json::object(payload)
}

/// Returns the holder's name in a request for a lease.
pub fn holder(params: &Map<String, Value>) -> Option<String> {
    #[derive(Deserialize)]
    struct Take {
        holder: String,
    }
    Take::deserialize(params).ok().map(|Take { holder }| holder)
}

/// Adds to the reply to `lease.take` what the lease is bound to.
pub fn with_bond(lease: &RawValue, bond: Option<&Bond>) -> Option<Box<RawValue>> {
    let mut lease: Map<String, Value> = serde_json::from_str(lease.get()).ok()?;
    lease.insert(BOUND_TO.to_owned(), bond.map(Bond::name).into());
    serde_json::value::to_raw_value(&lease).ok()
}

pub fn problem_json(problem: &Problem) -> String {
    serde_json::to_string(problem).unwrap_or_default()
}
