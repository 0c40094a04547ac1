//! Versions of the program and of everything that it speaks.

use crate::fleet::keys;
use crate::interfaces::{http, websocket};
use crate::journal;

/// Commit that the program was built from. `deploy/build.rs` sets it.
const COMMIT: &str = env!("WSG_GATEWAY_COMMIT");

/// Returns the text of `--version`, which follows the program's name.
pub(super) fn long() -> String {
    let version = env!("CARGO_PKG_VERSION");
    let http = http::API;
    let websocket = websocket::SUBPROTOCOL;
    let zenoh = keys::ROOT;
    let journal = journal::VERSION;
    format!(
        "{version}\ncommit: {COMMIT}\ndevice protocol: WSG, firmware 2 and 4\nHTTP API: {http}\n\
         WebSocket: {websocket}\nZenoh: {zenoh}\njournal format: {journal}"
    )
}
