//! A version of a recipe, as it is stored and served.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::model::Recipe;

/// A version of a recipe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct RecipeVersion {
    /// Version number, unique among all recipes of this gateway. Later versions are greater.
    #[schema(minimum = 1)]
    pub version: u64,
    /// Time of the change.
    #[serde(serialize_with = "crate::model::time::milliseconds")]
    pub changed_at: Timestamp,
    /// Subject of the client that made the change.
    pub changed_by: Arc<str>,
    /// Whether the change removed the recipe.
    #[serde(default)]
    pub removed: bool,
    #[serde(flatten)]
    pub recipe: Recipe,
}
