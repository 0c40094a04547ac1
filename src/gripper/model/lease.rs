//! The lease: the right to move a gripper, and what clients say and are told of it.

use std::fmt;
use std::sync::Arc;
use std::time::Duration;

use rand::RngExt;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Client, ShownName};

/// How long a lease lives without use if its taker doesn't say.
pub const DEFAULT_TTL: Duration = Duration::from_secs(3);

/// The shortest time to live.
pub const MIN_TTL: Duration = Duration::from_millis(100);

/// The longest time to live.
pub const MAX_TTL: Duration = Duration::from_mins(1);

/// The name that a lease's holder gives itself.
pub type HolderName = ShownName<32>;

/// What proves that a request is the holder's: 128 random bits as hex, or whatever a client says in its place.
#[derive(Clone, PartialEq, Eq, Serialize)]
pub struct LeaseToken(Arc<str>);

impl LeaseToken {
    /// A new one, which can't be guessed.
    #[must_use]
    pub fn generate() -> Self {
        Self(format!("{:032x}", rand::rng().random::<u128>()).into())
    }

    /// As it is written.
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

/// Logs have no use for it.
impl fmt::Debug for LeaseToken {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("LeaseToken(…)")
    }
}

/// What becomes of fingers that move when the lease's holder is lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnLossMoving {
    /// A FAST STOP, latched.
    FastStop,
    /// A Stop.
    Stop,
    /// They may finish.
    Finish,
}

/// What becomes of a part that is held when the lease's holder is lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnLossHolding {
    /// It goes on being held, and the gripper stays reserved for the holder: a blind stop may drop the part.
    Keep,
    /// A FAST STOP, latched.
    FastStop,
}

/// What may be asked for of a lease.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LeaseRules {
    /// What a lost holder may have chosen for fingers that move; the first counts where it chose nothing.
    pub on_loss_moving: Vec<OnLossMoving>,
    /// And for a part that is held.
    pub on_loss_holding: Vec<OnLossHolding>,
    /// The longest time to live.
    pub max_ttl: Duration,
}

impl Default for LeaseRules {
    fn default() -> Self {
        Self {
            on_loss_moving: vec![OnLossMoving::FastStop, OnLossMoving::Stop, OnLossMoving::Finish],
            on_loss_holding: vec![OnLossHolding::Keep, OnLossHolding::FastStop],
            max_ttl: MAX_TTL,
        }
    }
}

/// A client's wish to hold the lease.
#[derive(Debug, Clone)]
pub struct TakeLease {
    /// Who asks.
    pub client: Client,
    /// By which name; its subject, where it gives none.
    pub holder: Option<HolderName>,
    /// How long the lease lives without use.
    pub ttl: Option<Duration>,
    /// What becomes of fingers that move when the holder is lost.
    pub on_loss_moving: Option<OnLossMoving>,
    /// What becomes of a part that is held then.
    pub on_loss_holding: Option<OnLossHolding>,
    /// Take it from whoever holds it, as a supervisor does. A running motion is stopped.
    pub force: bool,
    /// Where somebody else holds it, tell that holder who asks.
    pub request: bool,
    /// The token of the lease that is held already, whose terms are to change.
    pub token: Option<LeaseToken>,
}

impl TakeLease {
    /// Of a client that asks for nothing but the lease.
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

/// The lease of a gripper, as clients are told.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({
    "held": true, "holder": "robot-1", "epoch": 7, "token": "5f0c8ac1e2b84d6c9a0f4be2c1d3a795", "ttl_ms": 3000,
    "expires_in_ms": 3000, "on_loss_moving": "fast_stop", "on_loss_holding": "keep", "requested_by": null,
    "reserved_for": null
}))]
pub struct Lease {
    /// Whether somebody holds it.
    pub held: bool,
    /// Who holds it.
    #[schema(value_type = Option<String>, required)]
    pub holder: Option<Arc<str>>,
    /// Counts the leases of this gripper, across restarts of the gateway.
    #[schema(minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub epoch: u64,
    /// What its requests have to bring; told to its taker alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, nullable = false)]
    pub token: Option<LeaseToken>,
    /// How long it lives without use.
    #[schema(required, minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub ttl_ms: Option<u64>,
    /// How much of that is left: all of it while a request of the holder is open.
    #[schema(required, minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub expires_in_ms: Option<u64>,
    /// What becomes of fingers that move when the holder is lost.
    #[schema(required)]
    pub on_loss_moving: Option<OnLossMoving>,
    /// What becomes of a part that is held then.
    #[schema(required)]
    pub on_loss_holding: Option<OnLossHolding>,
    /// Who asks for it to be handed over.
    #[schema(value_type = Option<String>, required)]
    pub requested_by: Option<Arc<str>>,
    /// Who alone may take it, beside a supervisor: its holder was lost while a part was held, which is still held.
    #[schema(value_type = Option<String>, required)]
    pub reserved_for: Option<Arc<str>>,
}

/// A lease's change.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LeaseEvent {
    /// What happened.
    pub event: LeaseStep,
    /// Who held it, or holds it now.
    #[schema(value_type = String)]
    pub holder: Arc<str>,
    /// Which lease it is.
    pub epoch: u64,
    /// What became of the gripper; only of a holder that was lost.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub effect: Option<LossEffect>,
    /// Why its holder was lost; only then.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub cause: Option<LossCause>,
}

/// What happened to a lease.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LeaseStep {
    /// It was free, and taken.
    Taken,
    /// It was taken from its holder by force.
    Forced,
    /// Somebody asks for it.
    Requested,
    /// Its holder gave it to who had asked.
    HandedOver,
    /// Its holder gave it back.
    Released,
    /// Its holder was lost.
    Lost,
}

/// Why a holder counts as lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LossCause {
    /// The lease has run out without use.
    Expired,
    /// The connection that it was bound to has ended without a release.
    Disconnected,
}

/// What became of the gripper when its holder was lost.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LossEffect {
    /// A FAST STOP.
    FastStop,
    /// A Stop.
    Stop,
    /// The motion goes on.
    Finish,
    /// The part goes on being held, and the gripper is reserved.
    Keep,
    /// Nothing moved, and nothing was held.
    None,
}
