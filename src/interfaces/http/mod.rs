//! HTTP: REST under `/api/v1`, its OpenAPI document, and the page that shows it.
//!
//! `server` accepts connections, and `router` has the paths. `requests` checks each request and translates it to an
//! operation, or passes it on to the gateway that owns a gripper. `documents` describes the operations. `resources` has
//! what only HTTP serves, and begins WebSockets.

mod context;
mod documents;
mod http_settings;
mod requests;
mod resources;
mod router;
mod server;
#[cfg(test)]
mod tests;
mod web_settings;

pub use context::{API, HttpContext};
pub use documents::docs::{ASYNCAPI, OPENAPI};
pub use http_settings::{HttpSettings, SharedSettings};
pub use requests::guard::check_host_and_origin;
pub use router::openapi;
pub use server::{Listeners, ServerLimits, listen, serve};
pub use web_settings::WebSettings;

/// Makes the AsyncAPI document anew. [`ASYNCAPI`] is the checked-in one.
#[must_use]
pub fn asyncapi_document() -> serde_json::Value {
    documents::asyncapi::document(&openapi())
}
