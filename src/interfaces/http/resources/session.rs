//! Sign-in and sign-out of browsers.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Request, State as Shared};
use axum::http::StatusCode;
use axum::http::header::{HeaderValue, SET_COOKIE};
use axum::response::{IntoResponse, Response};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::access::{Identity, Role, SessionId, TokenSecret, Unauthorized};
use crate::interfaces::http::context::HttpContext;
use crate::interfaces::http::documents::paths::responses::SessionProblem;
use crate::interfaces::http::requests::body;
use crate::interfaces::http::requests::visitor::{accepted_cookie, cookie_name, session};
use crate::operations::parameters::json::parse;
use crate::operations::{Code, Problem};

/// Paths of the session.
pub const SESSION: [&str; 2] = ["/session", "/session/pin"];

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
    let SignIn { token } = secret(&body::bytes(request.into_body()).await?)?;
    let token: TokenSecret = token.parse().map_err(Unauthorized::from)?;
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
    // A page of another origin must not delete the cookie either.
    if accepted_cookie(request.headers(), &context.settings.get()).is_none() {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    if let Some(id) = open_session(&context, &request) {
        context.gateway.access.sign_out(&id);
    }
    Ok((StatusCode::NO_CONTENT, [(SET_COOKIE, cookie(&context, None)?)]).into_response())
}

/// The PIN of a person at a shared panel.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(example = json!({"pin": "381902"}))]
pub struct EnterPin {
    /// A PIN, as `wsg-gateway token create --pin` prints it.
    #[schema(max_length = 6, pattern = "^[0-9]{6}$")]
    pin: String,
}

/// Enter a PIN
///
/// Gives the browser's session the name, role and grippers of a person in place of its own, until `DELETE` or until
/// they are unused for `pin_idle_min`. After five wrong PINs, the sessions of one token have to wait for five minutes.
#[utoipa::path(
    post, path = "/session/pin", operation_id = "enter_pin", tag = "gateway", request_body = EnterPin,
    responses((status = 200, description = "The session now has the person's rights", body = SignedIn), SessionProblem)
)]
pub async fn enter_pin(Shared(context): Shared<Arc<HttpContext>>, request: Request) -> Result<Json<SignedIn>, Problem> {
    let id = open_session(&context, &request).ok_or(Unauthorized::SessionEnded)?;
    let EnterPin { pin } = secret(&body::bytes(request.into_body()).await?)?;
    let pin = pin.parse().map_err(|_| Unauthorized::WrongPin)?;
    let Identity { name, role, .. } = context.gateway.access.enter_pin(&id, &pin)?;
    Ok(Json(SignedIn { name: name.map(|name| name.to_string()).unwrap_or_default(), role }))
}

/// Forget the PIN
///
/// Takes the rights of a PIN away from the browser's session. Without them, nothing happens.
#[utoipa::path(
    delete, path = "/session/pin", operation_id = "forget_pin", tag = "gateway",
    responses((status = 204, description = "The session has its own rights only"), SessionProblem)
)]
pub async fn forget_pin(Shared(context): Shared<Arc<HttpContext>>, request: Request) -> StatusCode {
    if let Some(id) = open_session(&context, &request) {
        context.gateway.access.forget_pin(&id);
    }
    StatusCode::NO_CONTENT
}

/// Parses a body with a secret, which no problem repeats.
fn secret<T: DeserializeOwned>(text: &[u8]) -> Result<T, Problem> {
    parse(text).map_err(|_| Problem::malformed("body", "the body must be an object with one field: token, or pin"))
}

/// Returns the session that a request names. Pages of other origins have none.
fn open_session(context: &HttpContext, request: &Request) -> Option<SessionId> {
    session(request.headers(), &accepted_cookie(request.headers(), &context.settings.get())?)
}

/// Returns the cookie of a session, or one that deletes it. No script can read it, and no other site can send it.
fn cookie(context: &HttpContext, id: Option<&SessionId>) -> Result<HeaderValue, Problem> {
    let settings = context.settings.get();
    let name = cookie_name(&settings);
    let secure = if settings.tls.is_some() { "; Secure" } else { "" };
    let end = if id.is_some() { "" } else { "; Max-Age=0" };
    let id = id.map_or("", SessionId::expose);
    let cookie = format!("{name}={id}; Path=/; HttpOnly; SameSite=Strict{secure}{end}");
    let mut cookie = HeaderValue::try_from(cookie).map_err(|_| Problem::internal())?;
    cookie.set_sensitive(true);
    Ok(cookie)
}
