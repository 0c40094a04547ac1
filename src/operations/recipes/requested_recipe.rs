//! The recipe that a grip or release uses, found by its number or else by the part's id.

use std::sync::Arc;

use crate::model::{AppliedRecipe, Code, PartId, RecipeNumber, RecipeValues};
use crate::operations::calls::call::Call;
use crate::operations::parameters::values::{PartIdText, RecipeOrNone, Version, text};
use crate::operations::problem::Problem;
use crate::recipes::RecipeVersion;

/// The part of a request, and its recipe, if it has one.
#[derive(Debug)]
pub struct RequestedRecipe {
    part_id: Option<PartId>,
    recipe: Option<Arc<RecipeVersion>>,
    /// Values of the recipe for the request's gripper.
    values: RecipeValues,
}

impl RequestedRecipe {
    /// Finds the recipe of a request, by its number (0 for none) or its part. `is_complete` states whether the request has
    /// all required values. Such a request uses a recipe only if it names one by its number. `version` is the version that
    /// the recipe must have.
    ///
    /// # Errors
    /// A problem if a value is invalid, if the number is unknown, or if the recipe has another version.
    pub fn of<P>(
        call: &Call<P>,
        number: Option<RecipeOrNone>,
        version: Option<Version>,
        part_id: Option<PartIdText>,
        is_complete: bool,
    ) -> Result<Self, Problem> {
        // Blocks with fixed fields send an empty one.
        let part_id = part_id.map(|given| given.to_string()).filter(|given| !given.is_empty());
        let part_id = part_id.map(|given| text("part_id", &given)).transpose()?;
        let recipes = &call.gateway.recipes;
        let number = number.map(|number| number.checked("recipe")).transpose()?;
        let recipe = match number {
            Some(0) => None,
            Some(number) => {
                let found =
                    u8::try_from(number).ok().and_then(RecipeNumber::new).and_then(|one| recipes.of_number(one));
                Some(found.ok_or_else(|| {
                    Problem::not_found(format!("recipe {number}: GET /recipes lists all")).field("recipe")
                })?)
            }
            None if is_complete => None,
            None => part_id.as_ref().and_then(|part_id| recipes.of_part(part_id)),
        };
        let version = version.map(|version| version.checked("recipe_version")).transpose()?;
        let found = recipe.as_ref().map(|one| one.version);
        if version.is_some() && version != found {
            let found = found.map_or_else(|| "no recipe is used".to_owned(), |found| format!("its version is {found}"));
            let detail = format!("the recipe does not have the expected recipe_version: {found}. Read it again");
            return Err(Problem::new(Code::PreconditionFailed, detail).field("recipe_version"));
        }
        let values = match (&recipe, call.params.gripper()) {
            (Some(one), Some(gripper)) => one.recipe.values_for(&gripper),
            (Some(one), None) => one.recipe.values,
            (None, _) => RecipeValues::default(),
        };
        let part_id = part_id.or_else(|| recipe.as_ref().map(|one| one.recipe.part_id.clone()));
        Ok(Self { part_id, recipe, values })
    }

    /// Values of the recipe for the request's gripper.
    pub fn values(&self) -> RecipeValues {
        self.values
    }

    /// Returns a value that the request or the recipe must have.
    pub fn required(&self, field: &str, value: Option<f64>) -> Result<f64, Problem> {
        if let Some(value) = value {
            return Ok(value);
        }
        let detail = match (&self.recipe, &self.part_id) {
            (Some(one), _) => format!("{field} is missing in the request and in recipe {}", one.recipe.number),
            (None, Some(part_id)) => {
                format!("{field} is missing: send it, since no recipe is used for part {:?}", part_id.as_str())
            }
            (None, None) => format!("{field} is missing: send it, or send part_id or recipe"),
        };
        Err(Problem::malformed(field, detail))
    }

    /// Returns the recipe as the gripper's actor applies it.
    pub fn applied(&self) -> Option<AppliedRecipe> {
        let RecipeVersion { version, recipe, .. } = &**self.recipe.as_ref()?;
        Some(AppliedRecipe { number: recipe.number, version: *version, accepted: self.values.accepted_widths() })
    }

    pub fn part_id(&self) -> Option<PartId> {
        self.part_id.clone()
    }
}
