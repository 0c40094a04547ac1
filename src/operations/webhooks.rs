//! The webhooks' positions in the journal, and test deliveries.

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::calls::call::{Call, NoFields};
use super::calls::operation::operations;
use super::calls::reply::Json;
use super::problem::Problem;
use crate::access::Right;
use crate::journal::EventKind;
use crate::model::Code;
use crate::webhooks::{DeliveryFailure, Tested, Webhook, WebhookProgress};

operations! {
    /// List the webhooks
    ///
    /// Returns each webhook's position in the journal, and its newest success and failure.
    LIST = GET "/webhooks" as "webhooks" {
        run: list, id: "webhooks", tag: "webhooks", problems: ANY,
        answer: "All webhooks of this gateway",
    };

    /// Test a webhook
    ///
    /// Sends the webhook's receiver a signed delivery of the kind `test`, and waits up to 15 s for the response. If the
    /// test succeeds, a delivery that waits for its next attempt is repeated at once.
    TEST = POST "/webhooks/{webhook}/test" as "webhooks.test" {
        run: test, id: "test_webhook", tag: "webhooks", problems: WEBHOOK,
        answer: "The test has ended; `delivered` is its result",
    }.needs(Right::Supervise);
}

/// All webhooks.
#[derive(Debug, Serialize, ToSchema)]
pub struct WebhookList {
    /// The webhooks, in the order of the configuration.
    webhooks: Vec<WebhookReport>,
}

/// A webhook and its position in the journal.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Webhook, example = json!({
    "name": "mes", "origin": "https://mes.example", "kinds": ["command", "fast_stop"], "position": 4711, "waiting": 2,
    "last_success_at": "2026-11-21T09:00:00.250Z", "last_error_at": "2026-11-21T09:05:00.500Z",
    "last_error": "https://mes.example answered 503 Service Unavailable: only 2xx counts as delivered, so see the \
                   receiver's log",
    "failed_attempts": 3, "retry_at": "2026-11-21T09:05:04.000Z"
}))]
pub struct WebhookReport {
    /// The webhook's name.
    #[schema(max_length = 32)]
    name: String,
    /// Scheme, host and port of the receiver. The rest of the URL is not shown, because it can be secret.
    origin: String,
    /// Kinds of events that are delivered; null means all.
    #[schema(required)]
    kinds: Option<Vec<EventKind>>,
    /// `seq` of the newest event that was delivered, or skipped because of its kind.
    #[schema(minimum = 0)]
    position: i64,
    /// Number of events after the position, of any kind.
    #[schema(minimum = 0)]
    waiting: i64,
    /// Time of the newest delivery since the gateway started; null before the first.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    last_success_at: Option<String>,
    /// Time of the newest failed attempt since the gateway started; null before the first.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    last_error_at: Option<String>,
    /// Cause of the newest failure, with the remedy.
    #[schema(required)]
    last_error: Option<String>,
    /// Number of failed attempts since the newest delivery.
    failed_attempts: u32,
    /// Time of the next attempt after a failed one; otherwise null.
    #[schema(value_type = Option<String>, format = DateTime, required)]
    retry_at: Option<String>,
}

impl WebhookReport {
    fn of(webhook: &Webhook) -> Self {
        let WebhookProgress {
            position,
            last_success_at,
            last_error_at,
            last_error,
            failed_attempts,
            retry_at,
            failing_since: _,
        } = webhook.progress();
        Self {
            name: webhook.name().to_string(),
            origin: webhook.receiver().to_string(),
            kinds: webhook.kinds().map(<[_]>::to_vec),
            position,
            waiting: webhook.waiting(),
            last_success_at: last_success_at.map(with_milliseconds),
            last_error_at: last_error_at.map(with_milliseconds),
            last_error,
            failed_attempts,
            retry_at: retry_at.map(with_milliseconds),
        }
    }
}

fn with_milliseconds(at: Timestamp) -> String {
    format!("{at:.3}")
}

/// Result of a test delivery.
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({"webhook": "mes", "delivered": true, "status": 204, "duration_ms": 12, "error": null}))]
pub struct WebhookDelivery {
    /// The webhook's name.
    #[schema(max_length = 32)]
    webhook: String,
    /// Whether the receiver accepted the delivery.
    delivered: bool,
    /// HTTP status of the receiver's response; null without a response.
    #[schema(required, minimum = 100, maximum = 999)]
    status: Option<u16>,
    /// Duration of the attempt in ms.
    duration_ms: u64,
    /// Why the delivery failed, with the remedy; null if it was delivered.
    #[schema(required)]
    error: Option<String>,
}

fn list(call: &Call<NoFields>) -> Result<Json<WebhookList>, Problem> {
    let NoFields {} = call.fields()?;
    let webhooks = call.gateway.webhooks.all().iter().map(|webhook| WebhookReport::of(webhook)).collect();
    Ok(Json(WebhookList { webhooks }))
}

async fn test(call: Call<NoFields>) -> Result<Json<WebhookDelivery>, Problem> {
    let webhook = call.webhook()?;
    let NoFields {} = call.fields()?;
    let Tested { result, duration } = webhook.test().await.ok_or_else(|| {
        Problem::new(Code::Overloaded, "a test delivery to this webhook is in progress: wait for its end")
    })?;
    let status = result.as_ref().map_or_else(DeliveryFailure::status, |status| Some(*status));
    Ok(Json(WebhookDelivery {
        webhook: webhook.name().to_string(),
        delivered: result.is_ok(),
        status: status.map(|status| status.as_u16()),
        duration_ms: duration.as_millis() as u64,
        error: result.err().map(|failure| failure.to_string()),
    }))
}
