//! Reading: connections of readers, pages and streams of records, commands rebuilt from records, and statistics.

pub(super) mod commands;
pub(super) mod event_stream;
pub(super) mod query;
pub(super) mod reader;
pub(super) mod statistics;
mod time_ranges;
