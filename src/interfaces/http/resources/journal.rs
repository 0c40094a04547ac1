//! The journal over HTTP: events, grip records and their curves, as JSON or CSV.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Path, State as Shared};
use axum::http::{HeaderMap, Uri, header};
use axum::response::{IntoResponse, Response};
use headers_accept::Accept;
use mediatype::{MediaType, MediaTypeList, ReadParams as _, names};
use serde::{Deserialize, Serialize};
use url::form_urlencoded;
use utoipa::{IntoParams, ToSchema};
use uuid::Uuid;

use crate::interfaces::http::context::{API, HttpContext};
use crate::interfaces::http::documents::paths::CommandPath;
use crate::interfaces::http::documents::paths::responses::JournalProblem;
use crate::journal::{EventKind, Page, csv};
use crate::model::{CommandId, Sample};
use crate::operations::Problem;
use crate::operations::records::{EventPage, GripBody, GripKinds, GripPage, RecordList, next_cursor};

pub const CSV: &str = "text/csv; charset=utf-8";
/// Header with the id of the journal that a table comes from.
const JOURNAL_ID: &str = "Journal-Id";

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameters that `RecordList` reads")]
pub struct RecordsQuery {
    /// Only records of this gripper.
    #[param(max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: Option<String>,
    /// Only records of this part. At most 48 bytes.
    #[param(max_length = 48, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$", example = "4711")]
    part_id: Option<String>,
    /// Only records of parts whose ids begin with this text. At most 48 bytes.
    #[param(max_length = 48, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$", example = "47")]
    part_prefix: Option<String>,
    /// Only records with this outcome.
    outcome: Option<crate::model::Outcome>,
    /// Only records from this time on.
    #[param(value_type = Option<String>, format = DateTime, example = "2026-11-21T09:00:00Z")]
    from: Option<String>,
    /// Only records before this time.
    #[param(value_type = Option<String>, format = DateTime, example = "2026-11-22T09:00:00Z")]
    to: Option<String>,
    /// `next_cursor` of the previous page.
    #[param(pattern = "^[0-9]{1,18}$")]
    cursor: Option<String>,
    /// `newest` (default) or `oldest` first.
    order: Option<crate::journal::Order>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameter that `RecordList` reads")]
pub struct LimitQuery {
    /// Maximum number of records per page; 100 by default.
    #[param(minimum = 1, maximum = 1000, default = 100)]
    limit: Option<u64>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameters that `RecordList` reads")]
pub struct EventsQuery {
    /// Only events of this kind.
    kind: Option<EventKind>,
    /// Only events of this command.
    command_id: Option<uuid::Uuid>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameters that `RecordList` reads")]
pub struct GripsQuery {
    /// Only records of this kind: `grip` (default), `release`, `home`, `move` or `reference`; `all` lists
    /// every kind.
    kind: Option<GripKinds>,
}

/// Returns the id of a grip record, and its curve.
async fn samples(context: &HttpContext, id: &str) -> Result<(CommandId, Vec<Sample>), Problem> {
    let id = command_id(id)?;
    Ok((id, context.gateway.journal.curve(id).await?.ok_or_else(no_such_grip)?))
}

/// The part of a grip record that belongs to its curve.
#[derive(Default, Deserialize)]
struct MeasuredRecord {
    measured_at: Option<String>,
}

/// A curve, column by column.
#[derive(Serialize, ToSchema)]
#[schema(example = json!({"id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "measured_at": "2026-11-29T10:30:00.123456Z",
    "t_ms": [0, 10], "width_mm": [60.0, 59.5], "speed_mm_s": [0.0, -50.0], "force_n": [0.0, 0.0]}))]
pub struct Curve {
    /// The command's id.
    id: CommandId,
    /// Time at which the frame of the first sample arrived, in UTC with microseconds; null in older records.
    #[schema(required, format = DateTime)]
    measured_at: Option<String>,
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

/// Whether a client prefers CSV to JSON (RFC 9110 12.5.1). Only types and their weights count, because a client may name
/// further parameters, such as a `charset`. An invalid Accept header is ignored.
fn wants_csv(headers: &HeaderMap) -> bool {
    let values = headers.get_all(header::ACCEPT).iter().filter_map(|value| value.to_str().ok());
    let values = values.collect::<Vec<_>>().join(",");
    let ranges = MediaTypeList::new(&values).filter_map(Result::ok);
    let weighted = ranges.map(|range| match range.get_param(names::Q) {
        Some(weight) => format!("{};q={weight}", range.essence()),
        None => range.essence().to_string(),
    });
    let accepted = weighted.collect::<Vec<_>>().join(",").parse::<Accept>();
    accepted.is_ok_and(|accepted| accepted.negotiate(&OFFERED) == Some(&OFFERED[1]))
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
    params(RecordsQuery, LimitQuery, EventsQuery),
    responses((status = 200, description = "A page of events", body = EventPage, headers(
        ("Link" = String, description = "Address of the next page, with `rel=\"next\"`; absent on the last page"),
    )), JournalProblem)
)]
pub async fn events(
    Shared(context): Shared<Arc<HttpContext>>,
    headers: HeaderMap,
    uri: Uri,
) -> Result<Response, Problem> {
    list(&context, RecordList::Events, &uri, wants_csv(&headers)).await
}

/// List events as a table
///
/// Returns one page of events as CSV. Text that a spreadsheet would run as a formula (it begins with `=`, `+`, `-`,
/// `@`, a tab or a line break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/events.csv", operation_id = "list_events_csv", tag = "journal",
    params(RecordsQuery, LimitQuery, EventsQuery),
    responses((status = 200, description = "A page of events", body = String, content_type = "text/csv", headers(
        ("Next-Cursor" = String, description = "Cursor of the next page; absent if the list's `next_cursor` is null"),
        ("Journal-Id" = String, description = "Id of the journal"),
        ("Link" = String, description = "Address of the next page, with `rel=\"next\"`; absent on the last page"),
    )), JournalProblem)
)]
pub async fn events_csv(Shared(context): Shared<Arc<HttpContext>>, uri: Uri) -> Result<Response, Problem> {
    list(&context, RecordList::Events, &uri, true).await
}

/// List grip records
///
/// Returns one page of grip records, with their measurements. Homings, moves and releases have such records too: see
/// `kind`. With `Accept: text/csv` the page is a table, and the header `Next-Cursor` has the cursor of the next page.
/// In a table, text that a spreadsheet would run as a formula (it begins with `=`, `+`, `-`, `@`, a tab or a line
/// break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/grips", operation_id = "list_grips", tag = "journal",
    params(RecordsQuery, LimitQuery, GripsQuery),
    responses((status = 200, description = "A page of grip records", body = GripPage, headers(
        ("Link" = String, description = "Address of the next page, with `rel=\"next\"`; absent on the last page"),
    )), JournalProblem)
)]
pub async fn grips(
    Shared(context): Shared<Arc<HttpContext>>,
    headers: HeaderMap,
    uri: Uri,
) -> Result<Response, Problem> {
    list(&context, RecordList::Grips, &uri, wants_csv(&headers)).await
}

/// List grip records as a table
///
/// Returns one page of grip records as CSV. Text that a spreadsheet would run as a formula (it begins with `=`, `+`,
/// `-`, `@`, a tab or a line break) is prefixed with a single quote.
#[utoipa::path(
    get, path = "/grips.csv", operation_id = "list_grips_csv", tag = "journal",
    params(RecordsQuery, LimitQuery, GripsQuery),
    responses((status = 200, description = "A page of grip records", body = String, content_type = "text/csv", headers(
        ("Next-Cursor" = String, description = "Cursor of the next page; absent if the list's `next_cursor` is null"),
        ("Journal-Id" = String, description = "Id of the journal"),
        ("Link" = String, description = "Address of the next page, with `rel=\"next\"`; absent on the last page"),
    )), JournalProblem)
)]
pub async fn grips_csv(Shared(context): Shared<Arc<HttpContext>>, uri: Uri) -> Result<Response, Problem> {
    list(&context, RecordList::Grips, &uri, true).await
}

async fn list(context: &HttpContext, list: RecordList, uri: &Uri, as_table: bool) -> Result<Response, Problem> {
    let page = list.page(&context.gateway, uri).await?;
    let response = if as_table {
        let columns = if list == RecordList::Events { csv::EVENT_COLUMNS } else { csv::GRIP_COLUMNS };
        table(columns, &page, context.gateway.journal.id())
    } else {
        Json(list.body(&context.gateway, &page)?).into_response()
    };
    let path = match (list, as_table) {
        (RecordList::Events, false) => "events",
        (RecordList::Events, true) => "events.csv",
        (RecordList::Grips, false) => "grips",
        (RecordList::Grips, true) => "grips.csv",
    };
    Ok(with_link(response, path, uri, &page))
}

fn command_id(text: &str) -> Result<CommandId, Problem> {
    text.parse().map_err(|_| Problem::not_found("command with this id: ids are UUIDs"))
}

fn no_such_grip() -> Problem {
    Problem::not_found(
        "grip record with this id: a record appears when its command has ended, and that of a grip one second later",
    )
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
    let record = context.gateway.journal.grip(id).await?.ok_or_else(no_such_grip)?;
    let MeasuredRecord { measured_at } = serde_json::from_str(&record).unwrap_or_default();
    let curve = Curve {
        id,
        measured_at,
        t_ms: samples.iter().map(|sample| sample.t_ms).collect(),
        width_mm: samples.iter().map(|sample| sample.width_mm).collect(),
        speed_mm_s: samples.iter().map(|sample| sample.speed_mm_s).collect(),
        force_n: samples.iter().map(|sample| sample.force_n).collect(),
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
