//! Problems as responses (RFC 9457).

use axum::Json;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};

use crate::operations::{Code, Problem};

pub const PROBLEM_JSON: &str = "application/problem+json";

/// Retry-After of an overload. The actor empties a full queue within milliseconds; this is the header's shortest time.
pub const RETRY_AFTER_S: HeaderValue = HeaderValue::from_static("1");

/// Challenge to a client without a valid credential (RFC 6750, 3).
const BEARER: HeaderValue = HeaderValue::from_static("Bearer realm=\"wsg-gateway\"");

/// Mark on the response to a refused request, for the access log and the audit.
#[derive(Debug, Clone)]
pub struct RefusedMark {
    pub code: String,
    /// The problem's detail.
    pub cause: String,
    /// Whether the journal already has a record of the refusal.
    pub is_recorded: bool,
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = (self.status(), Json(self.members())).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        match self.code() {
            Code::Overloaded => drop(headers.insert(header::RETRY_AFTER, RETRY_AFTER_S)),
            Code::UnsupportedEncoding => {
                drop(headers.insert(header::ACCEPT_ENCODING, HeaderValue::from_static("identity")));
            }
            Code::Unauthorized => drop(headers.insert(header::WWW_AUTHENTICATE, BEARER)),
            _ => {}
        }
        let code = self.code_word();
        let cause = self.detail().to_owned();
        response.extensions_mut().insert(RefusedMark { code, cause, is_recorded: self.is_recorded() });
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gripper::Failure;

    #[test]
    fn problem_sets_headers() {
        let response = Problem::from(Failure::Overloaded { limit: 64 }).into_response();
        assert_eq!(response.headers()[header::CONTENT_TYPE], PROBLEM_JSON);
        assert_eq!(response.headers()[header::RETRY_AFTER], "1");
    }
}
