//! The terms of a lease: what its holder asks for, within what the gripper's configuration allows.

use std::time::Duration;

use serde::Serialize;

use model::error::Invalid;
use model::lease::{DEFAULT_TTL, MIN_TTL};
use model::{LeaseRules, OnLossHolding, OnLossMoving, TakeLease};

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Terms {
    pub ttl: Duration,
    pub on_loss_moving: OnLossMoving,
    pub on_loss_holding: OnLossHolding,
}

impl Terms {
    /// The terms that the client requested, completed with the configured defaults.
    pub(super) fn of(wish: &TakeLease, rules: &LeaseRules) -> Result<Self, Invalid> {
        let ttl = wish.ttl.unwrap_or(DEFAULT_TTL.min(rules.max_ttl));
        if ttl < MIN_TTL || ttl > rules.max_ttl {
            return Err(Invalid::OutOfRange {
                field: "ttl_ms",
                value: ttl.as_millis() as f32,
                min: MIN_TTL.as_millis() as f32,
                max: rules.max_ttl.as_millis() as f32,
                limit: "the gripper's configuration",
            });
        }
        Ok(Self {
            ttl,
            on_loss_moving: chosen("on_loss_moving", wish.on_loss_moving, &rules.on_loss_moving)?,
            on_loss_holding: chosen("on_loss_holding", wish.on_loss_holding, &rules.on_loss_holding)?,
        })
    }
}

fn chosen<T: Copy + PartialEq + Serialize>(field: &'static str, given: Option<T>, allowed: &[T]) -> Result<T, Invalid> {
    match (given, allowed.first()) {
        (Some(given), _) if allowed.contains(&given) => Ok(given),
        (None, Some(first)) => Ok(*first),
        _ => {
            let words: Vec<_> = allowed.iter().map(|word| serde_json::json!(word).to_string()).collect();
            let detail = format!("this gripper's configuration allows only {}", words.join(" or "));
            Err(Invalid::Malformed { field, detail })
        }
    }
}
