//! HTTP's paths: each operation with its part of the OpenAPI document.
//!
//! The line that mounts a path names its operation and documents it, so the document can't fall behind.

pub mod commands;
pub mod device;
pub mod fast_stop;
pub mod fingers;
pub mod fleet;
pub mod forwarded;
pub mod grippers;
pub mod lease;
pub mod motion;
mod parameters;
pub mod raw;
pub mod responses;
pub mod settings;

pub use parameters::CommandPath;

/// Declares the handlers of operations, each by a function `serve`.
macro_rules! handlers {
    ($serve:path: $($(#[$attribute:meta])* $name:ident => $operation:expr;)*) => {$(
        $(#[$attribute])*
        pub async fn $name(
            context: axum::extract::State<std::sync::Arc<crate::interfaces::http::Context>>,
            request: axum::extract::Request,
        ) -> Result<axum::response::Response, crate::operations::Problem> {
            $serve(&context, &$operation, request).await
        }
    )*};
}

/// Declares the handlers of operations whose bodies have been read.
macro_rules! paths {
    ($($tokens:tt)*) => { crate::interfaces::http::paths::handlers! { crate::interfaces::http::operation::serve: $($tokens)* } };
}

/// Declares the handlers of FAST STOPs, which wait for no body.
macro_rules! fast_stop_paths {
    ($($tokens:tt)*) => { crate::interfaces::http::paths::handlers! { crate::interfaces::http::fast_stop::serve: $($tokens)* } };
}

use {fast_stop_paths, handlers, paths};
