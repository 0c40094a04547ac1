//! Requests: their handling by kind, and their replies.

mod commands;
pub(crate) mod device_settings;
pub(crate) mod getters;
mod motions;
pub(crate) mod replies;
pub(crate) mod steering;
mod stops;
