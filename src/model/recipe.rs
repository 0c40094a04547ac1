//! Recipes: the values with which parts of one kind are gripped and released.

use std::collections::BTreeMap;
use std::num::NonZeroU8;

use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::{Name, PartId, Text};

/// Number of a recipe, from 1 to 255, for clients that cannot handle strings.
pub type RecipeNumber = NonZeroU8;

/// Text about a recipe, for people.
pub type RecipeDescription = Text<200>;

/// Values of a recipe. A request must supply required values that the recipe lacks.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct RecipeValues {
    /// Nominal width of the part, in mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1000)]
    pub width_mm: Option<f64>,
    /// Speed of a grip, in mm/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 10000)]
    pub speed_mm_s: Option<f64>,
    /// Force limit of a grip, in N.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 10000)]
    pub force_n: Option<f64>,
    /// Smallest contact width of the right part, in mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1000)]
    pub accept_min_mm: Option<f64>,
    /// Largest contact width of the right part, in mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1000)]
    pub accept_max_mm: Option<f64>,
    /// Width that a release opens to, in mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 1000)]
    pub release_width_mm: Option<f64>,
    /// Speed of a release, in mm/s.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(minimum = 0, maximum = 10000)]
    pub release_speed_mm_s: Option<f64>,
}

impl RecipeValues {
    /// Returns these values, with gaps filled from `others`.
    #[must_use]
    pub fn or(self, others: Self) -> Self {
        Self {
            width_mm: self.width_mm.or(others.width_mm),
            speed_mm_s: self.speed_mm_s.or(others.speed_mm_s),
            force_n: self.force_n.or(others.force_n),
            accept_min_mm: self.accept_min_mm.or(others.accept_min_mm),
            accept_max_mm: self.accept_max_mm.or(others.accept_max_mm),
            release_width_mm: self.release_width_mm.or(others.release_width_mm),
            release_speed_mm_s: self.release_speed_mm_s.or(others.release_speed_mm_s),
        }
    }

    /// Returns the widths at which a grip holds the right part.
    #[must_use]
    pub fn accepted_widths(&self) -> AcceptedWidths {
        AcceptedWidths {
            min_mm: self.accept_min_mm.map(|mm| mm as f32),
            max_mm: self.accept_max_mm.map(|mm| mm as f32),
        }
    }
}

/// A recipe: how parts of one kind are gripped and released.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Recipe {
    /// Id of the part.
    #[schema(value_type = String, min_length = 1, max_length = 48)]
    pub part_id: PartId,
    /// Recipe number, unique on this gateway.
    #[schema(value_type = u8, minimum = 1, maximum = 255)]
    pub number: RecipeNumber,
    #[serde(flatten)]
    pub values: RecipeValues,
    /// Text for people.
    pub description: RecipeDescription,
    /// Values that differ for some grippers, by the gripper's name.
    #[schema(value_type = BTreeMap<String, RecipeValues>)]
    pub grippers: BTreeMap<Name, RecipeValues>,
}

impl Recipe {
    /// Returns the values for a gripper.
    #[must_use]
    pub fn values_for(&self, gripper: &Name) -> RecipeValues {
        self.grippers.get(gripper).copied().unwrap_or_default().or(self.values)
    }
}

/// Contact widths at which a grip holds the right part. Without limits, every width is accepted.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct AcceptedWidths {
    pub min_mm: Option<f32>,
    pub max_mm: Option<f32>,
}

impl AcceptedWidths {
    #[must_use]
    pub fn accept(&self, width_mm: f32) -> bool {
        self.min_mm.is_none_or(|min| width_mm >= min) && self.max_mm.is_none_or(|max| width_mm <= max)
    }
}

/// The recipe that a grip follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AppliedRecipe {
    pub number: RecipeNumber,
    pub version: u64,
    pub accepted: AcceptedWidths,
}

/// The recipe of a command, as requests and records name it. Absent from commands without a recipe.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct RecipeFields {
    /// Number of the recipe.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(value_type = Option<u8>, nullable = false, minimum = 1, maximum = 255)]
    pub recipe: Option<RecipeNumber>,
    /// Version of the recipe.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false, minimum = 1)]
    pub recipe_version: Option<u64>,
    /// Smallest accepted contact width, in mm.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub accept_min_mm: Option<f32>,
    /// Largest accepted contact width, in mm.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub accept_max_mm: Option<f32>,
}

impl From<&AppliedRecipe> for RecipeFields {
    fn from(applied: &AppliedRecipe) -> Self {
        let AcceptedWidths { min_mm, max_mm } = applied.accepted;
        Self {
            recipe: Some(applied.number),
            recipe_version: Some(applied.version),
            accept_min_mm: min_mm,
            accept_max_mm: max_mm,
        }
    }
}

/// Change of a recipe.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RecipeEvent {
    /// Kind of the change.
    pub event: RecipeStep,
    /// Number of the recipe.
    #[schema(value_type = u8, minimum = 1, maximum = 255)]
    pub recipe: RecipeNumber,
    /// Version that the change created.
    #[schema(minimum = 1)]
    pub recipe_version: u64,
    /// The recipe after the change, or before its removal.
    pub definition: Recipe,
}

/// Kind of a change of a recipe.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "snake_case")]
pub enum RecipeStep {
    /// The recipe was created or changed.
    RecipeSet,
    /// The recipe was removed.
    RecipeRemoved,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_a_gripper_override_the_others() {
        let values = RecipeValues { width_mm: Some(20.0), force_n: Some(40.0), ..RecipeValues::default() };
        let right = RecipeValues { force_n: Some(30.0), ..RecipeValues::default() };
        let recipe = Recipe {
            part_id: PartId::new("A-1047").unwrap(),
            number: RecipeNumber::new(12).unwrap(),
            values,
            description: RecipeDescription::new("").unwrap(),
            grippers: [("right".parse().unwrap(), right)].into(),
        };
        assert_eq!(recipe.values_for(&"left".parse().unwrap()), values);
        let of_right = recipe.values_for(&"right".parse().unwrap());
        assert_eq!((of_right.width_mm, of_right.force_n), (Some(20.0), Some(30.0)));
    }

    #[test]
    fn limits_are_inclusive() {
        let accepted = AcceptedWidths { min_mm: Some(19.5), max_mm: Some(20.5) };
        let accepts = [19.4, 19.5, 20.5, 20.6].map(|width_mm| accepted.accept(width_mm));
        assert_eq!(accepts, [false, true, true, false]);
        assert!(AcceptedWidths::default().accept(0.0));
    }
}
