//! Checks of Host and Origin, which protect a gateway without authentication: web pages of other origins and
//! foreign DNS names that point here are refused. Also adds the security headers of every response.

use std::convert::Infallible;
use std::net::{Ipv4Addr, Ipv6Addr};

use axum::extract::Request;
use axum::http::header::{
    ALLOW, CACHE_CONTROL, CONTENT_SECURITY_POLICY, DATE, ETAG, HOST, HeaderName, HeaderValue, LINK, LOCATION, ORIGIN,
    REFERRER_POLICY, RETRY_AFTER, WWW_AUTHENTICATE, X_CONTENT_TYPE_OPTIONS,
};
use axum::http::{HeaderMap, Method as Verb, Version};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures_util::FutureExt as _;
use jiff::fmt::rfc2822::DateTimePrinter;
use tower::{Layer as _, ServiceExt as _, service_fn};
use tower_http::cors::{AllowHeaders, AllowOrigin, CorsLayer};

use super::body;
use super::operation::Compact;
use super::origin::{is_same, is_same_authority};
use crate::gripper::Now;
use crate::interfaces::http::http_settings::HttpSettings;
use crate::operations::{Code, Problem};

/// Headers of responses that scripts of the listed origins can read, besides those that browsers let them read anyway.
const READ_BY_PAGES: [HeaderName; 9] = [
    ALLOW,
    DATE,
    ETAG,
    LINK,
    LOCATION,
    RETRY_AFTER,
    WWW_AUTHENTICATE,
    HeaderName::from_static("journal-id"),
    HeaderName::from_static("next-cursor"),
];

/// Refuses foreign hosts and origins, whatever the method. Any Content-Type is read as JSON, so without this check a
/// plain form on another site could move a gripper.
pub async fn check_host_and_origin(
    settings: &HttpSettings,
    mut request: Request,
    next: impl AsyncFnOnce(Request) -> Response,
) -> Response {
    match check(&request, settings) {
        Ok(()) => {
            // For the dashboard: the pages that may show it in a frame.
            request.extensions_mut().insert(settings.frame_policy.clone());
            next(request).await
        }
        Err(problem) => {
            body::drain(request.into_body()).await;
            problem.into_response()
        }
    }
}

/// Lets the pages of the listed origins use the API (CORS). Other requests pass unchanged.
pub async fn apply_cors<F: Future<Output = Response>>(
    settings: &HttpSettings,
    request: Request,
    next: Next,
    serve: impl Fn(Request, Next) -> F,
) -> Response {
    let origin = request.headers().get(ORIGIN).filter(|origin| settings.allows_origin(origin)).cloned();
    let Some(origin) = origin else { return serve(request, next).await };
    let cors = CorsLayer::new()
        .allow_origin(AllowOrigin::exact(origin))
        .allow_methods([Verb::GET, Verb::POST, Verb::PUT, Verb::DELETE])
        .allow_headers(AllowHeaders::mirror_request())
        .expose_headers(READ_BY_PAGES)
        // No response is cached.
        .vary([]);
    let served = cors.layer(service_fn(|request| serve(request, next.clone()).map(Ok::<_, Infallible>)));
    served.oneshot(request).await.unwrap_or_else(|error| match error {})
}

fn check(request: &Request, settings: &HttpSettings) -> Result<(), Problem> {
    let host = authority(request)?;
    match &host {
        Some(host) if !is_ours(host, &settings.web.hosts) => {
            let detail = "the Host header names an unknown host: use an IP address or localhost, or add the name to \
                          hosts in the configuration";
            return Err(Problem::new(Code::ForeignHost, detail));
        }
        _ => {}
    }
    for origin in request.headers().get_all(ORIGIN) {
        let own = origin.to_str().ok().zip(host.as_deref());
        let is_own = own.is_some_and(|(origin, host)| is_same(origin, host, settings.tls.is_some()));
        if !is_own && !settings.allows_origin(origin) {
            let detail = "the Origin header names a web page of another origin than the Host header: list the page's \
                          origin in cors_origins, or let a proxy pass on the Host header of the browser";
            return Err(Problem::new(Code::ForeignOrigin, detail));
        }
    }
    Ok(())
}

/// Returns the request's authority in lower case. Only HTTP/1.0 may omit it.
fn authority(request: &Request) -> Result<Option<String>, Problem> {
    let header = match all_of(request.headers(), &HOST)[..] {
        [] => None,
        // A client whose target has no authority sends an empty one (RFC 9112, 3.2); no browser does.
        [host] if host.is_empty() && request.uri().authority().is_none() => return Ok(None),
        [host] => {
            let host = host.to_str().map_err(|_| invalid_host("the Host header is not valid text"))?;
            Some(host.to_ascii_lowercase())
        }
        _ => return Err(invalid_host("there is more than one Host header")),
    };
    let scheme = request.uri().scheme_str().unwrap_or("http");
    // In the absolute form the request's target counts, and the Host header must not differ from it (RFC 9112, 3.2.2).
    let target = request.uri().authority().map(|authority| authority.as_str().to_ascii_lowercase());
    match (header, target) {
        (Some(header), Some(target)) if !is_same_authority(scheme, &header, &target) => {
            Err(invalid_host("the Host header differs from the target"))
        }
        (None, None) if request.version() > Version::HTTP_10 => Err(invalid_host("the Host header is missing")),
        (header, target) => Ok(header.or(target)),
    }
}

fn invalid_host(detail: &str) -> Problem {
    Problem::malformed("Host", detail)
}

fn all_of<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Vec<&'a HeaderValue> {
    headers.get_all(name).iter().collect()
}

/// Whether a host is an address, `localhost`, or one of the `allowed`, whatever its port.
pub(in crate::interfaces::http) fn is_ours(authority: &str, allowed: &[String]) -> bool {
    if let Some((address, rest)) = authority.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
        let port = rest.strip_prefix(':').is_some_and(is_port);
        return address.parse::<Ipv6Addr>().is_ok() && (rest.is_empty() || port);
    }
    let (host, port) = match authority.split_once(':') {
        Some((host, port)) => (host, Some(port)),
        None => (authority, None),
    };
    port.is_none_or(is_port)
        && (host == "localhost"
            || host.parse::<Ipv4Addr>().is_ok()
            || allowed.iter().any(|allowed| allowed.eq_ignore_ascii_case(host)))
}

fn is_port(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_digit()) && text.parse::<u16>().is_ok()
}

/// Policy of responses without their own policy: a browser must not load or run anything.
const NO_CONTENT: HeaderValue = HeaderValue::from_static("default-src 'none'; frame-ancestors 'none'");

/// Adds the headers that keep browsers from sniffing, caching and embedding responses, and the date. A compact response
/// gets none of them.
pub fn harden(mut response: Response) -> Response {
    if response.extensions().get::<Compact>().is_some() {
        return response;
    }
    let headers = response.headers_mut();
    if let Some(date) = date() {
        headers.insert(DATE, date);
    }
    headers.insert(X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.entry(CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    headers.entry(CONTENT_SECURITY_POLICY).or_insert(NO_CONTENT);
    response
}

fn date() -> Option<HeaderValue> {
    let date = DateTimePrinter::new().timestamp_to_rfc9110_string(&Now::read().wall);
    date.ok().and_then(|date| date.try_into().ok())
}

#[cfg(test)]
mod tests {
    use axum::body::Body;
    use axum::http;

    use super::*;
    use crate::interfaces::http::WebSettings;

    fn answer(version: Version, headers: &[(HeaderName, &str)]) -> Option<u16> {
        let mut request = http::Request::get("/api/v1/grippers").version(version);
        for (name, value) in headers {
            request = request.header(name, *value);
        }
        let request = request.body(Body::empty()).unwrap();
        let web = WebSettings { hosts: vec!["gateway.example".to_owned()], ..WebSettings::default() };
        check(&request, &HttpSettings { web, ..HttpSettings::default() }).err().map(|problem| problem.status().as_u16())
    }

    #[test]
    fn addresses_localhost_and_configured_names_are_accepted() {
        for host in ["", "127.0.0.1", "10.0.0.7:8080", "[::1]", "[fe80::1]:80", "localhost", "LocalHost:8080"] {
            assert_eq!(answer(Version::HTTP_11, &[(HOST, host)]), None, "{host}");
        }
        assert_eq!(answer(Version::HTTP_11, &[(HOST, "Gateway.Example:443")]), None);
    }

    #[test]
    fn any_other_host_is_refused() {
        for host in ["evil.example", "localhost.evil.example", "127.0.0.1.evil.example", "[evil", "[x]:80"] {
            assert_eq!(answer(Version::HTTP_11, &[(HOST, host)]), Some(403), "{host}");
        }
        for host in ["localhost:80:80", "localhost:+80", "[::1]80", "127.1", "0x7f000001"] {
            assert_eq!(answer(Version::HTTP_11, &[(HOST, host)]), Some(403), "{host}");
        }
    }

    #[test]
    fn host_is_optional_in_http_1_0_only() {
        assert_eq!(answer(Version::HTTP_10, &[]), None);
        assert_eq!(answer(Version::HTTP_11, &[]), Some(400));
        assert_eq!(answer(Version::HTTP_11, &[(HOST, "localhost"), (HOST, "localhost")]), Some(400));
    }

    #[test]
    fn foreign_origin_is_refused() {
        let from = |origin| answer(Version::HTTP_11, &[(HOST, "localhost:8080"), (ORIGIN, origin)]);
        assert_eq!(from("http://localhost:8080"), None);
        assert_eq!(from("https://localhost:8080"), None);
        for foreign in ["http://evil.example", "http://localhost", "http://localhost:8081", "null", "localhost:8080"] {
            assert_eq!(from(foreign), Some(403), "{foreign}");
        }
        assert_eq!(answer(Version::HTTP_10, &[(ORIGIN, "http://localhost")]), Some(403));
    }

    #[test]
    fn default_port_makes_no_other_origin() {
        fn from(origin: &str, host: &str) -> Option<u16> {
            answer(Version::HTTP_11, &[(HOST, host), (ORIGIN, origin)])
        }
        for (origin, host) in [
            ("http://gateway.example", "gateway.example:80"),
            ("https://gateway.example", "gateway.example:443"),
            ("https://gateway.example:443", "gateway.example"),
            ("http://[::1]", "[::1]:80"),
        ] {
            assert_eq!(from(origin, host), None, "{origin} to {host}");
        }
        for (origin, host) in [
            ("http://gateway.example", "gateway.example:443"),
            ("https://gateway.example", "gateway.example:80"),
            ("http://gateway.example", "gateway.example:8080"),
            ("http://gateway.example:8080", "gateway.example:80"),
        ] {
            assert_eq!(from(origin, host), Some(403), "{origin} to {host}");
        }
    }

    #[test]
    fn absolute_target_is_the_host() {
        let request = |uri: &str, host: &str| {
            let request = http::Request::get(uri).header(HOST, host).body(Body::empty()).unwrap();
            check(&request, &HttpSettings::default()).err().map(|problem| problem.status().as_u16())
        };
        assert_eq!(request("http://127.0.0.1/", "127.0.0.1"), None);
        assert_eq!(request("http://127.0.0.1:80/", "127.0.0.1"), None);
        assert_eq!(request("http://evil.example/", "evil.example"), Some(403));
        assert_eq!(request("http://evil.example/", "127.0.0.1"), Some(400));
    }
}
