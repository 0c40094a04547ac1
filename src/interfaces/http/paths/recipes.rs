//! Paths of the recipes.

use super::parameters::{ConditionHeaders, RecipePath};
use super::paths;
use super::responses::{JournalProblem, RecipeProblem};
use crate::operations::recipes::{self, RecipeList, RecipeVersions, RemoveRecipe, SetRecipe, SetRecipes};
use crate::operations::teach::{self, ProposedLimits, Teach};
use crate::recipes::RecipeVersion;

paths! {
    /// List the recipes
    #[utoipa::path(
        get, path = "/recipes", operation_id = "recipes", tag = "recipes",
        responses((status = 200, description = "The recipes, by number", body = RecipeList), JournalProblem)
    )]
    list => recipes::LIST;
    /// Set several recipes
    ///
    /// Creates or changes recipes: all of them, or none if one is refused. Recipes of other parts stay as they are. Two
    /// recipes can swap their numbers in one request.
    #[utoipa::path(
        put, path = "/recipes", operation_id = "set_recipes", tag = "recipes",
        request_body = SetRecipes,
        responses((status = 200, description = "The recipes as they are now", body = RecipeList), RecipeProblem)
    )]
    set_several => recipes::SET_SEVERAL;
    /// Get a recipe
    #[utoipa::path(
        get, path = "/recipes/{part_id}", operation_id = "recipe", tag = "recipes",
        params(RecipePath),
        responses((status = 200, description = "The recipe", body = RecipeVersion, headers(
            ("ETag" = String, description = "The version, for `If-Match`"),
        )), JournalProblem)
    )]
    get => recipes::GET;
    /// Set a recipe
    ///
    /// Creates or replaces the recipe of a part. A change gets a new version, which the records of later grips name.
    /// Setting a recipe to its current values creates no new version.
    #[utoipa::path(
        put, path = "/recipes/{part_id}", operation_id = "set_recipe", tag = "recipes",
        params(RecipePath, ConditionHeaders),
        request_body = SetRecipe,
        responses(
            (status = 200, description = "The changed recipe", body = RecipeVersion, headers(
                ("ETag" = String, description = "The version, for `If-Match`"),
            )),
            (status = 201, description = "The new recipe", body = RecipeVersion, headers(
                ("ETag" = String, description = "The version, for `If-Match`"),
            )),
            RecipeProblem,
        )
    )]
    set => recipes::SET;
    /// Remove a recipe
    ///
    /// Removes the recipe of a part. Its versions stay listed while they are among the newest 1,000 of all recipes.
    #[utoipa::path(
        delete, path = "/recipes/{part_id}", operation_id = "remove_recipe", tag = "recipes",
        params(RecipePath, ConditionHeaders),
        request_body = Option<RemoveRecipe>,
        responses((status = 200, description = "The removal", body = RecipeVersion, headers(
            ("ETag" = String, description = "The version of the removal"),
        )), RecipeProblem)
    )]
    remove => recipes::REMOVE;
    /// List the versions of a recipe
    ///
    /// Lists the versions of a part's recipe. The gateway keeps the newest 1,000 versions of all recipes, and every current
    /// one.
    #[utoipa::path(
        get, path = "/recipes/{part_id}/versions", operation_id = "recipe_versions", tag = "recipes",
        params(RecipePath),
        responses((status = 200, description = "The versions, the newest first", body = RecipeVersions), JournalProblem)
    )]
    versions => recipes::VERSIONS;
    /// Propose limits for a recipe
    ///
    /// Proposes limits from the contact widths of the part's newest grips with outcome `PART_HELD`: their mean minus
    /// and plus `k` standard deviations, or 0.01 mm if that is more. Changes nothing: set the limits with the recipe.
    #[utoipa::path(
        post, path = "/recipes/{part_id}/teach", operation_id = "teach_recipe", tag = "recipes",
        params(RecipePath),
        request_body = Option<Teach>,
        responses((status = 200, description = "The proposed limits", body = ProposedLimits), RecipeProblem)
    )]
    teach => teach::TEACH;
}
