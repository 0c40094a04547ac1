//! Guides, and documents of the API.

mod generated_names;
mod guides;
