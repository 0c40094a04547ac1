//! The contract that the types of an operation's function state about it, for the API's documents.

use utoipa::ToSchema;
use utoipa::openapi::{RefOr, Schema};

/// Schemas by name.
pub type Schemas = Vec<(String, RefOr<Schema>)>;

/// The contract that the types of an operation's function state.
#[derive(Debug, Clone, Copy)]
pub struct Contract {
    /// Name and schema of the parameters that the path does not name. Adds the schemas that they refer to.
    pub fields: fn(&mut Schemas) -> (String, RefOr<Schema>),
    /// The successful answers. Adds the schemas that they refer to.
    pub answers: fn(&mut Schemas) -> Vec<Answer>,
}

/// A successful answer.
#[derive(Debug)]
pub struct Answer {
    /// HTTP status.
    pub status: u16,
    /// Name of the schema.
    pub schema: String,
    /// Description, if it differs from that of the operation.
    pub description: Option<&'static str>,
    /// A further HTTP header, with its description.
    pub header: Option<(&'static str, &'static str)>,
}

impl Answer {
    /// Returns an answer of this type, and adds its schema.
    pub(in crate::operations) fn of<T: ToSchema>(status: u16, schemas: &mut Schemas) -> Self {
        let named = described::<T>(schemas);
        let schema = named.0.clone();
        schemas.push(named);
        Self { status, schema, description: None, header: None }
    }
}

/// Returns a type's name and schema, and adds the schemas that it refers to.
pub(in crate::operations) fn described<T: ToSchema>(schemas: &mut Schemas) -> (String, RefOr<Schema>) {
    T::schemas(schemas);
    (T::name().into_owned(), T::schema())
}
