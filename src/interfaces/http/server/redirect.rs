//! The answer to a client that does not speak TLS where TLS is needed.

use std::convert::Infallible;
use std::sync::Arc;

use axum::http::header::{CONNECTION, HOST, HeaderValue, LOCATION};
use axum::http::{Method, Request, Response, StatusCode};
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpStream;

use crate::interfaces::http::http_settings::HttpSettings;
use crate::interfaces::http::requests::guard::is_ours;

/// Maximum size of a request's header: the smallest that hyper supports.
const MAX_HEADER_BYTES: usize = 8192;

/// Answers one request. Only reads are redirected: a client that sends its token with a change must not get used to
/// sending it in the clear. The redirection is temporary, since a browser keeps a permanent one even after TLS has been
/// switched off.
pub async fn answer(stream: TcpStream, settings: Arc<HttpSettings>) {
    let service = service_fn(async |request| Ok::<_, Infallible>(response(&request, &settings.web.hosts)));
    let mut http = http1::Builder::new();
    let http = http.timer(TokioTimer::new()).max_buf_size(MAX_HEADER_BYTES);
    if let Err(error) = http.serve_connection(TokioIo::new(stream), service).await {
        tracing::debug!(%error, "connection without TLS ended");
    }
}

fn response(request: &Request<Incoming>, allowed_hosts: &[String]) -> Response<String> {
    let host =
        request.headers().get(HOST).and_then(|host| host.to_str().ok()).filter(|host| is_ours(host, allowed_hosts));
    let mut response = Response::new("this gateway needs TLS: use https://\n".to_owned());
    *response.status_mut() = StatusCode::BAD_REQUEST;
    let path = request.uri().path_and_query().map_or("/", |path| path.as_str());
    let location = host.filter(|_| matches!(*request.method(), Method::GET | Method::HEAD));
    if let Some(Ok(location)) = location.map(|host| HeaderValue::try_from(format!("https://{host}{path}"))) {
        *response.status_mut() = StatusCode::TEMPORARY_REDIRECT;
        response.headers_mut().insert(LOCATION, location);
    }
    response.headers_mut().insert(CONNECTION, HeaderValue::from_static("close"));
    response
}
