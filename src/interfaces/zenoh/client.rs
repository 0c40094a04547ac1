//! The identity of a client on Zenoh.

use crate::gripper::model::{Client, Door, ShownName};

/// Longest name that a client gives itself, in bytes.
const MAX_CLIENT_BYTES: usize = 64;

/// Returns a client by the name that it gives. Before there are credentials, the name identifies it.
pub fn client(name: Option<&ShownName<MAX_CLIENT_BYTES>>) -> Client {
    let name = name.map_or("unknown", ShownName::as_str);
    Client { subject: format!("zenoh:{name}").into(), door: Door::Zenoh }
}
