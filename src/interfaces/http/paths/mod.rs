//! HTTP paths: each operation with its part of the OpenAPI document.
//!
//! The router mounts the documented handlers themselves, so the document can't fall behind.

pub mod alarms;
pub mod clock;
pub mod commands;
pub mod connection;
pub mod device;
pub mod fast_stop;
pub mod finger_set;
pub mod fingers;
pub mod fleet;
pub mod grippers;
pub mod lease;
pub mod me;
pub mod motion;
mod parameters;
pub mod raw;
pub mod recipes;
pub mod reload;
pub mod responses;
pub mod settings;
pub mod statistics;
pub mod webhooks;

pub use parameters::CommandPath;

/// Declares the handlers of operations.
macro_rules! paths {
    ($($(#[$attribute:meta])* $name:ident => $operation:expr;)*) => {$(
        $(#[$attribute])*
        pub async fn $name(
            context: axum::extract::State<std::sync::Arc<crate::interfaces::http::HttpContext>>,
            request: axum::extract::Request,
        ) -> Result<axum::response::Response, crate::operations::Problem> {
            crate::interfaces::http::operation::serve(&context, &$operation, request).await
        }
    )*};
}

use paths;
