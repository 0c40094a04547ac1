//! HTTP: REST under `/api/v1`, its OpenAPI document, and the page that shows it.
//!
//! `server` accepts connections, `router` has the paths, `paths` documents those of operations, and `operation`
//! translates. `journal`, `stream`, `gateway` and `docs` are HTTP's own; `upgrade` begins a WebSocket, and `forward`
//! passes requests on to the gateway that owns a gripper. `tickets` are for web pages of other origins.

mod access_log;
mod asked;
mod asyncapi;
mod audit;
mod body;
mod context;
mod docs;
mod fast_stop;
mod field_schemas;
mod flatten;
mod fleet_lists;
mod forward;
mod gateway;
mod guard;
mod guide;
mod handshakes;
mod journal;
mod large;
mod meanings;
mod openapi_document;
mod operation;
mod origin;
mod paths;
mod problem;
mod python;
mod recipes;
mod redirect;
mod refused_sockets;
mod rights;
mod router;
mod runtime_mover;
mod server;
mod session;
mod settings;
mod stream;
mod tickets;
mod turn;
mod unknown_path;
mod upgrade;
mod visitor;
mod wait;

pub use context::{API, HttpContext};
pub use docs::{ASYNCAPI, OPENAPI};
pub use guard::check_host_and_origin;
pub use router::openapi;
pub use server::{Listeners, ServerLimits, listen, serve};
pub use settings::{HttpSettings, SharedSettings};
pub use web::WebSettings;

/// Makes the AsyncAPI document anew, as YAML. [`ASYNCAPI`] is the checked-in one.
pub fn asyncapi() -> Result<String, serde_saphyr::ser::Error> {
    asyncapi::yaml(&openapi())
}

/// Makes the AsyncAPI document anew.
#[must_use]
pub fn asyncapi_document() -> serde_json::Value {
    asyncapi::document(&openapi())
}

#[cfg(test)]
mod tests;
mod web;
