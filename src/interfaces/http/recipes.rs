//! Recipes as CSV, for spreadsheets. A row with a gripper has the values that differ for that gripper.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::extract::{Request, State as Shared};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value, json};

use super::body;
use super::context::HttpContext;
use super::journal::CSV;
use super::operation::{RequestBody, serve_below};
use super::paths::responses::{JournalProblem, RecipeProblem};
use crate::gripper::model::Recipe;
use crate::journal::csv::{original, table};
use crate::operations::recipes::{MAX_RECIPES, RecipeList, SET_SEVERAL};
use crate::operations::values::shortened;
use crate::operations::{Fields, Problem};

const PART_ID: &str = "part_id";
const GRIPPER: &str = "gripper";
const GRIPPERS: &str = "grippers";
const TEXTS: [&str; 3] = [PART_ID, GRIPPER, "description"];

const COLUMNS: &[&str] = &[
    PART_ID,
    "number",
    GRIPPER,
    "width_mm",
    "speed_mm_s",
    "force_n",
    "accept_min_mm",
    "accept_max_mm",
    "release_width_mm",
    "release_speed_mm_s",
    "description",
];

/// Export the recipes as a table
///
/// Returns the recipes as CSV, for `PUT /recipes.csv` of this gateway or another. A row with a gripper has the values
/// that differ for that gripper. Text that a spreadsheet would run as a formula (it begins with `=`, `+`, `-`, `@`, a
/// tab or a line break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/recipes.csv", operation_id = "recipes_csv", tag = "recipes",
    responses((status = 200, description = "The recipes", body = String, content_type = "text/csv"), JournalProblem)
)]
pub async fn get_csv(Shared(context): Shared<Arc<HttpContext>>) -> Response {
    let recipes = context.gateway.recipes.all();
    let rows = table(COLUMNS, recipes.iter().flat_map(|version| rows(&version.recipe)));
    ([(header::CONTENT_TYPE, CSV)], rows).into_response()
}

/// Import recipes from a table
///
/// Sets the recipes of a table with the columns of `GET /recipes.csv`: all of them, or none if one is refused. Each
/// recipe is replaced as a whole, so that an absent column or an empty cell clears the value. Recipes of other parts stay
/// as they are. Only `part_id` and `number` are required.
#[utoipa::path(
    put, path = "/recipes.csv", operation_id = "set_recipes_csv", tag = "recipes",
    request_body(content = String, content_type = "text/csv"),
    responses((status = 200, description = "The recipes as they are now", body = RecipeList), RecipeProblem)
)]
pub async fn set_csv(Shared(context): Shared<Arc<HttpContext>>, request: Request) -> Result<Response, Problem> {
    let (parts, stream) = request.into_parts();
    let recipes = parse(&body::bytes(stream).await?)?;
    let recipes: Value = recipes.into_iter().map(Value::Object).collect();
    let fields = Fields::Object(Map::from_iter([("recipes".to_owned(), recipes)]));
    serve_below(&context, &SET_SEVERAL, BTreeMap::new(), &parts, RequestBody::Parsed(fields)).await
}

/// Returns the row of a recipe, and those of its grippers.
fn rows(recipe: &Recipe) -> Vec<Map<String, Value>> {
    let Ok(Value::Object(mut fields)) = serde_json::to_value(recipe) else { return Vec::new() };
    let Some(Value::Object(grippers)) = fields.remove(GRIPPERS) else { return vec![fields] };
    let part_id = fields.get(PART_ID).cloned().unwrap_or_default();
    let of_gripper = |(gripper, values): (String, Value)| {
        let Value::Object(mut values) = values else { return Map::new() };
        values.extend([(PART_ID.to_owned(), part_id.clone()), (GRIPPER.to_owned(), gripper.into())]);
        values
    };
    let others: Vec<_> = grippers.into_iter().map(of_gripper).collect();
    [vec![fields], others].concat()
}

/// Parses a table to the recipes of a request, in the order of their first rows.
fn parse(table: &[u8]) -> Result<Vec<Map<String, Value>>, Problem> {
    let table = table.strip_prefix("\u{FEFF}".as_bytes()).unwrap_or(table);
    let mut reader = csv::Reader::from_reader(table);
    let invalid = |error: csv::Error| Problem::malformed("body", format!("invalid CSV: {error}"));
    let columns = reader.headers().map_err(invalid)?.clone();
    if let Some(unknown) = columns.iter().find(|column| !COLUMNS.contains(column)) {
        let unknown = shortened(unknown);
        return Err(Problem::malformed(&unknown, format!("unknown column {unknown:?}; known: {}", COLUMNS.join(", "))));
    }
    let is_repeated = |column: &&str| columns.iter().filter(|other| other == column).count() > 1;
    if let Some(repeated) = columns.iter().find(is_repeated) {
        return Err(Problem::malformed(repeated, format!("column {repeated} is given more than once")));
    }
    let mut recipes: Vec<Map<String, Value>> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(invalid)?;
        if record.iter().all(str::is_empty) {
            // Spreadsheets leave such lines at the end.
            continue;
        }
        let line = record.position().map_or(0, csv::Position::line);
        let given = columns.iter().zip(&record).filter(|(_, cell)| !cell.is_empty());
        let mut fields = given.map(|(column, cell)| field(column, cell, line)).collect::<Result<Map<_, _>, _>>()?;
        let Some(gripper) = fields.remove(GRIPPER) else {
            recipes.push(fields);
            if recipes.len() > MAX_RECIPES {
                let detail = format!("line {line}: a table can have at most {MAX_RECIPES} recipes");
                return Err(Problem::malformed("body", detail));
            }
            continue;
        };
        let part_id = fields.remove(PART_ID);
        let recipe = recipes.iter_mut().find(|recipe| recipe.get(PART_ID) == part_id.as_ref());
        let no_recipe = || {
            let detail = format!("line {line}: no earlier row has this part without a gripper");
            Problem::malformed(PART_ID, detail).value(part_id.clone())
        };
        let recipe = recipe.ok_or_else(no_recipe)?;
        if let Some(field) = fields.keys().find(|field| !is_of_gripper(field)) {
            let detail = format!("line {line}: {field} must be empty in the row of a gripper");
            return Err(Problem::malformed(field, detail));
        }
        let grippers = recipe.entry(GRIPPERS).or_insert_with(|| json!({}));
        if let (Value::Object(grippers), Value::String(gripper)) = (grippers, gripper)
            && grippers.insert(gripper, Value::Object(fields)).is_some()
        {
            let detail = format!("line {line}: an earlier row is of the same part and gripper");
            return Err(Problem::malformed(GRIPPER, detail));
        }
    }
    Ok(recipes)
}

/// Whether a recipe can have a value of its own for a gripper in this column.
fn is_of_gripper(column: &str) -> bool {
    !["number", "description"].contains(&column)
}

fn field(column: &str, cell: &str, line: u64) -> Result<(String, Value), Problem> {
    if TEXTS.contains(&column) {
        return Ok((column.to_owned(), original(cell).into()));
    }
    let wrong = || {
        let detail = format!("line {line}: {column} must be a number, with a decimal point and no comma");
        Problem::malformed(column, detail).value(Some(cell.into()))
    };
    let number: f64 = cell.trim().parse().map_err(|_| wrong())?;
    Ok((column.to_owned(), serde_json::Number::from_f64(number).ok_or_else(wrong)?.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TABLE: &str = "part_id,number,gripper,width_mm,force_n,description\n\
        A-1047,12,,20.0,40,\"'=ring, left\"\n\
        7,13,,30,,\n\
        ,,,,,\n\
        A-1047,,right,,30.5,\n";

    #[test]
    fn rows_of_grippers_belong_to_their_parts() {
        let expected = json!([
            {"part_id": "A-1047", "number": 12.0, "width_mm": 20.0, "force_n": 40.0, "description": "=ring, left",
             "grippers": {"right": {"force_n": 30.5}}},
            {"part_id": "7", "number": 13.0, "width_mm": 30.0},
        ]);
        assert_eq!(json!(parse(TABLE.as_bytes()).unwrap()), expected);
        assert_eq!(json!(parse(format!("\u{FEFF}{TABLE}").as_bytes()).unwrap()), expected);
    }

    #[test]
    fn table_with_a_mistake_is_refused() {
        let refused = |table: &str| serde_json::to_value(parse(table.as_bytes()).unwrap_err().members()).unwrap();
        assert_eq!(refused("part_id,with_mm\nA,20\n")["field"], "with_mm");
        assert_eq!(refused("part_id,number,gripper\nA,,right\n")["field"], "part_id");
        assert_eq!(refused(&format!("part_id,number\n{}", "A,1\n".repeat(MAX_RECIPES + 1)))["field"], "body");
        let comma = refused("part_id,number,width_mm\nA,1,\"20,5\"\n");
        assert_eq!((&comma["field"], &comma["value"]), (&json!("width_mm"), &json!("20,5")));
        assert_eq!(refused("part_id,part_id\nA,B\n")["field"], "part_id");
        assert_eq!(refused("part_id,number,gripper\nA,1,\nA,1,right\n")["field"], "number");
        assert_eq!(refused("part_id,number,gripper\nA,1,\nA,,right\nA,,right\n")["field"], "gripper");
        assert!(refused("part_id,number\nA\n")["detail"].as_str().unwrap().contains("line: 2"));
    }
}
