//! Recipes: reading, setting and removing them.

pub(crate) mod copy_recipes;
pub(super) mod requested_recipe;
pub(crate) mod teach;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::calls::call::{Call, NoFields};
use super::calls::durable_changes::{check_journal, durable};
use super::calls::operation::operations;
use super::calls::reply::{Json, Versioned};
use super::parameters::values::{GivenNumber, PartIdText, VersionOrNone, part_id, shortened, text};
use super::problem::Problem;
use crate::gripper::limits::{FASTEST_MM_S, STRONGEST_N, WIDEST_MM};
use crate::model::{Code, Name, PartId, Recipe, RecipeDescription, RecipeNumber, RecipeValues};
use crate::recipes::{ExpectedVersion, RecipeChange, RecipeConflict, RecipeVersion};

operations! {
    /// List the recipes
    LIST = GET "/recipes" as "recipes" {
        run: list, id: "recipes", tag: "recipes", problems: JOURNAL,
        answer: "The recipes, by number",
    };

    /// Set several recipes
    ///
    /// Creates or changes recipes: all of them, or none if one is refused. Recipes of other parts stay as they are. Two
    /// recipes can swap their numbers in one request.
    SET_SEVERAL = PUT "/recipes" as "recipes.set" {
        run: set_several, id: "set_recipes", tag: "recipes", problems: RECIPE,
        answer: "The recipes as they are now",
    }.conditional();

    /// Get a recipe
    GET = GET "/recipes/{part_id}" as "recipe" {
        run: get, id: "recipe", tag: "recipes", problems: JOURNAL,
        answer: "The recipe",
    };

    /// List the versions of a recipe
    ///
    /// Lists the versions of a part's recipe. The gateway keeps the newest 1,000 versions of all recipes, and every current
    /// one.
    VERSIONS = GET "/recipes/{part_id}/versions" as "recipe.versions" {
        run: versions, id: "recipe_versions", tag: "recipes", problems: JOURNAL,
        answer: "The versions, the newest first",
    };

    /// Set a recipe
    ///
    /// Creates or replaces the recipe of a part. A change gets a new version, which the records of later grips name.
    /// Setting a recipe to its current values creates no new version.
    SET = PUT "/recipes/{part_id}" as "recipe.set" {
        run: set, id: "set_recipe", tag: "recipes", problems: RECIPE,
        answer: "The changed recipe",
    }.conditional().creating("The new recipe");

    /// Remove a recipe
    ///
    /// Removes the recipe of a part. Its versions stay listed while they are among the newest 1,000 of all recipes.
    REMOVE = DELETE "/recipes/{part_id}" as "recipe.remove" {
        run: remove, id: "remove_recipe", tag: "recipes", problems: RECIPE,
        answer: "The removal",
    }.conditional();
}

/// Problem of a refused change.
const UNCHANGED: &str = "no recipe was changed";

/// Maximum number of recipes in a request: one for each number.
pub const MAX_RECIPES: usize = 255;

/// Field that names the version that a change expects.
const IF_VERSION: &str = "if_version";

/// Maximum number of grippers with overrides in a recipe.
const MAX_GRIPPERS: usize = 16;

/// All recipes.
#[derive(Debug, Serialize, ToSchema)]
pub struct RecipeList {
    /// The recipes, by number.
    recipes: Vec<Arc<RecipeVersion>>,
}

/// The kept versions of a recipe.
#[derive(Debug, Serialize, ToSchema)]
pub struct RecipeVersions {
    /// The versions, the newest first. A version with `removed` is the removal of the recipe.
    versions: Vec<Arc<RecipeVersion>>,
}

/// A recipe to set. Each grip or release must supply required values that the recipe lacks.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({
    "number": 12, "width_mm": 20.0, "speed_mm_s": 50.0, "force_n": 40.0, "accept_min_mm": 19.5, "accept_max_mm": 20.5,
    "release_width_mm": 30.0, "release_speed_mm_s": 100.0, "description": "bearing ring, left nest"
}))]
pub struct SetRecipe {
    /// Id of the part: at most 48 bytes, or a whole number, which is stored as text. Required in a list of recipes.
    part_id: Option<PartIdText>,
    /// Recipe number, unique on this gateway.
    number: GivenNumber,
    /// Nominal width of the part, in mm.
    #[schema(minimum = 0, maximum = 1000)]
    width_mm: Option<f64>,
    /// Speed of a grip, in mm/s.
    #[schema(minimum = 0, maximum = 10000)]
    speed_mm_s: Option<f64>,
    /// Force limit of a grip, in N.
    #[schema(minimum = 0, maximum = 10000)]
    force_n: Option<f64>,
    /// Smallest contact width of the right part, in mm.
    #[schema(minimum = 0, maximum = 1000)]
    accept_min_mm: Option<f64>,
    /// Largest contact width of the right part, in mm.
    #[schema(minimum = 0, maximum = 1000)]
    accept_max_mm: Option<f64>,
    /// Width that a release opens to, in mm.
    #[schema(minimum = 0, maximum = 1000)]
    release_width_mm: Option<f64>,
    /// Speed of a release, in mm/s; by default that of a grip.
    #[schema(minimum = 0, maximum = 10000)]
    release_speed_mm_s: Option<f64>,
    /// Text for people. At most 200 bytes.
    #[schema(max_length = 200, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$")]
    description: Option<String>,
    /// Values that differ for some grippers, by the gripper's name. At most 16 grippers.
    #[schema(value_type = Option<BTreeMap<String, RecipeValues>>)]
    grippers: Option<BTreeMap<String, RecipeValues>>,
    /// Version that the recipe must have, like `If-Match` over HTTP; 0 if there must be no recipe yet.
    if_version: Option<VersionOrNone>,
}

/// Several recipes to set.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"recipes": [{"part_id": "A-1047", "number": 12, "width_mm": 20.0, "speed_mm_s": 50.0}]}))]
pub struct SetRecipes {
    /// The recipes. Recipes of other parts stay as they are.
    #[schema(min_items = 1, max_items = 255)]
    recipes: Vec<SetRecipe>,
}

/// The removal of a recipe.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({}))]
pub struct RemoveRecipe {
    /// Version that the recipe must have, like `If-Match` over HTTP.
    if_version: Option<VersionOrNone>,
}

fn list(call: &Call<NoFields>) -> Result<Json<RecipeList>, Problem> {
    let NoFields {} = call.fields()?;
    Ok(Json(RecipeList { recipes: call.gateway.recipes.all() }))
}

fn get(call: &Call<NoFields>) -> Result<Versioned<RecipeVersion>, Problem> {
    let NoFields {} = call.fields()?;
    let found = call.gateway.recipes.of_part(&call.part_id()?).ok_or_else(no_recipe)?;
    Ok(Versioned { version: found.version, is_new: false, result: found })
}

fn versions(call: &Call<NoFields>) -> Result<Json<RecipeVersions>, Problem> {
    let NoFields {} = call.fields()?;
    let versions = call.gateway.recipes.versions(&call.part_id()?);
    if versions.is_empty() { Err(no_recipe()) } else { Ok(Json(RecipeVersions { versions })) }
}

async fn set(call: Call<SetRecipe>) -> Result<Versioned<RecipeVersion>, Problem> {
    let part_id = call.part_id()?;
    let given: SetRecipe = call.fields()?;
    if given.part_id.as_ref().is_some_and(|other| other.to_string() != part_id.as_str()) {
        return Err(Problem::malformed("part_id", "part_id differs from the part in the path"));
    }
    let expected = expected(&call, given.if_version)?;
    let recipe = given.recipe(part_id, "")?;
    let (mut set, is_new) = change(&call, vec![(recipe, expected)]).await?;
    let set = set.pop().ok_or_else(Problem::internal)?;
    Ok(Versioned { version: set.version, is_new, result: set })
}

async fn set_several(call: Call<SetRecipes>) -> Result<Json<RecipeList>, Problem> {
    let SetRecipes { recipes: given } = call.fields()?;
    if call.params.expected != ExpectedVersion::Any {
        let detail = "If-Match and If-None-Match need a single recipe: use if_version in each recipe of the list";
        return Err(Problem::malformed("If-Match", detail));
    }
    if !(1..=MAX_RECIPES).contains(&given.len()) {
        return Err(Problem::malformed("recipes", format!("recipes must have 1 to {MAX_RECIPES} recipes")));
    }
    let mut recipes = Vec::new();
    let mut parts = BTreeSet::new();
    for (index, given) in given.into_iter().enumerate() {
        let place = format!("recipes[{index}].");
        let field = format!("{place}part_id");
        let Some(part) = &given.part_id else {
            return Err(Problem::malformed(&field, format!("{field} is missing")));
        };
        let part_id = part_id(&field, &part.to_string())?;
        if !parts.insert(part_id.as_str().to_owned()) {
            return Err(Problem::malformed(&field, format!("{field}: an earlier recipe is of the same part")));
        }
        let expected = version_expected(&format!("{place}{IF_VERSION}"), given.if_version)?;
        recipes.push((given.recipe(part_id, &place)?, expected));
    }
    Ok(Json(RecipeList { recipes: change(&call, recipes).await?.0 }))
}

async fn remove(call: Call<RemoveRecipe>) -> Result<Versioned<RecipeVersion>, Problem> {
    let part_id = call.part_id()?;
    let RemoveRecipe { if_version } = call.fields()?;
    let expected = expected(&call, if_version)?;
    check_change(&call)?;
    let removed = call.gateway.recipes.remove(&part_id, expected, &call.caller.client)?.ok_or_else(no_recipe)?;
    let removed = saved(removed).await?.pop().ok_or_else(Problem::internal)?;
    Ok(Versioned { version: removed.version, is_new: false, result: removed })
}

/// Sets recipes, and returns their versions, and whether one is new.
async fn change<P>(
    call: &Call<P>,
    recipes: Vec<(Recipe, ExpectedVersion)>,
) -> Result<(Vec<Arc<RecipeVersion>>, bool), Problem> {
    check_change(call)?;
    let change = call.gateway.recipes.set(recipes, &call.caller.client)?;
    let has_new_recipe = change.has_new_recipe;
    Ok((saved(change).await?, has_new_recipe))
}

/// Refuses a change that would not become durable, or that exceeds its client's rate.
fn check_change<P>(call: &Call<P>) -> Result<(), Problem> {
    check_journal(call, UNCHANGED)?;
    if call.gateway.journal.allows_change(&call.caller.client) {
        return Ok(());
    }
    let detail = "this client changes recipes faster than the journal may grow: no recipe was changed; wait a second for \
                  each further one";
    Err(Problem::new(Code::Overloaded, detail))
}

/// Returns the versions of a change once it is durable.
async fn saved(change: RecipeChange) -> Result<Vec<Arc<RecipeVersion>>, Problem> {
    match change.durable {
        Some(waiting) => durable(waiting).await.map(|()| change.versions),
        None => Ok(change.versions),
    }
}

fn no_recipe() -> Problem {
    Problem::not_found("recipe for this part: GET /recipes lists all").field("part_id")
}

/// Parses the version that a change expects.
fn version_expected(field: &str, if_version: Option<VersionOrNone>) -> Result<ExpectedVersion, Problem> {
    let version = if_version.map(|version| version.checked(field)).transpose()?;
    Ok(match version {
        None => ExpectedVersion::Any,
        Some(0) => ExpectedVersion::Absent,
        Some(version) => ExpectedVersion::Exactly(version),
    })
}

/// Returns the version that a change expects, which a client can send in a header or among the parameters.
fn expected<P>(call: &Call<P>, if_version: Option<VersionOrNone>) -> Result<ExpectedVersion, Problem> {
    match (call.params.expected, version_expected(IF_VERSION, if_version)?) {
        (ExpectedVersion::Any, among) => Ok(among),
        (alongside, ExpectedVersion::Any) => Ok(alongside),
        (alongside, among) if alongside == among => Ok(among),
        _ => Err(Problem::malformed(IF_VERSION, "if_version differs between the header and the body: send it once")),
    }
}

impl SetRecipe {
    /// Checks the values. `place` precedes the names of fields in problems.
    fn recipe(self, part_id: PartId, place: &str) -> Result<Recipe, Problem> {
        let values = RecipeValues {
            width_mm: self.width_mm,
            speed_mm_s: self.speed_mm_s,
            force_n: self.force_n,
            accept_min_mm: self.accept_min_mm,
            accept_max_mm: self.accept_max_mm,
            release_width_mm: self.release_width_mm,
            release_speed_mm_s: self.release_speed_mm_s,
        };
        check(&values, place)?;
        let number = self.number.checked(&format!("{place}number"))?;
        let number = u8::try_from(number).ok().and_then(RecipeNumber::new).ok_or_else(Problem::internal)?;
        let description: RecipeDescription =
            text(&format!("{place}description"), self.description.as_deref().unwrap_or_default())?;
        let given = self.grippers.unwrap_or_default();
        if given.len() > MAX_GRIPPERS {
            let field = format!("{place}grippers");
            return Err(Problem::malformed(&field, format!("{field} must have at most {MAX_GRIPPERS} grippers")));
        }
        let mut grippers = BTreeMap::new();
        for (name, own) in given {
            let place = format!("{place}grippers.{}", shortened(&name));
            let name: Name = name.parse().map_err(|error| Problem::malformed(&place, format!("{place}: {error}")))?;
            // The accepted widths can come partly from the gripper's own values and partly from the common ones.
            check(&own.or(values), &format!("{place}."))?;
            grippers.insert(name, own);
        }
        Ok(Recipe { part_id, number, values, description, grippers })
    }
}

/// Checks that values are possible for some gripper.
fn check(values: &RecipeValues, place: &str) -> Result<(), Problem> {
    let fields = [
        ("width_mm", values.width_mm, WIDEST_MM),
        ("speed_mm_s", values.speed_mm_s, FASTEST_MM_S),
        ("force_n", values.force_n, STRONGEST_N),
        ("accept_min_mm", values.accept_min_mm, WIDEST_MM),
        ("accept_max_mm", values.accept_max_mm, WIDEST_MM),
        ("release_width_mm", values.release_width_mm, WIDEST_MM),
        ("release_speed_mm_s", values.release_speed_mm_s, FASTEST_MM_S),
    ];
    for (field, value, max) in fields {
        let max = f64::from(max);
        if let Some(value) = value.filter(|value| !(0.0..=max).contains(value)) {
            return Err(Problem::out_of_range(&format!("{place}{field}"), value, 0.0, max));
        }
    }
    match (values.accept_min_mm, values.accept_max_mm) {
        (Some(min), Some(max)) if min > max => {
            let field = format!("{place}accept_min_mm");
            let detail = format!("{field} is {min}, which is greater than accept_max_mm, {max}");
            Err(Problem::malformed(field, detail))
        }
        _ => Ok(()),
    }
}

impl From<RecipeConflict> for Problem {
    fn from(conflict: RecipeConflict) -> Self {
        match conflict {
            RecipeConflict::NumberTaken { number, by } => {
                let detail = format!("number {number} belongs to the recipe of part {:?}: use another", by.as_str());
                Self::new(Code::NumberTaken, detail).field("number").value(Some(number.get().into()))
            }
            RecipeConflict::OtherVersion { part_id, version } => {
                let part_id = part_id.as_str();
                let now = version.map_or_else(
                    || format!("part {part_id:?} has no recipe"),
                    |version| format!("the recipe of part {part_id:?} has version {version}"),
                );
                let detail = format!(
                    "{now}, but the request expects another version: read the recipe again, then repeat the change"
                );
                Self::new(Code::PreconditionFailed, detail)
            }
        }
    }
}
