//! Recipes as CSV, for spreadsheets. A row with a gripper has the values that differ for that gripper.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::extract::{Request, State as Shared};
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value, json};

use super::journal::CSV;
use crate::interfaces::http::context::HttpContext;
use crate::interfaces::http::documents::paths::responses::{JournalProblem, RecipeProblem};
use crate::interfaces::http::requests::body;
use crate::interfaces::http::requests::operation::{RequestBody, serve_below};
use crate::journal::csv::{original, table};
use crate::model::{Recipe, without_byte_order_mark};
use crate::operations::parameters::values::shortened;
use crate::operations::recipes::{MAX_RECIPES, RecipeList, SET_SEVERAL};
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
/// as they are. Only `part_id` and `number` are required. Cells are separated by commas, or by semicolons: a number can
/// then have a decimal comma.
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
    let mut rows = vec![fields];
    rows.extend(grippers.into_iter().map(|(gripper, values)| gripper_row(&part_id, gripper, values)));
    rows
}

fn gripper_row(part_id: &Value, gripper: String, values: Value) -> Map<String, Value> {
    let Value::Object(mut values) = values else { return Map::new() };
    values.extend([(PART_ID.to_owned(), part_id.clone()), (GRIPPER.to_owned(), gripper.into())]);
    values
}

/// Parses a table to the recipes of a request, in the order of their first rows.
fn parse(table: &[u8]) -> Result<Vec<Map<String, Value>>, Problem> {
    let table = TableText::of(table)?;
    let mut lines = Lines { text: &table.text, counted: 0, line: 1 };
    let mut reader = csv::ReaderBuilder::new().delimiter(table.separator).from_reader(table.text.as_bytes());
    let columns = reader.headers().map_err(|error| invalid(&error, &mut lines))?.clone();
    if let Some(unknown) = columns.iter().find(|column| !COLUMNS.contains(column)) {
        let unknown = shortened(unknown);
        let detail =
            format!("unknown column {unknown:?}; known, separated by commas or semicolons: {}", COLUMNS.join(", "));
        return Err(Problem::malformed(&unknown, detail));
    }
    let repeated = columns.iter().find(|column| columns.iter().filter(|other| other == column).count() > 1);
    if let Some(repeated) = repeated {
        return Err(Problem::malformed(repeated, format!("column {repeated} is given more than once")));
    }
    let mut recipes: Vec<Map<String, Value>> = Vec::new();
    for record in reader.records() {
        let record = record.map_err(|error| invalid(&error, &mut lines))?;
        if record.iter().all(str::is_empty) {
            // Spreadsheets leave such lines at the end.
            continue;
        }
        let line = lines.at(record.position());
        let given = columns.iter().zip(&record).filter(|(_, cell)| !cell.is_empty());
        let parsed = given.map(|(column, cell)| table.field(column, cell, line));
        let mut fields = parsed.collect::<Result<Map<_, _>, _>>()?;
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
        let Some(recipe) = recipe else {
            let detail = format!("line {line}: no earlier row has this part without a gripper");
            return Err(Problem::malformed(PART_ID, detail).value(part_id));
        };
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

/// Describes what is wrong with a table.
fn invalid(error: &csv::Error, lines: &mut Lines) -> Problem {
    let detail = match error.kind() {
        csv::ErrorKind::UnequalLengths { pos, expected_len, len } => {
            format!("line {}: {len} cells instead of {expected_len}", lines.at(pos.as_ref()))
        }
        _ => format!("invalid CSV: {error}"),
    };
    Problem::malformed("body", detail)
}

/// Ends all lines of a text with LF: spreadsheets end them with CR LF, some with CR.
fn with_line_feeds(text: &str) -> String {
    text.replace("\r\n", "\n").replace('\r', "\n")
}

/// A table as a spreadsheet saves it.
struct TableText {
    /// The text, whose lines end with LF.
    text: String,
    /// A comma, or a semicolon where the comma is the decimal sign.
    separator: u8,
}

impl TableText {
    fn of(table: &[u8]) -> Result<Self, Problem> {
        let table = without_byte_order_mark(table);
        let text = match std::str::from_utf8(table) {
            Ok(text) => with_line_feeds(text),
            Err(error) => {
                let before = std::str::from_utf8(&table[..error.valid_up_to()]).unwrap_or_default();
                let line = with_line_feeds(before).matches('\n').count() + 1;
                let detail = format!("line {line} is not valid UTF-8: save the table as \"CSV UTF-8\"");
                return Err(Problem::malformed("body", detail));
            }
        };
        let columns = text.lines().find(|line| !line.is_empty()).unwrap_or_default();
        let separator = if columns.contains(';') && !columns.contains(',') { b';' } else { b',' };
        Ok(Self { text, separator })
    }

    fn field(&self, column: &str, cell: &str, line: u64) -> Result<(String, Value), Problem> {
        if TEXTS.contains(&column) {
            return Ok((column.to_owned(), original(cell).into()));
        }
        let has_decimal_commas = self.separator == b';';
        let number = if has_decimal_commas { cell.replace(',', ".") } else { cell.to_owned() };
        let number = number.trim().parse().ok().and_then(serde_json::Number::from_f64);
        let Some(number) = number else {
            let form = if has_decimal_commas { "" } else { ", with a decimal point and no comma" };
            let detail = format!("line {line}: {column} must be a number{form}");
            return Err(Problem::malformed(column, detail).value(Some(cell.into())));
        };
        Ok((column.to_owned(), number.into()))
    }
}

/// Counts the lines of a text. The reader's own count takes a blank line for that of the record behind it.
struct Lines<'a> {
    text: &'a str,
    counted: usize,
    /// Number of the line at `counted`.
    line: u64,
}

impl Lines<'_> {
    /// Returns the line of a record, which is not before the last one asked for.
    fn at(&mut self, position: Option<&csv::Position>) -> u64 {
        let start = position.and_then(|position| usize::try_from(position.byte()).ok()).unwrap_or_default();
        while let Some(byte) = self.text.as_bytes().get(self.counted)
            && (self.counted < start || *byte == b'\n')
        {
            self.line += u64::from(*byte == b'\n');
            self.counted += 1;
        }
        self.line
    }
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
        assert_eq!(refused("part_id,number\nA\n")["detail"], "line 2: 1 cells instead of 2");
        let tabs = refused("part_id\tnumber\nA\t1\n");
        assert!(tabs["detail"].as_str().unwrap().contains("separated by commas or semicolons"), "{tabs}");
    }

    /// Returns the line that the problem of a table names.
    fn line(table: &[u8]) -> String {
        let detail = parse(table).unwrap_err().detail().to_owned();
        detail.split([' ', ':']).nth(1).unwrap().to_owned()
    }

    #[test]
    fn line_of_a_mistake_is_that_of_an_editor() {
        for end in ["\n", "\r\n", "\r"] {
            let lines = ["part_id,number", "", "A,1", "B,2", ","].join(end);
            assert_eq!(line(format!("{lines}{end}C,x").as_bytes()), "6", "{end:?}");
            assert_eq!(line(format!("{lines}{end}C").as_bytes()), "6", "{end:?}");
            assert_eq!(line(&[lines.as_bytes(), end.as_bytes(), b"M\xFCller,5"].concat()), "6", "{end:?}");
        }
    }

    #[test]
    fn table_with_semicolons_has_decimal_commas() {
        let table = "part_id;number;gripper;width_mm;force_n;description\r\n\
                     A-1047;12;;20,0;40;'=ring, left\r\n7;13;;30;;\r\nA-1047;;right;;30,5;\r\n";
        assert_eq!(parse(table.as_bytes()).unwrap(), parse(TABLE.as_bytes()).unwrap());
        let refused = parse(b"part_id;number\nA;1.2,5\n").unwrap_err();
        assert_eq!(refused.detail(), "line 2: number must be a number");
    }
}
