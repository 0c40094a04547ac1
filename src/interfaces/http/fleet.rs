//! The fleet: the grippers of all gateways on the Zenoh network. What is asked about another gateway's gripper goes to
//! the gateway that owns it, which decides; its answers and problems come back as they are.

use std::sync::Arc;
use std::time::Duration;

use axum::body::Body as Stream;
use axum::extract::{RawPathParams, Request, State as Shared};
use axum::http::{HeaderName, Method as Verb, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Serialize;
use serde_json::value::RawValue;
use serde_json::{Map, Value};
use utoipa::ToSchema;

use super::errors::{Code, Problem};
use super::extract::{Asker, DEFAULT_WAIT_MS, MAX_WAIT_MS};
use super::fast_stop::{FastStopBody, with_reason};
use super::methods::{IDEMPOTENCY_KEY, METHODS, Method, Methods, WSG_LEASE, urgency};
use super::parameters::Parameters;
use super::refused::Refused;
use super::responses::AnyProblem;
use super::values::integer;
use super::{API, Context, body, watched};
use crate::fleet::{Ask, FleetGripper, FleetStop, NoAnswer, Urgency};
use crate::gripper::model::{FastStopId, Name, Reason};
use crate::interfaces::admission::{Class, ConnectionPermit};

/// Where the grippers of any gateway are.
pub const FORWARDED: [&str; 2] =
    ["/fleet/{gateway}/grippers/{gripper}", "/fleet/{gateway}/grippers/{gripper}/{*operation}"];

/// A problem's Content-Type.
const PROBLEM_JSON: &str = "application/problem+json";

/// What travels beside a request's fields, by its header and by its name there.
const ASIDE: [(HeaderName, &str); 2] = [(WSG_LEASE, "lease"), (IDEMPOTENCY_KEY, "request_id")];

/// The grippers of all gateways.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = FleetList)]
pub struct List {
    /// By gateway and name.
    grippers: Vec<FleetGripper>,
}

/// The fleet
///
/// All grippers of all gateways on the Zenoh network, its own among them. `gone` says that a gateway has vanished, within
/// 2 s. Each operation on a gripper is there as `/fleet/{gateway}/grippers/{gripper}/…`, too, with the same fields,
/// answers and problems: the gateway that owns the gripper decides. `gateway_gone` says that nothing was sent there, and
/// `gateway_timeout` that nobody knows whether it was done: ask again with the same `request_id`.
#[utoipa::path(
    get, path = "/fleet", operation_id = "fleet", tag = "fleet",
    responses((status = 200, description = "All grippers of all gateways", body = List), AnyProblem)
)]
pub async fn list(Shared(context): Shared<Arc<Context>>) -> Json<List> {
    Json(List { grippers: context.network.grippers() })
}

/// All gateways' FAST STOP.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "fast_stop_id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "fast_stop_confirmed": false,
    "confirmed": ["cell-7/left"], "unconfirmed": ["cell-8/left"]
}))]
pub struct FleetFastStopAnswer {
    /// What the acknowledges of this gateway's own grippers have to name; the fleet has those of the others.
    #[schema(value_type = uuid::Uuid)]
    fast_stop_id: FastStopId,
    /// Whether all of them have confirmed.
    fast_stop_confirmed: bool,
    /// The grippers whose flags have shown it, as gateway/gripper.
    confirmed: Vec<String>,
    /// The grippers of which that isn't known yet. Their gateways repeat it until it is; one that is gone, and comes back
    /// within a minute without knowing of it, is told again.
    unconfirmed: Vec<String>,
}

/// FAST STOP of the fleet
///
/// Stops all grippers of all gateways. Answers once all whose gateways live have confirmed, or after 500 ms. It is not a safety
/// function in the sense of ISO 13850.
#[utoipa::path(
    post, path = "/fleet/fast-stop", operation_id = "fleet_fast_stop", tag = "fleet",
    request_body = Option<FastStopBody>,
    responses((status = 200, description = "All are told", body = FleetFastStopAnswer), AnyProblem)
)]
pub async fn fast_stop(
    Shared(context): Shared<Arc<Context>>,
    Asker(client): Asker,
    request: Request,
) -> Result<Json<FleetFastStopAnswer>, Problem> {
    let stop = |reason| async move { context.network.fast_stop(&client, &reason).await };
    let FleetStop { id, stops } = with_reason(request, stop).await?;
    watched::note_fast_stop(id);
    let (confirmed, unconfirmed): (Vec<_>, Vec<_>) = stops.into_iter().partition(|(_, confirmed)| *confirmed);
    let names = |stops: Vec<(String, bool)>| stops.into_iter().map(|(name, _)| name).collect();
    Ok(Json(FleetFastStopAnswer {
        fast_stop_id: id,
        fast_stop_confirmed: unconfirmed.is_empty(),
        confirmed: names(confirmed),
        unconfirmed: names(unconfirmed),
    }))
}

/// What a path below a gripper of the fleet names.
struct Target {
    gateway: Name,
    gripper: String,
    /// What follows the gripper, with the slash before it.
    operation: String,
}

impl Target {
    fn of(parameters: &RawPathParams) -> Result<Self, Problem> {
        let find = |name| parameters.iter().find(|(key, _)| *key == name).map(|(_, value)| value.to_owned());
        let unknown = || Problem::not_found("such path");
        Ok(Self {
            gateway: find("gateway")
                .ok_or_else(unknown)?
                .parse()
                .map_err(|_| Problem::not_found("gateway of this name"))?,
            gripper: find("gripper").ok_or_else(unknown)?,
            // A FAST STOP with a trailing slash is accepted everywhere.
            operation: find("operation")
                .map(|operation| {
                    format!("/{}", operation.strip_suffix("fast-stop/").map_or(&*operation, |_| "fast-stop"))
                })
                .unwrap_or_default(),
        })
    }
}

/// Any operation on a gripper of any gateway.
pub async fn forward(
    Shared(context): Shared<Arc<Context>>,
    Extension(methods): Extension<Methods>,
    Asker(client): Asker,
    parameters: RawPathParams,
    request: Request,
) -> Result<Response, Problem> {
    let target = Target::of(&parameters)?;
    if context.network.is_own(&target.gateway) {
        let query = request.uri().query().map(|query| format!("?{query}")).unwrap_or_default();
        let path = format!("{API}/grippers/{}{}{query}", target.gripper, target.operation);
        let mut response = methods.forward(client, to(path, request)?).await;
        // Over there it is written down already.
        response.extensions_mut().remove::<Refused>();
        return Ok(response);
    }
    let gripper = target.gripper.parse().map_err(|_| Problem::not_found("gripper of this name"))?;
    let Some((method, params)) = operation(&request, &target.operation)? else {
        return Ok(not_allowed(&request, &target.operation));
    };
    let (mut wait, aside) = (wait(&request, method)?, aside(&request));
    let permit: Option<Arc<ConnectionPermit>> = request.extensions().get().cloned();
    let long_wait = wait.filter(|wait| !wait.is_zero());
    let _claim = match (permit, long_wait) {
        (Some(permit), Some(_)) => {
            let claim = permit.claim(Class::Waiting);
            wait = if claim.is_some() { long_wait } else { Some(Duration::ZERO) };
            claim
        }
        _ => None,
    };
    let gateway = target.gateway.clone();
    let urgency = urgency(method.name);
    let ask = move |params| async move {
        let (method, params) = (method.name, Value::Object(params));
        context.network.ask(Ask { gateway, gripper, method, params, wait, aside, client, urgency }).await
    };
    let asked = if urgency == Urgency::FastStop {
        let stop = |reason: Reason| ask(Map::from_iter([("reason".to_owned(), reason.as_str().into())]));
        with_reason(request, stop).await?
    } else {
        ask(fields(request, params).await?).await
    };
    match asked {
        Ok(Ok(answer)) => Ok(answered(&target.gateway, &answer)),
        Ok(Err((status, problem))) => Ok(refused(status, &problem)),
        Err(why) => Err(no_answer(&target.gateway, why)),
    }
}

/// A request's fields: those of its path, and those of its body.
async fn fields(request: Request, mut fields: Map<String, Value>) -> Result<Map<String, Value>, Problem> {
    let given: Map<String, Value> = body::parse(&body::bytes(request.into_body()).await?)?;
    // As below a gripper of one's own, where the path alone says which it is.
    if let Some(field) = given.keys().find(|key| fields.contains_key(*key) || *key == "gripper") {
        return Err(Problem::malformed(field, format!("unknown field `{field}`: the path says which")));
    }
    fields.extend(given);
    Ok(fields)
}

/// What its headers say.
fn aside(request: &Request) -> Vec<(&'static str, String)> {
    let given = |(header, name): (HeaderName, &'static str)| {
        Some((name, String::from_utf8_lossy(request.headers().get(header)?.as_bytes()).into_owned()))
    };
    ASIDE.into_iter().filter_map(given).collect()
}

/// The same request for another path.
fn to(path: String, request: Request) -> Result<Request, Problem> {
    let (mut parts, body) = request.into_parts();
    parts.uri = Uri::try_from(path).map_err(|_| Problem::not_found("such path"))?;
    let mut forwarded = Request::builder().method(parts.method).uri(parts.uri).body(Stream::new(body));
    if let Some(headers) = forwarded.as_mut().ok().map(Request::headers_mut) {
        *headers = parts.headers;
    }
    let permit = parts.extensions.remove::<Arc<ConnectionPermit>>();
    if let Some((permit, forwarded)) = permit.zip(forwarded.as_mut().ok()) {
        // The bounds of its connection hold there, too.
        forwarded.extensions_mut().insert(permit);
    }
    forwarded.map_err(|error| Problem::new(Code::Internal, format!("no request: {error}")))
}

/// Whether a request is for an operation on a gripper of any gateway that only stops, or keeps or ends a lease.
pub fn forwards_urgent(verb: &Verb, path: &str) -> bool {
    let below = path.strip_prefix(API).and_then(|path| path.strip_prefix("/fleet/"));
    let operation = below.and_then(|below| below.splitn(4, '/').nth(3));
    let method = operation.and_then(|operation| {
        let operation = format!("/{operation}");
        METHODS.iter().find(|method| method.verb == verb && parameters_of(method, &operation).is_some())
    });
    method.is_some_and(|method| urgency(method.name) != Urgency::None)
}

/// An operation, and the parameters in its path.
type Found = (&'static Method, Map<String, Value>);

/// The operation that a request for a path below a gripper is, and the parameters in it; none where the path is there, and
/// does not take the method.
fn operation(request: &Request, path: &str) -> Result<Option<Found>, Problem> {
    let mut of_path = METHODS.iter().filter_map(|method| Some((method, parameters_of(method, path)?))).peekable();
    of_path.peek().ok_or_else(|| Problem::not_found("such path"))?;
    Ok(of_path.find(|(method, _)| method.verb == request.method()))
}

fn not_allowed(request: &Request, path: &str) -> Response {
    let of_path = METHODS.iter().filter(|method| parameters_of(method, path).is_some());
    let allowed: Vec<_> = of_path.map(|method| method.verb.as_str()).collect();
    let detail = format!("{} is not among the methods of this path, which Allow lists", request.method());
    ([(header::ALLOW, allowed.join(","))], Problem::new(Code::MethodNotAllowed, detail)).into_response()
}

fn parameters_of(method: &Method, path: &str) -> Option<Map<String, Value>> {
    let template = method.path.strip_prefix("/grippers/{gripper}")?;
    if template.split('/').count() != path.split('/').count() {
        return None;
    }
    let mut parameters = Map::new();
    for (part, given) in template.split('/').zip(path.split('/')) {
        match part.strip_prefix('{').and_then(|part| part.strip_suffix('}')) {
            Some(key) => drop(parameters.insert(key.to_owned(), given.into())),
            None if part == given => {}
            None => return None,
        }
    }
    Some(parameters)
}

/// How long the operation may take; none where it takes no time of its own. What has no `wait_ms` doesn't look at one.
fn wait(request: &Request, method: &Method) -> Result<Option<Duration>, Problem> {
    if !method.waits() {
        return Ok(None);
    }
    let given = Parameters::of(request.uri())?.parsed("wait_ms", "a number of ms", |text| text.parse::<f64>().ok())?;
    let wait_ms = given.map(|number| integer("wait_ms", number, 0..=MAX_WAIT_MS)).transpose()?;
    Ok(wait_ms.or(method.is_command.then_some(DEFAULT_WAIT_MS)).map(Duration::from_millis))
}

/// As over there: 202 and where to ask where a command runs.
fn answered(gateway: &Name, answer: &RawValue) -> Response {
    let command: Value = serde_json::from_str(answer.get()).unwrap_or_default();
    let json = [(header::CONTENT_TYPE, "application/json".to_owned())];
    let text = |key: &str| command[key].as_str().unwrap_or_default();
    if text("phase") != "running" {
        return (json, answer.get().to_owned()).into_response();
    }
    let location = format!("{API}/fleet/{gateway}/grippers/{}/commands/{}", text("gripper"), text("id"));
    (StatusCode::ACCEPTED, [(header::LOCATION, location)], json, answer.get().to_owned()).into_response()
}

fn refused(status: u16, problem: &RawValue) -> Response {
    let status =
        StatusCode::from_u16(status).ok().filter(|status| status.is_client_error() || status.is_server_error());
    let headers = [(header::CONTENT_TYPE, PROBLEM_JSON)];
    (status.unwrap_or(StatusCode::BAD_GATEWAY), headers, problem.get().to_owned()).into_response()
}

fn no_answer(gateway: &Name, why: NoAnswer) -> Problem {
    match why {
        NoAnswer::Unknown => Problem::not_found(format!("gateway {gateway} on the Zenoh network: /fleet has them all")),
        NoAnswer::Gone => {
            Problem::new(Code::GatewayGone, format!("{gateway} is gone from the Zenoh network: nothing was sent"))
        }
        NoAnswer::TooMany => Problem::new(
            Code::Overloaded,
            "too many requests to other gateways are under way: await their answers first",
        ),
        NoAnswer::None => {
            let detail = format!(
                "{gateway} has not answered: whether it has done it is unknown. Look at the gripper's state; the same \
                 request_id asks again, and moves nothing twice"
            );
            Problem::new(Code::GatewayTimeout, detail)
        }
    }
}
