//! Problems as responses (RFC 9457).

use axum::Json;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};

use crate::operations::{Code, Problem};

/// Content-Type of a problem.
pub const PROBLEM_JSON: &str = "application/problem+json";

/// When to try again what was too much. The actor works a full queue off within milliseconds, and this is the shortest
/// time that the header can say.
const RETRY_AFTER_S: HeaderValue = HeaderValue::from_static("1");

/// A mark at the response to a refused request, for the access log and the audit.
#[derive(Debug, Clone)]
pub struct RefusedMark {
    /// The problem's code.
    pub code: String,
    /// The problem's text for people.
    pub cause: String,
    /// Whether the journal has a record of it.
    pub is_recorded: bool,
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = (self.status(), Json(self.members())).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        if self.code() == Code::Overloaded {
            headers.insert(header::RETRY_AFTER, RETRY_AFTER_S);
        }
        let (code, cause) = (self.code_word(), self.detail().to_owned());
        response.extensions_mut().insert(RefusedMark { code, cause, is_recorded: self.is_recorded() });
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gripper::Failure;

    #[test]
    fn problem_is_marked_in_its_headers() {
        let response = Problem::from(Failure::Overloaded { limit: 64 }).into_response();
        assert_eq!(response.headers()[header::CONTENT_TYPE], PROBLEM_JSON);
        assert_eq!(response.headers()[header::RETRY_AFTER], "1");
    }
}
