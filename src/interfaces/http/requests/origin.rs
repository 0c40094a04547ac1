//! Origins of web pages (RFC 6454), compared with the host of a request.

use axum::http::HeaderMap;
use axum::http::header::{HOST, HeaderValue};

use crate::interfaces::http::http_settings::HttpSettings;

/// Whether the origin is listed, and not that of the gateway's own pages.
pub fn is_listed_other(headers: &HeaderMap, origin: &HeaderValue, settings: &HttpSettings) -> bool {
    let host = headers.get(HOST).and_then(|host| host.to_str().ok()).map(str::to_ascii_lowercase);
    let own = origin.to_str().ok().zip(host);
    let is_own = own.is_some_and(|(origin, host)| is_same(origin, &host, settings.tls.is_some()));
    settings.allows_origin(origin) && !is_own
}

/// Whether an origin is the host that the request was sent to. A proxy can add TLS to a gateway without it; a gateway
/// with TLS has no pages without it.
pub fn is_same(origin: &str, host: &str, has_tls: bool) -> bool {
    match origin.to_ascii_lowercase().split_once("://") {
        Some(("https", authority)) => is_same_authority("https", authority, host),
        Some(("http", authority)) => !has_tls && is_same_authority("http", authority, host),
        _ => false,
    }
}

/// Whether two authorities of a scheme are the same. A browser leaves out the scheme's default port; a proxy can add it.
pub fn is_same_authority(scheme: &str, one: &str, other: &str) -> bool {
    let default_port = if scheme == "https" { ":443" } else { ":80" };
    one.strip_suffix(default_port).unwrap_or(one) == other.strip_suffix(default_port).unwrap_or(other)
}
