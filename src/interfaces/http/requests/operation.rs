//! Translation between HTTP and operations: path, query, headers and body to parameters, and replies to responses.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::RequestPartsExt as _;
use axum::body::Body;
use axum::extract::{RawPathParams, Request};
use axum::http::request::Parts;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use serde_json::{Map, Value};

use super::body;
use super::fast_stop::with_reason;
use super::unknown_path::no_such_path;
use super::visitor::Identified;
use super::waits::ConnectionWaits;
use crate::interfaces::http::context::{API, HttpContext};
use crate::model::{Door, LeaseToken, Text, Urgency};
use crate::operations::parameters::values::text;
use crate::operations::{
    Caller, Effect, Fields, MAX_LEASE_BYTES, Operation, OperationReply, Params, Presence, Problem, QueryString, Wait,
    run,
};
use crate::recipes::ExpectedVersion;

/// A request's body: a stream that is still to be read, or fields that are already parsed.
pub enum RequestBody {
    Stream(Body),
    Parsed(Fields),
}

/// Marks a response that gets only the necessary headers.
#[derive(Debug, Clone, Copy)]
pub struct Compact;

pub async fn serve(
    context: &Arc<HttpContext>,
    operation: &'static Operation,
    request: Request,
) -> Result<Response, Problem> {
    let (mut parts, stream) = request.into_parts();
    let path = path(&mut parts, operation).await?;
    serve_below(context, operation, path, &parts, RequestBody::Stream(stream)).await
}

/// Performs an operation whose path has already been parsed.
pub async fn serve_below(
    context: &Arc<HttpContext>,
    operation: &'static Operation,
    path: BTreeMap<&'static str, String>,
    parts: &Parts,
    body: RequestBody,
) -> Result<Response, Problem> {
    let gateway = context.gateway.clone();
    let identified = Identified::client_of(&gateway.access, &parts.extensions);
    let mut caller = caller(&identified, parts, operation)?;
    let visitor = identified.visitor;
    let expected = if operation.is_conditional { expected(&parts.headers)? } else { ExpectedVersion::Any };
    let run = move |fields| async move {
        // A credential can end while a slow body arrives.
        caller.identity = visitor.identity(&gateway.access);
        run(&gateway, operation, caller, Params { path, fields, expected }).await
    };
    // A Stop, too, happens whatever its body says and however long the body takes.
    let reply = match body {
        RequestBody::Stream(stream) if operation.ignores_mistakes => {
            let permit = parts.extensions.get().filter(|_| operation.urgency == Urgency::FastStop).cloned();
            with_reason(stream, permit, async |text| run(Fields::Text(text)).await).await?
        }
        // The body of a GET has no meaning (RFC 9110, 9.3.1).
        _ if *operation.verb == Method::GET => run(Fields::Object(query(&parts.uri, operation)?)).await?,
        RequestBody::Stream(stream) => run(Fields::Text(body::bytes(stream).await?)).await?,
        RequestBody::Parsed(fields) => run(fields).await?,
    };
    let mut response = response(reply);
    if operation.is_compact {
        response.extensions_mut().insert(Compact);
    }
    Ok(response)
}

/// Returns the fields that a read has in its query string. An operation with filters gets all, since a misspelt one would
/// have no effect, and refuses those that it does not know.
pub fn query(uri: &Uri, operation: &Operation) -> Result<Map<String, Value>, Problem> {
    if uri.query().is_none() {
        return Ok(Map::new());
    }
    let given = QueryString::of(uri);
    let known = operation.field_names();
    if known.is_empty() || operation.waits { given.fields(&known) } else { given.all() }
}

/// Returns the path's parameters. A path that is not valid text is not found.
async fn path(parts: &mut Parts, operation: &Operation) -> Result<BTreeMap<&'static str, String>, Problem> {
    let given: RawPathParams = parts.extract().await.map_err(|_| no_such_path())?;
    let mut path = BTreeMap::new();
    for key in operation.path_parameters() {
        let value = path_parameter(&given, key).ok_or_else(no_such_path)?;
        path.insert(key, value.to_owned());
    }
    Ok(path)
}

pub fn path_parameter<'a>(parameters: &'a RawPathParams, name: &str) -> Option<&'a str> {
    parameters.iter().find(|(key, _)| *key == name).map(|(_, value)| value)
}

fn caller(identified: &Identified, parts: &Parts, operation: &Operation) -> Result<Caller, Problem> {
    let wait = if operation.waits {
        let given = QueryString::of(&parts.uri).one("wait_ms").map(|given| given.map(ToOwned::to_owned));
        let given = if operation.ignores_mistakes { given.unwrap_or_default() } else { given? };
        Wait::Ms { given, limiter: ConnectionWaits::of(&parts.extensions) }
    } else {
        Wait::No
    };
    Ok(Caller {
        client: identified.client(Door::Http),
        identity: identified.identity.clone(),
        lease: key::<MAX_LEASE_BYTES>(&parts.headers, "Wsg-Lease")
            .map(|lease| lease.map(|lease| LeaseToken::from(lease.as_str()))),
        request_id: key(&parts.headers, "Idempotency-Key"),
        presence: Presence::Seen,
        wait,
    }
    .labelled(label(&parts.headers)))
}

/// Returns the label of the client's user, if it is text.
fn label(headers: &HeaderMap) -> Option<&str> {
    std::str::from_utf8(headers.get("Wsg-Client")?.as_bytes()).ok()
}

/// Returns the version that the request expects (RFC 9110 13.1): that of `If-Match`, or none with `If-None-Match: *`.
fn expected(headers: &HeaderMap) -> Result<ExpectedVersion, Problem> {
    match (condition(headers, header::IF_MATCH.as_str())?, condition(headers, header::IF_NONE_MATCH.as_str())?) {
        (None, None) => Ok(ExpectedVersion::Any),
        (Some(tag), None) if tag.as_str() == "*" => Ok(ExpectedVersion::Present),
        (None, Some(tag)) if tag.as_str() == "*" => Ok(ExpectedVersion::Absent),
        (Some(tag), None) if tag.as_str().contains(',') => {
            Err(Problem::malformed("If-Match", "If-Match must be * or one ETag: a change replaces one version"))
        }
        (Some(tag), None) => {
            // A tag that is not this gateway's matches nothing (RFC 9110 13.1.1). No version is 0.
            Ok(ExpectedVersion::Exactly(tagged_version(tag.as_str()).unwrap_or_default()))
        }
        _ => Err(Problem::malformed("If-None-Match", "If-None-Match must be *, without If-Match")),
    }
}

fn condition(headers: &HeaderMap, name: &'static str) -> Result<Option<Text<64>>, Problem> {
    match headers.get(name).map(HeaderValue::is_empty) {
        None => Ok(None),
        // An empty condition is one whose value got lost: it must not count as none.
        Some(true) => Err(Problem::malformed(name, format!("{name} is empty: leave it out, or send the ETag"))),
        Some(false) => key(headers, name),
    }
}

/// Encodings whose names proxies append to the ETag of a response that they compress.
const TAGGED_ENCODINGS: [&str; 4] = ["-gzip", "-br", "-zstd", "-deflate"];

/// Returns the version in an ETag. A proxy that compresses a response marks its ETag, as weak or with the name of the
/// encoding, although the version is the same: so the versions are compared, and not the tags byte by byte.
fn tagged_version(tag: &str) -> Option<u64> {
    let quoted = tag.strip_prefix("W/").unwrap_or(tag);
    let version = quoted.strip_prefix('"')?.strip_suffix('"')?;
    let marked = TAGGED_ENCODINGS.iter().find_map(|encoding| version.strip_suffix(encoding));
    marked.unwrap_or(version).parse().ok()
}

fn key<const MAX: usize>(headers: &HeaderMap, name: &'static str) -> Result<Option<Text<MAX>>, Problem> {
    let mut values = headers.get_all(name).iter();
    let (first, None) = (values.next(), values.next()) else {
        return Err(Problem::malformed(name, format!("{name} is given more than once")));
    };
    let Some(value) = first.filter(|value| !value.is_empty()) else { return Ok(None) };
    let given = std::str::from_utf8(value.as_bytes())
        .map_err(|_| Problem::malformed(name, format!("{name} is not valid UTF-8")))?;
    text(name, given).map(Some)
}

/// Returns 200 with the result. A command that is still running gets 202 with its Location. A request that waits for
/// the lease's holder gets 202 without one.
fn response(OperationReply { body, effect, version, is_new }: OperationReply) -> Response {
    let json = [(header::CONTENT_TYPE, "application/json")];
    let tag = version.map(|version| [(header::ETAG, format!("\"{version}\""))]);
    let body = String::from(Box::<str>::from(body));
    match effect {
        Effect::Running { gripper, ticket } => {
            let location = format!("{API}/grippers/{gripper}/commands/{}", ticket.id());
            (StatusCode::ACCEPTED, [(header::LOCATION, location)], json, body).into_response()
        }
        Effect::Waiting => (StatusCode::ACCEPTED, json, body).into_response(),
        Effect::None | Effect::Leased(_) if is_new => (StatusCode::CREATED, tag, json, body).into_response(),
        Effect::None | Effect::Leased(_) => (tag, json, body).into_response(),
    }
}

#[cfg(test)]
mod tests {
    use axum::http::{Extensions, Request};

    use super::*;
    use crate::access::Access;
    use crate::operations::gripper::motion;

    fn parts(uri: &str, headers: &[(&str, &str)]) -> Parts {
        let mut request = Request::get(uri);
        for (name, value) in headers {
            request = request.header(*name, *value);
        }
        request.body(()).unwrap().into_parts().0
    }

    fn nobody() -> Identified {
        Identified::client_of(&Access::default(), &Extensions::new())
    }

    fn caller_of(headers: &[(&str, &str)]) -> Caller {
        caller(&nobody(), &parts("/home", headers), &motion::HOME).unwrap()
    }

    #[test]
    fn keys_come_from_headers() {
        let caller = caller_of(&[("Idempotency-Key", "job 7"), ("Wsg-Lease", "token")]);
        assert_eq!(caller.lease.unwrap().unwrap().as_str(), "token");
        assert_eq!(caller.request_id.unwrap().unwrap().as_str(), "job 7");
        let caller = caller_of(&[("Idempotency-Key", ""), ("Wsg-Lease", "")]);
        assert_eq!((caller.lease.unwrap(), caller.request_id.unwrap()), (None, None));
    }

    #[test]
    fn invalid_key_is_refused() {
        let refused = |headers: &[(&str, &str)]| caller_of(headers).request_id.unwrap_err().status().as_u16();
        assert_eq!(refused(&[("Idempotency-Key", &"x".repeat(65))]), 422);
        assert_eq!(refused(&[("Idempotency-Key", "a\tb")]), 400);
        assert_eq!(refused(&[("Idempotency-Key", "a"), ("Idempotency-Key", "b")]), 400);
    }

    #[test]
    fn version_survives_a_proxy_that_compresses() {
        for tag in ["\"12\"", "W/\"12\"", "\"12-gzip\"", "W/\"12-br\"", "\"12-zstd\""] {
            assert_eq!(tagged_version(tag), Some(12), "{tag}");
        }
        for tag in ["12", "w/\"12\"", "W/12", "\"12", "\"12-x\"", "\"-gzip\"", "\"a\"", "\"\""] {
            assert_eq!(tagged_version(tag), None, "{tag}");
        }
    }

    #[test]
    fn wait_is_given_once() {
        assert!(caller(&nobody(), &parts("/home?wait_ms=1&wait_ms=2", &[]), &motion::HOME).is_err());
        let caller = caller(&nobody(), &parts("/home?wait_ms=96.0&other=1", &[]), &motion::HOME).unwrap();
        assert!(matches!(caller.wait, Wait::Ms { given: Some(given), .. } if given == "96.0"));
    }
}
