//! The lease, which is the right to move a gripper: requests, replies and events.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use rand::RngExt;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::{Client, HolderName};
use settings::{SettingValue, between, parsed, settings, whole};

/// Time to live of a lease without use, unless the client asks for another.
pub const DEFAULT_TTL: Duration = Duration::from_secs(3);

pub const MIN_TTL: Duration = Duration::from_millis(100);

pub const MAX_TTL: Duration = Duration::from_mins(1);

/// Proof that a request comes from the lease holder: 128 random bits as hex, or any text that a client sends instead.
#[derive(Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = LeaseTokenField, value_type = String)]
pub struct LeaseToken(Arc<str>);

impl LeaseToken {
    /// Generates a token that can't be guessed.
    #[must_use]
    pub fn generate() -> Self {
        Self(format!("{:032x}", rand::rng().random::<u128>()).into())
    }

    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl From<&str> for LeaseToken {
    fn from(given: &str) -> Self {
        Self(given.into())
    }
}

/// Keeps the token out of logs.
impl fmt::Debug for LeaseToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("LeaseToken(…)")
    }
}

/// Action if the lease holder is lost while the fingers move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "snake_case")]
pub enum OnLossMoving {
    /// A latched FAST STOP.
    FastStop,
    /// A Stop.
    Stop,
    /// The motion continues to its end.
    Finish,
}

/// Action if the lease holder is lost while a part is held and the fingers do not move.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "snake_case")]
pub enum OnLossHolding {
    /// The part stays held, and the gripper stays reserved for the holder; a blind stop could drop the part.
    Keep,
    /// A latched FAST STOP.
    FastStop,
}

settings! {
    /// Lease terms that a gripper's configuration allows.
    #[derive(Eq)]
    pub struct LeaseRules {
        /// Actions that a client can choose for the case that the lease holder is lost while the fingers move. The first
        /// value is the default.
        pub on_loss_moving: Vec<OnLossMoving> = "on_loss_moving", choices(
            vec![OnLossMoving::FastStop, OnLossMoving::Stop, OnLossMoving::Finish],
            "[\"fast_stop\", \"stop\", \"finish\"]",
        ), Reload;
        /// The same for the case that a part is held.
        pub on_loss_holding: Vec<OnLossHolding> = "on_loss_holding",
            choices(vec![OnLossHolding::Keep, OnLossHolding::FastStop], "[\"keep\", \"fast_stop\"]"), Reload;
        /// Longest `ttl_ms` that a client can request for a lease.
        pub max_ttl: Duration = "lease_max_ttl_ms", whole(60_000, between(100..=60_000, ""), Duration::from_millis), Reload;
    }
}

/// One or more actions.
fn choices<T: DeserializeOwned>(default: Vec<T>, shown: &str) -> SettingValue<Vec<T>> {
    parsed(default, shown, "one or more of these", |words: Vec<T>| match words.len() {
        0 => Err("is empty: list what clients can choose, the default first".to_owned()),
        _ => Ok(words),
    })
}

/// A client's request for the lease.
#[derive(Debug, Clone)]
pub struct TakeLease {
    pub client: Client,
    /// Name of the holder; the client's subject if absent.
    pub holder: Option<HolderName>,
    /// Time to live without use.
    pub ttl: Option<Duration>,
    pub on_loss_moving: Option<OnLossMoving>,
    pub on_loss_holding: Option<OnLossHolding>,
    /// Takes the lease from its current holder, as a supervisor does. A running motion is stopped.
    pub force: bool,
    /// Shows this request to the current holder, if there is one.
    pub request: bool,
    /// Token of the lease, if the client already holds the lease and changes its terms.
    pub token: Option<LeaseToken>,
}

impl TakeLease {
    /// A request by `client` with default terms.
    #[must_use]
    pub const fn by(client: Client) -> Self {
        Self {
            client,
            holder: None,
            ttl: None,
            on_loss_moving: None,
            on_loss_holding: None,
            force: false,
            request: false,
            token: None,
        }
    }
}

/// The lease of a gripper.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({
    "held": true, "holder": "robot-1", "epoch": 7, "token": "5f0c8ac1e2b84d6c9a0f4be2c1d3a795", "ttl_ms": 3000,
    "expires_in_ms": 3000, "on_loss_moving": "fast_stop", "on_loss_holding": "keep", "requested_by": null,
    "reserved_for": null
}))]
pub struct Lease {
    /// Whether a client holds the lease.
    pub held: bool,
    /// Name of the lease holder; null if the lease is free.
    #[schema(required)]
    pub holder: Option<Arc<str>>,
    /// Number of the newest lease of this gripper. It grows with each lease, also across restarts of the gateway.
    pub epoch: u64,
    /// Token that requests under this lease must carry. Only the client that took the lease receives it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub token: Option<LeaseToken>,
    /// Time to live without use, in ms; null if the lease is free.
    #[schema(required, minimum = 0)]
    pub ttl_ms: Option<u64>,
    /// Remaining time to live, in ms. It does not run down while a request of the holder is open, or while the lease is
    /// `bound`. Null if the lease is free.
    #[schema(required, minimum = 0)]
    pub expires_in_ms: Option<u64>,
    /// Whether a connection of the holder keeps the lease, which then has no end of its own: `expires_in_ms` starts to run
    /// down only when the connection no longer keeps it. Absent if the lease is free, and in the reply to a request for
    /// the lease, because the connection is bound after it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub bound: Option<bool>,
    /// Action if the holder is lost while the fingers move; null if the lease is free.
    #[schema(required)]
    pub on_loss_moving: Option<OnLossMoving>,
    /// Action if the holder is lost while a part is held; null if the lease is free.
    #[schema(required)]
    pub on_loss_holding: Option<OnLossHolding>,
    /// Name of the client that has requested a hand-over; null if no client has.
    #[schema(required)]
    pub requested_by: Option<Arc<str>>,
    /// Place of this client among those that have requested a hand-over, from 1; only in the reply to such a request.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false, minimum = 1, maximum = 16)]
    pub place: Option<usize>,
    /// Name of a holder that was lost while a part was held or a motion continued. Only this client or a supervisor can
    /// take the lease. Null if the gripper is not reserved.
    #[schema(required)]
    pub reserved_for: Option<Arc<str>>,
}

/// Change of a lease.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LeaseEvent {
    /// Kind of change.
    pub event: LeaseStep,
    /// Name of the client concerned: the new holder, the requesting client, or the former holder.
    pub holder: Arc<str>,
    /// Number of the newest lease at that time.
    pub epoch: u64,
    /// Action taken after the holder was lost; otherwise absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub effect: Option<LossEffect>,
    /// Cause of the holder's loss; otherwise absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub cause: Option<LossCause>,
}

/// Kind of change of a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "snake_case")]
pub enum LeaseStep {
    /// A client took the free lease.
    Taken,
    /// A supervisor took the lease from its holder.
    Forced,
    /// A client requested a hand-over.
    Requested,
    /// The holder gave the lease to the client that had requested it.
    HandedOver,
    /// The holder released the lease.
    Released,
    /// The holder was lost.
    Lost,
}

/// Reason that a lease holder counts as lost.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, strum::Display, EnumMessage, VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum LossCause {
    /// The lease ran out without use.
    Expired,
    /// The connection bound to the lease ended without a release.
    Disconnected,
    /// The holder may no longer move the gripper.
    Forbidden,
}

/// Action taken after the lease holder was lost.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, strum::Display, EnumMessage, VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum LossEffect {
    /// A latched FAST STOP.
    FastStop,
    /// A Stop.
    Stop,
    /// The motion continued, and the gripper was reserved for the holder.
    Finish,
    /// The part stayed held, and the gripper was reserved for the holder.
    Keep,
    /// No action, because nothing moved and no part was held.
    None,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loss_has_the_same_words_in_the_log_as_in_events() {
        for cause in [LossCause::Expired, LossCause::Disconnected, LossCause::Forbidden] {
            assert_eq!(serde_json::to_value(cause).unwrap(), cause.to_string());
        }
        let still = [LossEffect::Finish, LossEffect::Keep, LossEffect::None];
        for effect in [LossEffect::FastStop, LossEffect::Stop].into_iter().chain(still) {
            assert_eq!(serde_json::to_value(effect).unwrap(), effect.to_string());
        }
    }
}
