//! Tickets, with which web pages of other origins open WebSockets and streams.

use std::sync::Arc;

use axum::Json;
use axum::extract::{Request, State as Shared};
use axum::http::HeaderMap;
use axum::http::header::SEC_WEBSOCKET_PROTOCOL;
use serde::Serialize;
use utoipa::ToSchema;

use crate::access::{TICKET_TIME, TicketId};
use crate::interfaces::http::context::{API, HttpContext, SOCKET, STREAM};
use crate::interfaces::http::documents::paths::responses::AnyProblem;
use crate::interfaces::http::requests::visitor::Identified;
use crate::operations::Problem;

/// Path at which tickets are issued.
pub const PATH: &str = "/tickets";

/// Parameter of a stream's query string with a ticket.
pub const TICKET: &str = "ticket";

/// Beginning of a WebSocket's subprotocol with a ticket. A subprotocol appears in fewer logs than a query string.
const SUBPROTOCOL_PREFIX: &str = "wsg.ticket.";

/// A ticket for one WebSocket or stream.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"ticket": "Jf3kXq0bTn9pZr5sVw2yCa7dEg1hLm4oQu6tYi8xBv0", "expires_in_ms": 30000}))]
pub struct IssuedTicket {
    /// Secret text. A WebSocket offers it as the subprotocol `wsg.ticket.` and this text, in addition to `wsg.v1`; a
    /// stream has it as the parameter `ticket`.
    ticket: String,
    /// Time until which it can be used, once.
    #[schema(minimum = 0, maximum = 30000)]
    expires_in_ms: u64,
}

/// Get a ticket
///
/// Returns a ticket for one WebSocket or stream, which then has the rights of this request's credential. It is for web
/// pages of other origins, which cannot send a header with a WebSocket or an `EventSource`.
#[utoipa::path(
    post, path = "/tickets", operation_id = "get_ticket", tag = "gateway",
    responses((status = 200, description = "The ticket", body = IssuedTicket), AnyProblem)
)]
pub async fn issue(Shared(context): Shared<Arc<HttpContext>>, request: Request) -> Result<Json<IssuedTicket>, Problem> {
    let access = &context.gateway.access;
    let Identified { visitor, identity } = Identified::client_of(access, request.extensions());
    // The rights are checked when the ticket is used.
    identity?;
    let ticket = access.issue_ticket(&visitor.credential).map_err(|_| Problem::internal())?;
    Ok(Json(IssuedTicket { ticket: ticket.expose().to_owned(), expires_in_ms: TICKET_TIME.as_millis() as u64 }))
}

/// Returns the ticket with which a request opens a WebSocket or a stream.
pub fn presented<B>(request: &axum::http::Request<B>) -> Option<TicketId> {
    match request.uri().path().strip_prefix(API)? {
        SOCKET => offered(request.headers()).find_map(|name| name.strip_prefix(SUBPROTOCOL_PREFIX)),
        STREAM => request.uri().query()?.split('&').find_map(|pair| pair.strip_prefix(TICKET)?.strip_prefix('=')),
        _ => None,
    }
    .map(TicketId::from)
}

/// Returns the subprotocols that a client offers.
pub fn offered(headers: &HeaderMap) -> impl Iterator<Item = &str> {
    let values = headers.get_all(SEC_WEBSOCKET_PROTOCOL).iter().filter_map(|value| value.to_str().ok());
    values.flat_map(|value| value.split(',')).map(str::trim)
}

#[cfg(test)]
mod tests {
    use axum::http::Request;

    use super::*;

    fn socket(offered: &str) -> Option<TicketId> {
        let request = Request::get("/api/v1/ws?ticket=q").header(SEC_WEBSOCKET_PROTOCOL, offered);
        presented(&request.body(()).unwrap())
    }

    fn at(path: &str) -> Option<TicketId> {
        presented(&Request::get(path).body(()).unwrap())
    }

    #[test]
    fn ticket_is_in_the_subprotocol_or_the_query() {
        assert_eq!(socket("wsg.v1, wsg.ticket.abc"), Some("abc".into()));
        assert_eq!(socket("wsg.v1"), None);
        assert_eq!(at("/api/v1/stream?topics=state&ticket=abc"), Some("abc".into()));
        assert_eq!(at("/api/v1/stream?ticketabc&my_ticket=abc"), None);
        assert_eq!(at("/api/v1/events?ticket=abc"), None);
    }
}
