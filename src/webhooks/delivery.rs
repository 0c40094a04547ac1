//! A delivery, signed as Standard Webhooks 1.0.0 specifies (<https://www.standardwebhooks.com>).

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use bytes::Bytes;
use http::header::{CONNECTION, CONTENT_TYPE, HOST, USER_AGENT};
use http::{Method, Request};
use http_body_util::Full;
use jiff::Timestamp;
use ring::hmac;
use sha2::{Digest as _, Sha256};

use super::webhook_settings::{Receiver, SigningSecret};
use crate::model::Name;

/// Number of bytes of the body's hash in an id. The hash keeps ids unique after a new journal starts its numbers again.
const ID_HASH_BYTES: usize = 8;

/// A message for a receiver. Its id stays the same when the message is repeated.
#[derive(Debug, Clone)]
pub(super) struct Delivery {
    id: String,
    body: Bytes,
}

impl Delivery {
    /// Makes the delivery of an event, or of a notice about the events up to `seq`.
    pub(super) fn new(gateway: &Name, seq: i64, body: &str) -> Self {
        let hash = hex::encode(&Sha256::digest(body)[..ID_HASH_BYTES]);
        Self { id: format!("{gateway}-{seq}-{hash}"), body: Bytes::copy_from_slice(body.as_bytes()) }
    }

    /// Makes the request of an attempt at `now`.
    pub(super) fn request(
        &self,
        receiver: &Receiver,
        secret: &SigningSecret,
        now: Timestamp,
    ) -> http::Result<Request<Full<Bytes>>> {
        let timestamp = now.as_second();
        Request::builder()
            .method(Method::POST)
            .uri(receiver.target())
            .header(HOST, receiver.authority())
            .header(USER_AGENT, concat!("wsg-gateway/", env!("CARGO_PKG_VERSION")))
            .header(CONTENT_TYPE, "application/json")
            .header(CONNECTION, "close")
            .header("webhook-id", &self.id)
            .header("webhook-timestamp", timestamp)
            .header("webhook-signature", self.signature(secret, timestamp))
            .body(Full::new(self.body.clone()))
    }

    fn signature(&self, secret: &SigningSecret, timestamp: i64) -> String {
        let mut context = hmac::Context::with_key(&hmac::Key::new(hmac::HMAC_SHA256, secret.bytes()));
        context.update(format!("{}.{timestamp}.", self.id).as_bytes());
        context.update(&self.body);
        format!("v1,{}", STANDARD.encode(context.sign()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signature_is_that_of_the_specification() {
        // Example from the reference implementations.
        let secret = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw".parse().unwrap();
        let body = Bytes::from_static(br#"{"test": 2432232314}"#);
        let delivery = Delivery { id: "msg_p5jXN8AQM9LWM0D4loKWxJek".to_owned(), body };
        assert_eq!(delivery.signature(&secret, 1_614_265_330), "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }

    #[test]
    fn id_depends_on_number_and_content() {
        let gateway = "cell-7".parse().unwrap();
        let id = |seq, body| Delivery::new(&gateway, seq, body).id;
        assert_eq!(id(7, "{}"), "cell-7-7-44136fa355b3678a");
        assert_eq!(id(7, "{}"), id(7, "{}"));
        assert_ne!(id(7, "{}"), id(7, "{ }"));
    }
}
