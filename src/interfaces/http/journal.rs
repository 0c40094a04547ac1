//! The journal over HTTP: events, grip records and their curves, as JSON or CSV.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State as Shared};
use axum::http::{HeaderMap, Uri, header};
use axum::response::{IntoResponse, Response};
use headers_accept::Accept;
use mediatype::{MediaType, names};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use url::form_urlencoded;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use super::context::{API, HttpContext};
use super::paths::CommandPath;
use super::paths::responses::JournalProblem;
use super::query::QueryString;
use crate::gripper::model::{CommandId, Event, GripRecord, Kind, Sample};
use crate::journal::csv;
use crate::journal::{Cursor, EventKind, Filter, Limit, Page, Query};
use crate::operations::values::{integer, text};
use crate::operations::{Code, Problem};

/// Kinds of events, as listed in problems.
const EVENT_KINDS: &str = "command, fast_stop, acknowledge, lease, link, device, settings, refused, gateway";
const GRIP_KINDS: &str = "all, home, move, grip, release";
const OUTCOMES: &str = "SUCCESS, PART_HELD, NO_PART, BLOCKED, ABORTED, RANGE, TIMEOUT, FAILED, REFUSED, UNKNOWN";
/// Digits of the largest accepted cursor, beyond the events that any journal will have.
const MAX_CURSOR_DIGITS: usize = 18;
const CSV: &str = "text/csv; charset=utf-8";
/// Header with the id of the journal that a table comes from.
const JOURNAL_ID: &str = "Journal-Id";

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameters that `query` reads")]
pub struct RecordsQuery {
    /// Only records of this gripper.
    #[param(max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: Option<String>,
    /// Only records of this part. At most 48 bytes.
    #[param(max_length = 48, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$", example = "4711")]
    part_id: Option<String>,
    /// Only records with this outcome.
    outcome: Option<crate::gripper::model::Outcome>,
    /// Only records from this time on.
    #[param(value_type = Option<String>, format = DateTime, example = "2026-11-21T09:00:00Z")]
    from: Option<String>,
    /// Only records before this time.
    #[param(value_type = Option<String>, format = DateTime, example = "2026-11-22T09:00:00Z")]
    to: Option<String>,
    /// Maximum number of records per page; 100 by default.
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: Option<u64>,
    /// `next_cursor` of the previous page.
    #[param(pattern = "^[0-9]{1,18}$")]
    cursor: Option<String>,
    /// `newest` (default) or `oldest` first.
    order: Option<crate::journal::Order>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameters that `query` reads")]
pub struct EventsQuery {
    /// Only events of this kind.
    kind: Option<EventKind>,
    /// Only events of this command.
    command_id: Option<uuid::Uuid>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameters that `query` reads")]
pub struct GripsQuery {
    /// Only records of this kind: `grip` (default), `release`, `home` or `move`; `all` lists every kind.
    kind: Option<GripKinds>,
}

/// Kinds of grip records:
///
/// - `all`: every kind
/// - `home`: homings
/// - `move`: moves
/// - `grip`: grips
/// - `release`: releases
#[derive(Debug, Clone, Copy, Default, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum GripKinds {
    All,
    Home,
    Move,
    #[default]
    Grip,
    Release,
}

impl From<GripKinds> for Option<Kind> {
    fn from(kinds: GripKinds) -> Self {
        match kinds {
            GripKinds::All => None,
            GripKinds::Home => Some(Kind::Home),
            GripKinds::Move => Some(Kind::Move),
            GripKinds::Grip => Some(Kind::Grip),
            GripKinds::Release => Some(Kind::Release),
        }
    }
}

/// An event, with the common fields and those of its kind.
#[derive(Serialize, ToSchema)]
#[schema(as = StoredEvent)]
#[allow(dead_code, reason = "only describes the JSON that the journal stores")]
pub struct EventBody {
    /// Sequence number of the event.
    #[schema(minimum = 1)]
    seq: i64,
    #[serde(flatten)]
    event: Event,
}

/// A motion's measurements, without the curve.
#[derive(Serialize, ToSchema)]
#[schema(as = StoredGripRecord)]
#[allow(dead_code, reason = "only describes the JSON that the journal stores")]
pub struct GripBody {
    /// Sequence number of the grip record.
    #[schema(minimum = 1)]
    seq: i64,
    #[serde(flatten)]
    record: GripRecord,
    /// Time at which the gripped part was lost; null if it was not lost.
    #[schema(value_type = Option<String>, required, format = DateTime)]
    part_lost_at: Option<String>,
}

/// A page of events.
#[derive(Serialize, ToSchema)]
#[schema(as = EventPage)]
pub struct Events<'a> {
    #[schema(value_type = Vec<EventBody>)]
    events: Vec<&'a RawValue>,
    /// Cursor of the next page. On the last page: null, or with `order=oldest` the cursor of later records.
    #[schema(required)]
    next_cursor: Option<&'a str>,
    /// Whether another page follows.
    has_more: bool,
    /// Id of the journal. Cursors and sequence numbers of another journal mean other records.
    journal_id: Uuid,
}

/// A page of grip records.
#[derive(Serialize, ToSchema)]
#[schema(as = GripPage)]
pub struct Grips<'a> {
    #[schema(value_type = Vec<GripBody>)]
    grips: Vec<&'a RawValue>,
    /// Cursor of the next page. On the last page: null, or with `order=oldest` the cursor of later records.
    #[schema(required)]
    next_cursor: Option<&'a str>,
    /// Whether another page follows.
    has_more: bool,
    /// Id of the journal. Cursors and sequence numbers of another journal mean other records.
    journal_id: Uuid,
}

/// Returns the id of a grip record, and its curve.
async fn samples(context: &HttpContext, id: &str) -> Result<(CommandId, Vec<Sample>), Problem> {
    let id = command_id(id)?;
    Ok((id, context.gateway.journal.curve(id).await?.ok_or_else(no_such_grip)?))
}

/// A curve, column by column.
#[derive(Serialize, ToSchema)]
#[schema(example = json!({"id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "t_ms": [0, 10], "width_mm": [60.0, 59.5],
    "speed_mm_s": [0.0, -50.0], "force_n": [0.0, 0.0]}))]
pub struct Curve {
    /// The command's id.
    #[schema(value_type = uuid::Uuid)]
    id: CommandId,
    /// Time since the first sample, in ms.
    t_ms: Vec<u32>,
    /// The opening width in mm.
    width_mm: Vec<f32>,
    /// The speed of the fingers relative to each other, in mm/s.
    speed_mm_s: Vec<f32>,
    /// The gripping force in N.
    force_n: Vec<f32>,
}

/// Media types of pages; JSON if a client has no preference.
const OFFERED: [MediaType<'static>; 2] =
    [MediaType::new(names::APPLICATION, names::JSON), MediaType::new(names::TEXT, names::CSV)];

/// Parses a request's query. The function `kind` maps the query's `kind` to the kind of the records.
fn query<W: DeserializeOwned, K>(
    uri: &Uri,
    kinds: &str,
    more: &[&str],
    kind: fn(Option<W>) -> Option<K>,
) -> Result<Query<K>, Problem> {
    let known = ["gripper", "kind", "part_id", "outcome", "from", "to", "limit", "cursor", "order"];
    let given = QueryString::of(uri)?.only(&[&known, more].concat())?;
    let limit = match given.parsed("limit", "a whole number", |text| text.parse::<f64>().ok())? {
        // `integer` has checked the range, so `Limit::new` succeeds.
        Some(number) => Limit::new(integer("limit", number, 1..=1000)?).unwrap_or_default(),
        None => Limit::default(),
    };
    let part_id = given.one("part_id")?.map(|part| text("part_id", part)).transpose()?;
    Ok(Query {
        filter: Filter {
            gripper: given.parsed("gripper", "a gripper's name", |text| text.parse().ok())?,
            kind: kind(given.word("kind", kinds)?),
            part_id,
            outcome: given.word("outcome", OUTCOMES)?,
            command_id: given.parsed("command_id", "a command's id, a UUID", |text| text.parse().ok())?,
        },
        from: given.time("from")?,
        to: given.time("to")?,
        limit,
        cursor: given.parsed("cursor", "next_cursor of the previous page", cursor)?,
        order: given.word("order", "newest, oldest")?.unwrap_or_default(),
    })
}

fn cursor(text: &str) -> Option<Cursor> {
    let is_ours = text.len() <= MAX_CURSOR_DIGITS && text.bytes().all(|byte| byte.is_ascii_digit());
    is_ours.then(|| text.parse().ok()).flatten()
}

/// Whether a client prefers CSV to JSON (RFC 9110 12.5.1). An invalid Accept header is ignored.
fn wants_csv(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let accepted = values.collect::<Vec<_>>().join(",").parse::<Accept>();
    accepted.is_ok_and(|accepted| accepted.negotiate(&OFFERED) == Some(&OFFERED[1]))
}

fn raw(page: &Page) -> Result<Vec<&RawValue>, Problem> {
    let damaged = |error| Problem::new(Code::JournalDown, format!("a record of the journal is damaged: {error}"));
    page.bodies.iter().map(|body| serde_json::from_str(body).map_err(damaged)).collect()
}

/// Returns a page as CSV, with the next cursor and the journal's id as headers.
fn table(columns: &[&str], page: &Page, journal_id: Uuid) -> Response {
    let rows = csv::header(columns) + &csv::lines(columns, page.bodies.iter().map(|body| &**body));
    let mut response = ([(header::CONTENT_TYPE, CSV)], rows).into_response();
    let headers = [("Next-Cursor", next_cursor(page).map(str::to_owned)), (JOURNAL_ID, Some(journal_id.to_string()))];
    for (name, value) in headers {
        if let Some(value) = value.and_then(|value| value.parse().ok()) {
            response.headers_mut().insert(name, value);
        }
    }
    response
}

fn next_cursor(page: &Page) -> Option<&str> {
    page.next_cursor.as_deref().or(page.resume_cursor.as_deref())
}

/// Adds the address of the next page (RFC 8288), if another page follows.
fn with_link(mut response: Response, list: &str, uri: &Uri, page: &Page) -> Response {
    let Some(cursor) = &page.next_cursor else { return response };
    let given = form_urlencoded::parse(uri.query().unwrap_or_default().as_bytes());
    let mut query = form_urlencoded::Serializer::new(String::new());
    query.extend_pairs(given.filter(|(name, _)| name != "cursor")).append_pair("cursor", cursor);
    let link = format!("<{API}/{list}?{}>; rel=\"next\"", query.finish());
    response.headers_mut().extend(link.parse().ok().map(|link| (header::LINK, link)));
    response
}

/// List events
///
/// Returns one page of events. With `Accept: text/csv` the page is a table, and the header `Next-Cursor` has the cursor
/// of the next page. In a table, text that a spreadsheet would run as a formula (it begins with `=`, `+`, `-`, `@`, a
/// tab or a line break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/events", operation_id = "list_events", tag = "journal",
    params(RecordsQuery, EventsQuery),
    responses((status = 200, description = "A page of events", body = Events, headers(
        ("Link" = String, description = "Address of the next page, with `rel=\"next\"`; absent on the last page"),
    )), JournalProblem)
)]
pub async fn events(
    Shared(context): Shared<Arc<HttpContext>>,
    headers: HeaderMap,
    uri: Uri,
) -> Result<Response, Problem> {
    list_events(&context, &uri, wants_csv(&headers)).await
}

/// List events as a table
///
/// Returns one page of events as CSV. Text that a spreadsheet would run as a formula (it begins with `=`, `+`, `-`,
/// `@`, a tab or a line break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/events.csv", operation_id = "list_events_csv", tag = "journal",
    params(RecordsQuery, EventsQuery),
    responses((status = 200, description = "A page of events", body = String, content_type = "text/csv", headers(
        ("Next-Cursor" = String, description = "Cursor of the next page; absent if the list's `next_cursor` is null"),
        ("Journal-Id" = String, description = "Id of the journal"),
        ("Link" = String, description = "Address of the next page, with `rel=\"next\"`; absent on the last page"),
    )), JournalProblem)
)]
pub async fn events_csv(Shared(context): Shared<Arc<HttpContext>>, uri: Uri) -> Result<Response, Problem> {
    list_events(&context, &uri, true).await
}

async fn list_events(context: &HttpContext, uri: &Uri, as_table: bool) -> Result<Response, Problem> {
    let journal = &context.gateway.journal;
    let query = query(uri, EVENT_KINDS, &["command_id"], |kind: Option<EventKind>| kind)?;
    let (page, journal_id) = (journal.events(query).await?, journal.id());
    let response = if as_table {
        table(csv::EVENT_COLUMNS, &page, journal_id)
    } else {
        let (next_cursor, has_more) = (next_cursor(&page), page.next_cursor.is_some());
        Json(Events { events: raw(&page)?, next_cursor, has_more, journal_id }).into_response()
    };
    Ok(with_link(response, if as_table { "events.csv" } else { "events" }, uri, &page))
}

/// List grip records
///
/// Returns one page of grip records, with their measurements. Homings, moves and releases have such records too: see
/// `kind`. With `Accept: text/csv` the page is a table, and the header `Next-Cursor` has the cursor of the next page.
/// In a table, text that a spreadsheet would run as a formula (it begins with `=`, `+`, `-`, `@`, a tab or a line
/// break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/grips", operation_id = "list_grips", tag = "journal",
    params(RecordsQuery, GripsQuery),
    responses((status = 200, description = "A page of grip records", body = Grips, headers(
        ("Link" = String, description = "Address of the next page, with `rel=\"next\"`; absent on the last page"),
    )), JournalProblem)
)]
pub async fn grips(
    Shared(context): Shared<Arc<HttpContext>>,
    headers: HeaderMap,
    uri: Uri,
) -> Result<Response, Problem> {
    list_grips(&context, &uri, wants_csv(&headers)).await
}

/// List grip records as a table
///
/// Returns one page of grip records as CSV. Text that a spreadsheet would run as a formula (it begins with `=`, `+`,
/// `-`, `@`, a tab or a line break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/grips.csv", operation_id = "list_grips_csv", tag = "journal",
    params(RecordsQuery, GripsQuery),
    responses((status = 200, description = "A page of grip records", body = String, content_type = "text/csv", headers(
        ("Next-Cursor" = String, description = "Cursor of the next page; absent if the list's `next_cursor` is null"),
        ("Journal-Id" = String, description = "Id of the journal"),
        ("Link" = String, description = "Address of the next page, with `rel=\"next\"`; absent on the last page"),
    )), JournalProblem)
)]
pub async fn grips_csv(Shared(context): Shared<Arc<HttpContext>>, uri: Uri) -> Result<Response, Problem> {
    list_grips(&context, &uri, true).await
}

async fn list_grips(context: &HttpContext, uri: &Uri, as_table: bool) -> Result<Response, Problem> {
    let journal = &context.gateway.journal;
    let query = query(uri, GRIP_KINDS, &[], |kinds: Option<GripKinds>| kinds.unwrap_or_default().into())?;
    let (page, journal_id) = (journal.grips(query).await?, journal.id());
    let response = if as_table {
        table(csv::GRIP_COLUMNS, &page, journal_id)
    } else {
        let (next_cursor, has_more) = (next_cursor(&page), page.next_cursor.is_some());
        Json(Grips { grips: raw(&page)?, next_cursor, has_more, journal_id }).into_response()
    };
    Ok(with_link(response, if as_table { "grips.csv" } else { "grips" }, uri, &page))
}

fn command_id(text: &str) -> Result<CommandId, Problem> {
    text.parse().map_err(|_| Problem::not_found("command with this id: ids are UUIDs"))
}

fn no_such_grip() -> Problem {
    Problem::not_found("grip record with this id: a record appears when its command has ended, a grip's a second later")
}

/// Get a grip record
#[utoipa::path(
    get, path = "/grips/{command}", operation_id = "get_grip", tag = "journal",
    params(CommandPath),
    responses((status = 200, description = "The grip record", body = GripBody), JournalProblem)
)]
pub async fn grip(Shared(context): Shared<Arc<HttpContext>>, Path(id): Path<String>) -> Result<Response, Problem> {
    let body = context.gateway.journal.grip(command_id(&id)?).await?.ok_or_else(no_such_grip)?;
    Ok(([(header::CONTENT_TYPE, "application/json")], body.to_string()).into_response())
}

/// Get a grip's curve
///
/// Returns width, speed and force from the motion's start to its end, and for one more second after a grip. With
/// `Accept: text/csv` the curve is a table.
#[utoipa::path(
    get, path = "/grips/{command}/curve", operation_id = "get_curve", tag = "journal",
    params(CommandPath),
    responses((status = 200, description = "The curve", body = Curve), JournalProblem)
)]
pub async fn curve(
    Shared(context): Shared<Arc<HttpContext>>,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    if wants_csv(&headers) {
        return curve_csv(Shared(context), Path(id)).await;
    }
    let (id, samples) = samples(&context, &id).await?;
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

/// Get a grip's curve as a table
///
/// Returns the curve as CSV, with a line for each sample.
#[utoipa::path(
    get, path = "/grips/{command}/curve.csv", operation_id = "get_curve_csv", tag = "journal",
    params(CommandPath),
    responses((status = 200, description = "The curve", body = String, content_type = "text/csv"), JournalProblem)
)]
pub async fn curve_csv(Shared(context): Shared<Arc<HttpContext>>, Path(id): Path<String>) -> Result<Response, Problem> {
    let (_, samples) = samples(&context, &id).await?;
    Ok(([(header::CONTENT_TYPE, CSV)], csv::curve(&samples)).into_response())
}
