//! The identity of a client on Zenoh.

use crate::gripper::model::{Client, Door, ShownName};

/// Maximum length of a client's name, in bytes.
const MAX_CLIENT_BYTES: usize = 64;

/// Returns a client by the name that it claims. A client with a token is named after its token instead.
pub fn client(name: Option<&ShownName<MAX_CLIENT_BYTES>>) -> Client {
    let name = name.map_or("unknown", ShownName::as_str);
    Client::new(format!("zenoh:{name}"), Door::Zenoh)
}
