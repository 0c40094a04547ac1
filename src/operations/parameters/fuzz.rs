//! Fuzz target of parameters in JSON.

use std::fmt::Debug;

use serde::de::DeserializeOwned;
use serde_json::Value;

use super::json::{self, StrictJson};
use crate::operations::calls::call::Leased;
use crate::operations::gripper::motion::{Grip, Home, Move, Release, Stop};

/// Checks that the parser of texts (HTTP) and the parser of objects (WebSocket, Zenoh) accept the same bodies.
pub(crate) fn body(data: &[u8]) {
    agrees::<Home>(data);
    agrees::<Move>(data);
    agrees::<Grip>(data);
    agrees::<Release>(data);
    agrees::<Stop>(data);
    agrees::<Leased>(data);
}

fn agrees<P: DeserializeOwned + Debug>(text: &[u8]) {
    let Ok(StrictJson(Value::Object(object))) = serde_json::from_slice(text) else { return };
    let of_text = json::parse::<P>(text);
    let of_object = json::of_object::<P>(&object);
    // With several wrong fields, the parsers may name different ones, so only the codes are compared.
    let of_text = of_text.map(|fields| format!("{fields:?}")).map_err(|problem| problem.code());
    let of_object = of_object.map(|fields| format!("{fields:?}")).map_err(|problem| problem.code());
    assert_eq!(of_text, of_object);
}
