//! Documents: OpenAPI and AsyncAPI, built from the operations, the pages that show them, and the guides.

pub(super) mod asyncapi;
pub(super) mod docs;
mod field_schemas;
mod flatten;
pub(super) mod guide;
mod meanings;
pub(super) mod openapi_document;
pub(super) mod paths;
pub(super) mod python;
