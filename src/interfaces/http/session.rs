//! Sign-in and sign-out of browsers.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Request, State as Shared};
use axum::http::StatusCode;
use axum::http::header::{HeaderValue, SET_COOKIE};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::body;
use super::context::HttpContext;
use super::paths::responses::SessionProblem;
use super::visitor::{SECURE_COOKIE, SESSION_COOKIE, session};
use crate::access::{Identity, Role, SessionId, TokenSecret, Unauthorized};
use crate::operations::json::parse;
use crate::operations::{Code, Problem};

/// Path of the session.
pub const SESSION: &str = "/session";

/// The token to sign in with.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"token": "wsg_n3F0…"}))]
pub struct SignIn {
    /// A token, as `wsg-gateway token create` prints it.
    #[schema(max_length = 64)]
    token: String,
}

/// The client that has signed in.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"name": "anna", "role": "operator"}))]
pub struct SignedIn {
    /// Name of the token.
    name: String,
    role: Role,
}

/// Sign in
///
/// Begins a session of a browser, whose cookie then stands for the token. The session ends with the token, by signing
/// out, or when it is idle.
#[utoipa::path(
    post, path = "/session", operation_id = "sign_in", tag = "gateway", request_body = SignIn,
    responses((status = 200, description = "The session has begun", body = SignedIn), SessionProblem)
)]
pub async fn sign_in(Shared(context): Shared<Arc<HttpContext>>, request: Request) -> Result<Response, Problem> {
    let SignIn { token } = parse(&body::bytes(request.into_body()).await?)?;
    let token: TokenSecret = token.parse().map_err(|_| Unauthorized::Unknown)?;
    let Some((id, Identity { name, role, .. })) = context.gateway.access.sign_in(&token)? else {
        return Err(Problem::new(
            Code::NotFound,
            "this gateway needs no credentials, so there is nothing to sign in to",
        ));
    };
    let name = name.map(|name| name.to_string()).unwrap_or_default();
    Ok(([(SET_COOKIE, cookie(&context, Some(&id))?)], Json(SignedIn { name, role })).into_response())
}

/// Sign out
///
/// Ends the browser's session. Without a session, nothing happens.
#[utoipa::path(
    delete, path = "/session", operation_id = "sign_out", tag = "gateway",
    responses((status = 204, description = "No session is open"), SessionProblem)
)]
pub async fn sign_out(Shared(context): Shared<Arc<HttpContext>>, request: Request) -> Result<Response, Problem> {
    if let Some(id) = session(request.headers()) {
        context.gateway.access.sign_out(&id);
    }
    Ok((StatusCode::NO_CONTENT, [(SET_COOKIE, cookie(&context, None)?)]).into_response())
}

/// Returns the cookie of a session, or one that deletes it. No script can read it, and no other site can send it.
fn cookie(context: &HttpContext, id: Option<&SessionId>) -> Result<HeaderValue, Problem> {
    let (name, secure) = if context.tls.is_some() { (SECURE_COOKIE, "; Secure") } else { (SESSION_COOKIE, "") };
    let end = if id.is_some() { "" } else { "; Max-Age=0" };
    let id = id.map_or("", SessionId::expose);
    let cookie = format!("{name}={id}; Path=/; HttpOnly; SameSite=Strict{secure}{end}");
    let mut cookie = HeaderValue::try_from(cookie).map_err(|_| Problem::internal())?;
    cookie.set_sensitive(true);
    Ok(cookie)
}
