//! What happened: events, grip records and their curves, as JSON or CSV.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State as Shared};
use axum::http::{HeaderMap, Uri, header};
use axum::response::{IntoResponse, Response};
use headers_accept::Accept;
use mediatype::{MediaType, names};
use serde::Serialize;
use serde_json::value::RawValue;
use utoipa::{IntoParams, ToSchema};

use super::context::Context;
use super::paths::CommandPath;
use super::paths::responses::JournalProblem;
use super::query::Query as Parameters;
use crate::gripper::model::{CommandId, Event, GripRecord, Sample};
use crate::journal::csv;
use crate::journal::{Cursor, EventKind, Filter, Limit, Page, Query};
use crate::operations::values::{integer, text};
use crate::operations::{Code, Problem};

/// The kinds of events, as a mistake names them.
const EVENT_KINDS: &str = "command, fast_stop, acknowledge, lease, link, device, settings, refused, gateway";
const GRIP_KINDS: &str = "home, move, grip, release";
const OUTCOMES: &str = "SUCCESS, PART_HELD, NO_PART, BLOCKED, ABORTED, RANGE, TIMEOUT, FAILED, REFUSED, UNKNOWN";
/// A sequence number of a journal that outlives the gateway's hardware.
const MAX_CURSOR_DIGITS: usize = 18;
const CSV: &str = "text/csv; charset=utf-8";

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "the document's words on what query takes from the address")]
pub struct RecordsQuery {
    /// Only of this gripper.
    #[param(max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: Option<String>,
    /// Only of this part, whose name has at most 48 bytes.
    #[param(max_length = 48, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$", example = "4711")]
    part_id: Option<String>,
    /// Only commands that ended like this.
    outcome: Option<crate::gripper::model::Outcome>,
    /// Not before this time.
    #[param(value_type = Option<String>, format = DateTime, example = "2026-11-21T09:00:00Z")]
    from: Option<String>,
    /// Before this time.
    #[param(value_type = Option<String>, format = DateTime, example = "2026-11-22T09:00:00Z")]
    to: Option<String>,
    /// How many at most. 100 by default.
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: Option<u64>,
    /// `next_cursor` of the page before.
    #[param(pattern = "^[0-9]{1,18}$")]
    cursor: Option<String>,
    /// `newest` (default) or `oldest` first.
    order: Option<crate::journal::Order>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "the document's words on what query takes from the address")]
pub struct EventsQuery {
    /// Only of this kind.
    kind: Option<EventKind>,
    /// Only of this command.
    command_id: Option<uuid::Uuid>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "the document's words on what query takes from the address")]
pub struct GripsQuery {
    /// Only of this kind: `home`, `move`, `grip` or `release`.
    kind: Option<crate::gripper::model::Kind>,
}

/// An event: its kind's fields stand beside the common ones.
#[derive(Serialize, ToSchema)]
#[schema(as = StoredEvent)]
#[allow(dead_code, reason = "the document's words on what the journal has as JSON already")]
pub struct EventBody {
    /// Its place in the order of all events.
    #[schema(minimum = 1)]
    seq: i64,
    #[serde(flatten)]
    event: Event,
}

/// A motion's measurements, without the curve.
#[derive(Serialize, ToSchema)]
#[schema(as = StoredGripRecord)]
#[allow(dead_code, reason = "the document's words on what the journal has as JSON already")]
pub struct GripBody {
    /// Its place in the order of all grip records.
    #[schema(minimum = 1)]
    seq: i64,
    #[serde(flatten)]
    record: GripRecord,
    /// When the part was lost that this grip held; null where it was not.
    #[schema(value_type = Option<String>, required, format = DateTime)]
    part_lost_at: Option<String>,
}

/// A page of events.
#[derive(Serialize, ToSchema)]
pub struct Events<'a> {
    #[schema(value_type = Vec<EventBody>)]
    events: Vec<&'a RawValue>,
    /// For the page behind this one; null where this is the last.
    #[schema(required)]
    next_cursor: Option<&'a str>,
}

/// A page of grip records.
#[derive(Serialize, ToSchema)]
pub struct Grips<'a> {
    #[schema(value_type = Vec<GripBody>)]
    grips: Vec<&'a RawValue>,
    /// For the page behind this one; null where this is the last.
    #[schema(required)]
    next_cursor: Option<&'a str>,
}

/// A curve, column by column.
#[derive(Serialize, ToSchema)]
#[schema(example = json!({"id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "t_ms": [0, 10], "width_mm": [60.0, 59.5],
    "speed_mm_s": [0.0, -50.0], "force_n": [0.0, 0.0]}))]
pub struct Curve {
    /// The command's id.
    #[schema(value_type = uuid::Uuid)]
    id: CommandId,
    /// Since the first sample, in ms.
    t_ms: Vec<u32>,
    /// The opening width in mm.
    width_mm: Vec<f32>,
    /// The speed of the fingers relative to each other, in mm/s.
    speed_mm_s: Vec<f32>,
    /// The gripping force in N.
    force_n: Vec<f32>,
}

/// In which forms pages are told; JSON where a client has no preference.
const OFFERED: [MediaType<'static>; 2] =
    [MediaType::new(names::APPLICATION, names::JSON), MediaType::new(names::TEXT, names::CSV)];

/// What a request's address asks for.
fn query<K: serde::de::DeserializeOwned>(uri: &Uri, kinds: &str, more: &[&str]) -> Result<Query<K>, Problem> {
    let known = ["gripper", "kind", "part_id", "outcome", "from", "to", "limit", "cursor", "order"];
    let given = Parameters::of(uri)?.only(&[&known, more].concat())?;
    let limit = match given.parsed("limit", "a whole number", |text| text.parse::<f64>().ok())? {
        // In range, which is all that a limit asks for.
        Some(number) => Limit::new(integer("limit", number, 1..=1000)?).unwrap_or_default(),
        None => Limit::default(),
    };
    let part_id = given.one("part_id")?.map(|part| text("part_id", part)).transpose()?;
    Ok(Query {
        filter: Filter {
            gripper: given.parsed("gripper", "a gripper's name", |text| text.parse().ok())?,
            kind: given.word("kind", kinds)?,
            part_id,
            outcome: given.word("outcome", OUTCOMES)?,
            command_id: given.parsed("command_id", "a command's id, a UUID", |text| text.parse().ok())?,
        },
        from: given.time("from")?,
        to: given.time("to")?,
        limit,
        cursor: given.parsed("cursor", "next_cursor of the page before", cursor)?,
        order: given.word("order", "newest, oldest")?.unwrap_or_default(),
    })
}

fn cursor(text: &str) -> Option<Cursor> {
    let is_ours = text.len() <= MAX_CURSOR_DIGITS && text.bytes().all(|byte| byte.is_ascii_digit());
    is_ours.then(|| text.parse().ok()).flatten()
}

/// Whether a client prefers CSV to JSON (RFC 9110 12.5.1). An Accept that can't be read is none.
fn wants_csv(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let accepted = values.collect::<Vec<_>>().join(",").parse::<Accept>();
    accepted.is_ok_and(|accepted| accepted.negotiate(&OFFERED) == Some(&OFFERED[1]))
}

fn raw(page: &Page) -> Result<Vec<&RawValue>, Problem> {
    let damaged = |error| Problem::new(Code::JournalDown, format!("a record of the journal is damaged: {error}"));
    page.bodies.iter().map(|body| serde_json::from_str(body).map_err(damaged)).collect()
}

/// A page as a table, with where the next one begins.
fn table(columns: &[&str], page: &Page) -> Response {
    let rows = csv::header(columns) + &csv::lines(columns, page.bodies.iter().map(|body| &**body));
    let mut response = ([(header::CONTENT_TYPE, CSV)], rows).into_response();
    if let Some(cursor) = page.next_cursor.as_deref().and_then(|cursor| cursor.parse().ok()) {
        response.headers_mut().insert("Next-Cursor", cursor);
    }
    response
}

/// Events
///
/// What happened, page by page. With `Accept: text/csv` as a table, whose next page the header `Next-Cursor` names. A text
/// in it that a spreadsheet would run as a formula (it begins with `=`, `+`, `-`, `@`, a tab or a line break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/events", operation_id = "list_events", tag = "journal",
    params(RecordsQuery, EventsQuery),
    responses((status = 200, description = "A page of events", content((Events = "application/json"), (String = "text/csv"))), JournalProblem)
)]
pub async fn events(Shared(context): Shared<Arc<Context>>, headers: HeaderMap, uri: Uri) -> Result<Response, Problem> {
    let page = context.gateway.journal.events(query(&uri, EVENT_KINDS, &["command_id"])?).await?;
    if wants_csv(&headers) {
        return Ok(table(csv::EVENT_COLUMNS, &page));
    }
    let next_cursor = page.next_cursor.as_deref();
    Ok(Json(Events { events: raw(&page)?, next_cursor }).into_response())
}

/// Grip records
///
/// Every homing, move, grip and release, with what was measured. With `Accept: text/csv` as a table, whose next page
/// the header `Next-Cursor` names. A text in it that a spreadsheet would run as a formula (it begins with `=`, `+`, `-`, `@`,
/// a tab or a line break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/grips", operation_id = "list_grips", tag = "journal",
    params(RecordsQuery, GripsQuery),
    responses((status = 200, description = "A page of grip records", content((Grips = "application/json"), (String = "text/csv"))), JournalProblem)
)]
pub async fn grips(Shared(context): Shared<Arc<Context>>, headers: HeaderMap, uri: Uri) -> Result<Response, Problem> {
    let page = context.gateway.journal.grips(query(&uri, GRIP_KINDS, &[])?).await?;
    if wants_csv(&headers) {
        return Ok(table(csv::GRIP_COLUMNS, &page));
    }
    let next_cursor = page.next_cursor.as_deref();
    Ok(Json(Grips { grips: raw(&page)?, next_cursor }).into_response())
}

fn command_id(text: &str) -> Result<CommandId, Problem> {
    text.parse().map_err(|_| Problem::not_found("command of this id: ids are UUIDs"))
}

fn no_such_grip() -> Problem {
    Problem::not_found("grip record of this id: a command's record comes when it has ended, a grip's a second later")
}

/// A grip record
#[utoipa::path(
    get, path = "/grips/{command}", operation_id = "get_grip", tag = "journal",
    params(CommandPath),
    responses((status = 200, description = "The grip record", body = GripBody), JournalProblem)
)]
pub async fn grip(Shared(context): Shared<Arc<Context>>, Path(id): Path<String>) -> Result<Response, Problem> {
    let body = context.gateway.journal.grip(command_id(&id)?).await?.ok_or_else(no_such_grip)?;
    Ok(([(header::CONTENT_TYPE, "application/json")], body.to_string()).into_response())
}

/// A grip's curve
///
/// Width, speed and force from the motion's start to its end, and a second after a grip. With `Accept: text/csv` as a
/// table.
#[utoipa::path(
    get, path = "/grips/{command}/curve", operation_id = "get_curve", tag = "journal",
    params(CommandPath),
    responses((status = 200, description = "The curve", content((Curve = "application/json"), (String = "text/csv"))), JournalProblem)
)]
pub async fn curve(
    Shared(context): Shared<Arc<Context>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let id = command_id(&id)?;
    let samples = context.gateway.journal.curve(id).await?.ok_or_else(no_such_grip)?;
    if wants_csv(&headers) {
        return Ok(([(header::CONTENT_TYPE, CSV)], csv::curve(&samples)).into_response());
    }
    let column = |value: fn(&Sample) -> f32| samples.iter().map(value).collect();
    let curve = Curve {
        id,
        t_ms: samples.iter().map(|sample| sample.t_ms).collect(),
        width_mm: column(|sample| sample.width_mm),
        speed_mm_s: column(|sample| sample.speed_mm_s),
        force_n: column(|sample| sample.force_n),
    };
    Ok(Json(curve).into_response())
}
