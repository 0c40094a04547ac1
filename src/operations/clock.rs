//! The gateway's clock, so that a client can relate the times of measurement to its own clock.

use serde::Serialize;
use utoipa::ToSchema;

use super::calls::call::{Call, NoFields};
use super::calls::operation::operations;
use super::calls::reply::Json;
use super::problem::Problem;
use crate::gripper::Now;

operations! {
    /// Get the gateway's clock
    ///
    /// Returns the times at which the gateway received the request and answered it. A client that notes its own times
    /// of sending and receiving can estimate its offset to the gateway, as with NTP.
    CLOCK = GET "/clock" as "clock" {
        run: clock, id: "clock", tag: "gateway", problems: ANY,
        answer: "The gateway's times",
    };
}

/// Times of the gateway's clock, for an estimate of the client's offset to it (RFC 5905 section 8).
#[derive(Debug, Serialize, ToSchema)]
#[schema(example = json!({
    "received_at": "2026-11-29T10:30:00.123456Z", "sent_at": "2026-11-29T10:30:00.123461Z"
}))]
pub struct GatewayClock {
    /// Time at which the gateway received the request, in UTC with microseconds.
    #[schema(format = DateTime)]
    received_at: String,
    /// Time at which the gateway answered, in UTC with microseconds.
    #[schema(format = DateTime)]
    sent_at: String,
}

fn clock(call: &Call<NoFields>) -> Result<Json<GatewayClock>, Problem> {
    let received_at = Now::read().exact;
    let NoFields {} = call.fields()?;
    let sent_at = Now::read().exact;
    Ok(Json(GatewayClock { received_at: format!("{received_at:.6}"), sent_at: format!("{sent_at:.6}") }))
}
