//! The HTTP client: one connection for each attempt. It does not follow redirects, and reads only a response's header.

use std::io;
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures_util::future::{Either, select};
use headers::{Date, Header as _};
use http::header::RETRY_AFTER;
use http::{HeaderMap, HeaderValue, Request, StatusCode};
use http_body_util::Full;
use hyper::client::conn::http1;
use hyper::rt::{Read, Write};
use hyper_util::rt::TokioIo;
use tokio::time::timeout;
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::crypto::ring::default_provider;
use tokio_rustls::rustls::{self, ClientConfig};

use super::webhook_settings::{Authorities, Receiver};
use crate::transport::host::connect_to_host;

/// Time limit of an attempt, from the connection to the header of the response.
const ANSWERED_WITHIN: Duration = Duration::from_secs(15);

/// Time limit for connecting to any of the receiver's addresses; the rest is for its answer.
const CONNECTED_WITHIN: Duration = Duration::from_secs(10);

/// Size limit of a response's header in bytes.
const MAX_HEADER_BYTES: usize = 16 * 1024;

/// Reason why a delivery failed, with the remedy. The texts never contain the URL's path, which can be secret.
#[derive(Debug, thiserror::Error)]
pub enum DeliveryFailure {
    #[error("cannot connect to {receiver}: {cause}; check that the receiver runs and can be reached")]
    Unreachable { receiver: Receiver, cause: io::Error },
    #[error("TLS with {receiver} failed: {cause}; check the receiver's certificate, or set ca_file to its CA")]
    Tls { receiver: Receiver, cause: io::Error },
    #[error("{receiver} sent no valid response: {cause}; check that url names an HTTP server")]
    Response { receiver: Receiver, cause: hyper::Error },
    #[error("{receiver} did not answer within {} s: answer first, and process the event afterwards", ANSWERED_WITHIN.as_secs())]
    Late { receiver: Receiver },
    #[error("{receiver} answered {status}: {}", remedy(*status))]
    Refused {
        receiver: Receiver,
        status: StatusCode,
        /// Pause that the receiver asked for.
        retry_after: Option<Duration>,
    },
    /// The request could not be built.
    #[error(transparent)]
    Request(#[from] http::Error),
}

fn remedy(status: StatusCode) -> &'static str {
    match status.as_u16() {
        300..=399 => "redirects are not followed, so set url to the final address",
        401 | 403 => "check that the receiver has the same secret, and that both clocks are right",
        _ => "only 2xx counts as delivered, so see the receiver's log",
    }
}

impl DeliveryFailure {
    /// Status of the response, if there was one.
    #[must_use]
    pub fn status(&self) -> Option<StatusCode> {
        match self {
            Self::Refused { status, .. } => Some(*status),
            _ => None,
        }
    }

    pub(super) fn retry_after(&self) -> Option<Duration> {
        match self {
            Self::Refused { retry_after, .. } => *retry_after,
            _ => None,
        }
    }
}

/// A client of one receiver.
#[derive(Debug)]
pub(super) struct WebhookClient {
    receiver: Receiver,
    tls: Arc<ClientConfig>,
}

impl WebhookClient {
    pub(super) fn new(receiver: Receiver, authorities: &Authorities) -> Result<Self, rustls::Error> {
        let config = ClientConfig::builder_with_provider(Arc::new(default_provider()))
            .with_safe_default_protocol_versions()?
            .with_root_certificates(authorities.roots())
            .with_no_client_auth();
        Ok(Self { receiver, tls: Arc::new(config) })
    }

    /// Sends a request, and returns the status of an accepting response.
    pub(super) async fn send(&self, request: Request<Full<Bytes>>) -> Result<StatusCode, DeliveryFailure> {
        let exchanged = timeout(ANSWERED_WITHIN, self.exchange(request)).await;
        let response = exchanged.map_err(|_| DeliveryFailure::Late { receiver: self.receiver.clone() })??;
        let status = response.status();
        let headers = response.headers();
        if status.is_success() {
            return Ok(status);
        }
        let retry_after = retry_after(headers, SystemTime::now());
        Err(DeliveryFailure::Refused { receiver: self.receiver.clone(), status, retry_after })
    }

    async fn exchange(
        &self,
        request: Request<Full<Bytes>>,
    ) -> Result<http::Response<hyper::body::Incoming>, DeliveryFailure> {
        let receiver = &self.receiver;
        let (host, port) = receiver.address();
        let stream = connect_to_host(host, port, CONNECTED_WITHIN).await;
        let stream = stream.map_err(|cause| DeliveryFailure::Unreachable { receiver: receiver.clone(), cause })?;
        let exchanged = match &receiver.tls_name {
            Some(name) => {
                let stream = TlsConnector::from(self.tls.clone()).connect(name.clone(), stream).await;
                let stream = stream.map_err(|cause| DeliveryFailure::Tls { receiver: receiver.clone(), cause })?;
                over(TokioIo::new(stream), request).await
            }
            None => over(TokioIo::new(stream), request).await,
        };
        exchanged.map_err(|cause| DeliveryFailure::Response { receiver: receiver.clone(), cause })
    }
}

/// Sends a request over a connection, and returns the response without its body.
async fn over<T: Read + Write + Unpin>(
    stream: T,
    request: Request<Full<Bytes>>,
) -> hyper::Result<http::Response<hyper::body::Incoming>> {
    let (mut sender, connection) = http1::Builder::new().max_buf_size(MAX_HEADER_BYTES).handshake(stream).await?;
    match select(pin!(sender.send_request(request)), pin!(connection)).await {
        Either::Left((response, _)) => response,
        // The connection has ended, with or without a response.
        Either::Right((_, response)) => response.await,
    }
}

/// Returns the pause that a receiver asks for: a number of seconds, or a date (RFC 9110, 10.2.3).
fn retry_after(headers: &HeaderMap, now: SystemTime) -> Option<Duration> {
    let value: &HeaderValue = headers.get(RETRY_AFTER)?;
    if let Ok(seconds) = value.to_str().ok()?.trim().parse() {
        return Some(Duration::from_secs(seconds));
    }
    let date = Date::decode(&mut std::iter::once(value)).ok()?;
    SystemTime::from(date).duration_since(now).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn retry_after_is_seconds_or_a_date() {
        let now = SystemTime::UNIX_EPOCH + Duration::from_secs(784_111_717);
        let given = |value| {
            let headers = HeaderMap::from_iter([(RETRY_AFTER, HeaderValue::from_static(value))]);
            retry_after(&headers, now).map(|pause| pause.as_secs())
        };
        assert_eq!(given("120"), Some(120));
        assert_eq!(given("Sun, 06 Nov 1994 08:49:37 GMT"), Some(60));
        for none in ["Sun, 06 Nov 1994 08:00:00 GMT", "-1", "soon", ""] {
            assert_eq!(given(none), None, "{none}");
        }
    }
}
