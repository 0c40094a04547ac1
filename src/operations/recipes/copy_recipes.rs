//! Copies of recipes to another gateway.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use serde_json::json;
use serde_json::value::RawValue;
use utoipa::ToSchema;

use super::{MAX_RECIPES, SET_SEVERAL};
use crate::fleet::{NoAnswer, PeerRequest};
use crate::model::{Code, Name, Recipe, Urgency};
use crate::operations::calls::call::Call;
use crate::operations::calls::operation::operations;
use crate::operations::calls::reply::Json;
use crate::operations::fleet::no_answer;
use crate::operations::parameters::values::{FullPartId, gripper_or_gateway, part_id};
use crate::operations::problem::Problem;

operations! {
    /// Copy recipes to another gateway
    ///
    /// Sets recipes of this gateway on another one: all that are named, or none if it refuses one, e.g. because a number
    /// belongs to another part there. Its further recipes stay as they are. The two gateways do not follow each other's
    /// later changes.
    COPY = POST "/fleet/copy-recipes" as "fleet.copy-recipes" {
        run: copy, id: "copy_recipes", tag: "recipes", problems: COPY,
        answer: "The other gateway has the recipes",
    };
}

/// Recipes to copy to another gateway.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"gateway": "cell-8", "part_ids": ["A-1047"]}))]
pub struct CopyRecipes {
    /// Name of the other gateway.
    #[schema(min_length = 1, max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$")]
    gateway: String,
    /// Parts whose recipes are copied; all by default.
    #[schema(min_items = 1, max_items = 255)]
    part_ids: Option<Vec<FullPartId>>,
}

/// Result of a copy.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"gateway": "cell-8", "copied": ["A-1047"]}))]
pub struct RecipesCopied {
    /// Name of the other gateway.
    gateway: String,
    /// Parts whose recipes were copied. The other gateway assigns its own versions.
    copied: Vec<String>,
}

async fn copy(call: Call<CopyRecipes>) -> Result<Json<RecipesCopied>, Problem> {
    let CopyRecipes { gateway, part_ids } = call.fields()?;
    let to = gripper_or_gateway("gateway", &gateway)?;
    if call.gateway.peers.is_own(&to) {
        return Err(Problem::malformed("gateway", "gateway is this gateway: name another one of the fleet"));
    }
    let recipes = chosen(&call, part_ids)?;
    let copied = recipes.iter().map(|recipe| recipe.part_id.as_str().to_owned()).collect();
    let ask = PeerRequest {
        gateway: to.clone(),
        gripper: None,
        method: SET_SEVERAL.name,
        params: json!({"recipes": recipes}),
        wait: None,
        aside: Vec::new(),
        client: call.caller.client.clone(),
        urgency: Urgency::None,
    };
    match call.gateway.peers.ask(ask).await {
        Ok(Ok(_)) => Ok(Json(RecipesCopied { gateway, copied })),
        Ok(Err((_, problem))) => Err(refused(&to, &problem)),
        Err(NoAnswer::None) => {
            let detail =
                format!("gateway {to} did not answer: it may have set the recipes. Repeat the copy, which is safe");
            Err(Problem::new(Code::GatewayTimeout, detail))
        }
        Err(why) => Err(no_answer(&to, why)),
    }
}

fn chosen<P>(call: &Call<P>, part_ids: Option<Vec<FullPartId>>) -> Result<Vec<Recipe>, Problem> {
    let all = call.gateway.recipes.all().into_iter().map(|version| version.recipe.clone());
    let Some(given) = part_ids else {
        let all: Vec<_> = all.collect();
        return if all.is_empty() { Err(Problem::not_found("recipes to copy: set one first")) } else { Ok(all) };
    };
    if !(1..=MAX_RECIPES).contains(&given.len()) {
        return Err(Problem::malformed("part_ids", format!("part_ids must have 1 to {MAX_RECIPES} parts")));
    }
    let mut parts = BTreeSet::new();
    for given in given {
        parts.insert(part_id("part_ids", &given.to_string())?.as_str().to_owned());
    }
    let recipes: Vec<_> = all.filter(|recipe| parts.remove(recipe.part_id.as_str())).collect();
    match parts.pop_first() {
        Some(missing) => Err(Problem::not_found(format!("recipe for part {missing:?}")).field("part_ids")),
        None => Ok(recipes),
    }
}

/// The problem of a copy that the other gateway refused. A conflict names the number to change.
fn refused(gateway: &Name, problem: &RawValue) -> Problem {
    #[derive(Deserialize)]
    struct RefusedCopy {
        code: Code,
        detail: String,
    }
    match serde_json::from_str(problem.get()) {
        // The caller's own credential is not the one that lacks a right.
        Ok(RefusedCopy { code: Code::Unauthorized | Code::Forbidden, detail }) => {
            let remedy = "set its zenoh_role so that it accepts changes from this gateway";
            Problem::new(Code::Forbidden, format!("gateway {gateway} refused the recipes: {detail}; {remedy}"))
        }
        Ok(RefusedCopy { code, detail }) => {
            Problem::new(code, format!("gateway {gateway} refused the recipes: {detail}"))
        }
        Err(error) => {
            tracing::warn!(%gateway, %error, "another gateway's refusal of recipes has an unknown code");
            Problem::new(Code::DeviceProtocol, format!("gateway {gateway} refused the recipes with an unknown code"))
        }
    }
}
