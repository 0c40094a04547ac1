//! Reads of all gateways at once: events, grip records and readiness. A gateway that fails does not fail the others.

use std::sync::Arc;

use axum::Json;
use axum::extract::State as Shared;
use axum::http::Uri;
use axum::response::{IntoResponse as _, Response};
use futures_util::StreamExt as _;
use futures_util::stream::iter;
use serde::Serialize;
use serde_json::value::{RawValue, to_raw_value};
use url::form_urlencoded;
use utoipa::{IntoParams, ToSchema};

use super::journal::{EventsQuery, GripsQuery, RecordsQuery};
use crate::fleet::{NoAnswer, READINESS};
use crate::interfaces::http::context::HttpContext;
use crate::interfaces::http::documents::paths::responses::{AnyProblem, JournalProblem};
use crate::model::Name;
use crate::operations::fleet::no_answer;
use crate::operations::readiness::Readiness;
use crate::operations::records::{EventPage, GripPage, RecordList};
use crate::operations::{Code, Members, Problem, QueryString};

/// Most gateways that one request asks, and most at the same time.
const MAX_ASKED: usize = 128;
const MAX_AT_ONCE: usize = 16;

/// Parameter that limits a request to one gateway.
const GATEWAY: &str = "gateway";

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameter that `split` reads")]
pub struct GatewayQuery {
    /// Only this gateway. Required with `cursor`, which is that of one gateway.
    #[param(max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "cell-7")]
    gateway: Option<String>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only describes the parameter that `RecordList` reads")]
pub struct ShortLimitQuery {
    /// Maximum number of records of each gateway; 100 by default.
    #[param(minimum = 1, maximum = 100, default = 100)]
    limit: Option<u64>,
}

/// Results of all gateways, this one first.
#[derive(ToSchema)]
#[allow(dead_code, reason = "only describes the JSON of `Results`")]
pub struct FleetResults<T> {
    gateways: Vec<GatewayResult<T>>,
}

/// Result of one gateway.
#[derive(ToSchema)]
#[allow(dead_code, reason = "only describes the JSON of `GatewayAnswer`")]
pub struct GatewayResult<T> {
    /// Name of the gateway.
    #[schema(max_length = 32)]
    gateway: String,
    /// The gateway's own result; null if that failed.
    #[schema(required)]
    result: Option<T>,
    /// Reason for a missing result; null if there is one.
    #[schema(required)]
    problem: Option<Members>,
}

#[derive(Serialize)]
struct Results {
    gateways: Vec<GatewayAnswer>,
}

#[derive(Serialize)]
struct GatewayAnswer {
    gateway: Name,
    result: Option<Box<RawValue>>,
    problem: Option<Box<RawValue>>,
}

/// List events of all gateways
///
/// Returns a page of events of each gateway on the Zenoh network, with at most 100 events each. A gateway that does not
/// answer has a problem instead.
#[utoipa::path(
    get, path = "/fleet/events", operation_id = "fleet_events", tag = "fleet",
    params(GatewayQuery, RecordsQuery, ShortLimitQuery, EventsQuery),
    responses((status = 200, description = "A page of each gateway", body = FleetResults<EventPage<'static>>), JournalProblem)
)]
pub async fn events(Shared(context): Shared<Arc<HttpContext>>, uri: Uri) -> Result<Response, Problem> {
    records(&context, RecordList::Events, &uri).await
}

/// List grip records of all gateways
///
/// Returns a page of grip records of each gateway on the Zenoh network, with at most 100 records each. A gateway that
/// does not answer has a problem instead.
#[utoipa::path(
    get, path = "/fleet/grips", operation_id = "fleet_grips", tag = "fleet",
    params(GatewayQuery, RecordsQuery, ShortLimitQuery, GripsQuery),
    responses((status = 200, description = "A page of each gateway", body = FleetResults<GripPage<'static>>), JournalProblem)
)]
pub async fn grips(Shared(context): Shared<Arc<HttpContext>>, uri: Uri) -> Result<Response, Problem> {
    records(&context, RecordList::Grips, &uri).await
}

/// Check the readiness of all gateways
///
/// Returns readiness and version of each gateway on the Zenoh network. A gateway that does not answer has a problem
/// instead.
#[utoipa::path(
    get, path = "/fleet/readiness", operation_id = "fleet_readiness", tag = "fleet",
    responses((status = 200, description = "Readiness of each gateway", body = FleetResults<Readiness>), AnyProblem)
)]
pub async fn readiness(Shared(context): Shared<Arc<HttpContext>>) -> Result<Response, Problem> {
    let own = to_raw_value(&Readiness::of(&context.gateway)).map_err(|_| Problem::internal())?;
    all(&context, READINESS, None, "", own).await
}

async fn records(context: &HttpContext, list: RecordList, uri: &Uri) -> Result<Response, Problem> {
    let (only, query) = split(uri)?;
    let uri: Uri = format!("/?{query}").parse().map_err(|_| Problem::malformed("query", "invalid query"))?;
    // A mistake in the request is found here, before it is sent to others.
    let own = list.body(&context.gateway, &list.short_page(&context.gateway, &uri).await?)?;
    if let Some(name) = &only
        && !context.gateway.peers.is_own(name)
        && !context.gateway.peers.gateways().contains_key(name)
    {
        return Err(no_answer(name, NoAnswer::Unknown));
    }
    all(context, list.name(), only.as_ref(), &query, own).await
}

/// Splits a query into the gateway and the rest.
fn split(uri: &Uri) -> Result<(Option<Name>, String), Problem> {
    let given = QueryString::of(uri);
    let gateway: Option<Name> = given.parsed(GATEWAY, "a gateway's name", |text| text.parse().ok())?;
    if gateway.is_none() && given.one("cursor")?.is_some() {
        return Err(Problem::malformed("cursor", "cursor belongs to one gateway: add the parameter gateway"));
    }
    let pairs = form_urlencoded::parse(uri.query().unwrap_or_default().as_bytes()).filter(|(name, _)| name != GATEWAY);
    Ok((gateway, form_urlencoded::Serializer::new(String::new()).extend_pairs(pairs).finish()))
}

async fn all(
    context: &HttpContext,
    what: &'static str,
    only: Option<&Name>,
    query: &str,
    own: Box<RawValue>,
) -> Result<Response, Problem> {
    let Some(_turn) = context.gateway.peers.collection().await else {
        return Err(Problem::new(Code::Overloaded, "other requests to all gateways are in progress: try again later"));
    };
    let peers = &context.gateway.peers;
    let name = &context.gateway.name;
    let own = GatewayAnswer { gateway: name.clone(), result: Some(own), problem: None };
    let mut others = peers.gateways();
    others.retain(|gateway, _| only.is_none_or(|only| only == gateway));
    let asked = iter(others.into_iter().enumerate()).map(move |(index, (gateway, is_gone))| {
        let query = query.to_owned();
        async move {
            let answer = if is_gone {
                Err(NoAnswer::Gone)
            } else if index >= MAX_ASKED {
                Err(NoAnswer::TooMany)
            } else {
                peers.read(&gateway, what, query).await
            };
            let (result, problem, room) = match answer {
                Ok((Ok(result), room)) => (Some(result), None, Some(room)),
                Ok((Err((_, problem)), room)) => (None, Some(problem), Some(room)),
                Err(why) => (None, to_raw_value(no_answer(&gateway, why).members()).ok(), None),
            };
            (GatewayAnswer { gateway, result, problem }, room)
        }
    });
    let others = asked.buffered(MAX_AT_ONCE).collect::<Vec<_>>().await;
    let (others, _rooms): (Vec<_>, Vec<_>) = others.into_iter().unzip();
    let is_wanted = only.is_none_or(|only| only == name);
    // The results are encoded while their room is still taken.
    Ok(Json(Results { gateways: is_wanted.then_some(own).into_iter().chain(others).collect() }).into_response())
}
