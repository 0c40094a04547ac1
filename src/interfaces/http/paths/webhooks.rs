//! Paths of the webhooks.

use super::parameters::WebhookPath;
use super::paths;
use super::responses::{AnyProblem, WebhookProblem};
use crate::operations::webhooks::{self, WebhookList, WebhookTest};

paths! {
    /// List the webhooks
    ///
    /// Returns each webhook's position in the journal, and its newest success and failure.
    #[utoipa::path(
        get, path = "/webhooks", operation_id = "webhooks", tag = "webhooks",
        responses((status = 200, description = "All webhooks of this gateway", body = WebhookList), AnyProblem)
    )]
    list => webhooks::LIST;
    /// Test a webhook
    ///
    /// Sends the webhook's receiver a signed delivery of the kind `test`, and waits up to 15 s for the response. If the
    /// test succeeds, a delivery that waits for its next attempt is repeated at once.
    #[utoipa::path(
        post, path = "/webhooks/{webhook}/test", operation_id = "test_webhook", tag = "webhooks",
        params(WebhookPath),
        responses((status = 200, description = "The test has ended; `delivered` is its result", body = WebhookTest), WebhookProblem)
    )]
    test => webhooks::TEST;
}
