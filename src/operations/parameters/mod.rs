//! Parameters from clients: JSON and query strings, parsed and checked.

#[cfg(any(test, fuzzing))]
pub(crate) mod fuzz;
pub(crate) mod json;
pub(crate) mod nearest;
pub(super) mod query_string;
pub(crate) mod values;
