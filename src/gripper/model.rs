//! What clients say to a gripper, and what they are told of it: the vocabulary that all doors share.
//!
//! The types that are told derive their JSON here, once, so that every door sends the same bodies.

use std::fmt;
use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::error::Rejection;
use crate::wsg::{CustomCommand, Force, HomingDirection, MoveFlags, Speed, Status, Width};

mod client;
mod custom;
mod event;
mod frame;
mod ids;
pub mod lease;
mod names;
mod parameters;
mod record;
mod state;
mod text;
mod urgency;

pub use client::{Client, Door};
pub use custom::CustomIds;
pub use event::{
    AcknowledgeEvent, Admitted, CommandEvent, Detail, DeviceEvent, Done, Event, FastStopEvent, FastStopStep,
    GatewayEvent, LinkEvent, RefusedEvent, SettingChange, SettingsEvent,
};
pub use frame::{Frame, FrameDirection};
pub use ids::{CommandId, FastStopId, IdSource};
pub use lease::{
    HolderName, Lease, LeaseEvent, LeaseRules, LeaseStep, LeaseToken, LossCause, LossEffect, OnLossHolding,
    OnLossMoving, TakeLease,
};
pub use parameters::{Direction, OnBlock, Parameters};
pub use record::{GripRecord, PersistedKey, PersistedState, Sample};
pub use state::{FastStopCause, Latch, LatchFields, Link, State, Telemetry};
pub use text::{InvalidShownName, PartId, Reason, RequestId, ShownName, Text};
pub use urgency::Urgency;

/// A gripper's or a gateway's name: `[a-z0-9][a-z0-9_-]{0,31}`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct Name(Arc<str>);

impl TryFrom<String> for Name {
    type Error = InvalidName;

    fn try_from(text: String) -> Result<Self, InvalidName> {
        text.parse()
    }
}

/// A text that is no [`Name`].
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no name: 1 to 32 of a-z, 0-9, _ and -, beginning with a letter or a digit")]
pub struct InvalidName(pub String);

impl std::str::FromStr for Name {
    type Err = InvalidName;

    fn from_str(text: &str) -> Result<Self, InvalidName> {
        let allowed = |byte: &u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-');
        let first = text.bytes().next().is_some_and(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit());
        if first && text.len() <= 32 && text.as_bytes().iter().all(allowed) {
            Ok(Self(text.into()))
        } else {
            Err(InvalidName(text.to_owned()))
        }
    }
}

impl Name {
    /// As it is written.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A command that moves the fingers.
#[derive(Debug, Clone, PartialEq)]
pub enum Motion {
    /// Homing (20h).
    Home(HomingDirection),
    /// Pre-position Fingers (21h).
    Move {
        /// Relative or absolute; stop or clamp on block.
        flags: MoveFlags,
        /// The target, or the offset to the current width.
        width: Width,
        /// The speed.
        speed: Speed,
    },
    /// Grip Part (25h), after Set Force Limit (32h) where a force is given.
    Grip {
        /// The part's nominal width.
        width: Width,
        /// The speed.
        speed: Speed,
        /// The force limit to set first; it stays set.
        force: Option<Force>,
        /// The part's name, for the records.
        part_id: Option<PartId>,
    },
    /// Release Part (26h).
    Release {
        /// The width to open to.
        width: Width,
        /// The speed.
        speed: Speed,
    },
    /// A script on the device, which may move them.
    Custom(CustomCommand),
}

impl Motion {
    /// The request that moves the fingers.
    #[must_use]
    pub fn request(&self) -> crate::wsg::Command {
        use crate::wsg::Command;
        match *self {
            Self::Home(direction) => Command::Homing(direction),
            Self::Move { flags, width, speed } => Command::PrePosition { flags, width, speed },
            Self::Grip { width, speed, .. } => Command::Grip { width, speed },
            Self::Release { width, speed } => Command::Release { width, speed },
            Self::Custom(ref custom) => Command::Custom(custom.clone()),
        }
    }

    /// Its kind, as commands are told.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Home(_) => Kind::Home,
            Self::Move { .. } => Kind::Move,
            Self::Grip { .. } => Kind::Grip,
            Self::Release { .. } => Kind::Release,
            Self::Custom(_) => Kind::Custom,
        }
    }
}

/// What a command does.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    /// It moves the fingers.
    Motion(Motion),
    /// Stop (22h): needs no lease, and ends a running motion.
    Stop,
}

impl Action {
    /// What a request of the protocol does, where it moves the fingers or stops them in order.
    #[must_use]
    pub fn of(request: &crate::wsg::Command) -> Option<Self> {
        use crate::wsg::Command as C;
        Some(Self::Motion(match *request {
            C::Homing(direction) => Motion::Home(direction),
            C::PrePosition { flags, width, speed } => Motion::Move { flags, width, speed },
            C::Grip { width, speed } => Motion::Grip { width, speed, force: None, part_id: None },
            C::Release { width, speed } => Motion::Release { width, speed },
            C::Stop => return Some(Self::Stop),
            _ => return None,
        }))
    }

    /// Its kind, as commands are told.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Motion(motion) => motion.kind(),
            Self::Stop => Kind::Stop,
        }
    }
}

/// A client's request for a command.
#[derive(Debug, Clone)]
pub struct Submission {
    /// Who asks.
    pub client: Client,
    /// For what.
    pub action: Action,
    /// Makes the request safe to repeat.
    pub request_id: Option<RequestId>,
    /// The lease token that came with it.
    pub lease: Option<LeaseToken>,
}

/// The kind of a command.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    Hash,
    Serialize,
    Deserialize,
    ToSchema,
    strum::Display,
    strum::IntoStaticStr,
    strum::VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum Kind {
    /// Homing (20h).
    Home,
    /// Pre-position Fingers (21h).
    Move,
    /// Grip Part (25h).
    Grip,
    /// Release Part (26h).
    Release,
    /// Stop (22h).
    Stop,
    /// A script on the device.
    Custom,
}

/// Whether a command has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// Admitted, and not ended.
    Running,
    /// Ended, with an outcome.
    Done,
}

/// How a command ended.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, strum::IntoStaticStr, strum::VariantArray,
)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
#[strum(serialize_all = "SCREAMING_SNAKE_CASE")]
pub enum Outcome {
    /// Done as asked.
    Success,
    /// A grip that holds its part.
    PartHeld,
    /// A grip that found no part: an answer, not an error.
    NoPart,
    /// The axis was blocked.
    Blocked,
    /// Ended by a Stop, a FAST STOP or a cancel.
    Aborted,
    /// A soft or hard limit was reached during the motion.
    Range,
    /// The device gave up waiting for its own motion.
    Timeout,
    /// The device ended it with another status code.
    Failed,
    /// Refused by the device, after its client had been told 202.
    Refused,
    /// It may have happened, or not: the answer never came.
    Unknown,
}

/// One command, as clients are told of it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({
    "id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "gripper": "left", "kind": "grip", "phase": "done",
    "outcome": "PART_HELD", "status": "E_SUCCESS", "status_code": 0, "reached_goal": true, "stalled": true,
    "width_mm": 20.0, "force_n": 40.0, "started_at": "2026-11-21T09:00:00Z", "duration_ms": 412,
    "client": "http:127.0.0.1", "replayed": false
}))]
pub struct Command {
    /// A UUID of version 7.
    #[schema(value_type = Uuid)]
    pub id: CommandId,
    /// The gripper's name.
    #[schema(value_type = String, max_length = 32)]
    pub gripper: Name,
    /// What was asked for.
    pub kind: Kind,
    /// Whether it has ended.
    pub phase: Phase,
    /// How it ended; null while it runs.
    #[schema(required)]
    pub outcome: Option<Outcome>,
    /// The device's last status, by its symbol; null where the device gave none.
    #[schema(required)]
    pub status: Option<String>,
    /// The same, by its number.
    #[schema(required, minimum = 0, maximum = 65535)]
    pub status_code: Option<u16>,
    /// Whether the goal was reached: the target, or a part held. Null while that isn't known.
    #[schema(required)]
    pub reached_goal: Option<bool>,
    /// Whether the fingers were stopped by a contact. Null while that isn't known.
    #[schema(required)]
    pub stalled: Option<bool>,
    /// The opening width at the end, in mm; null while running, or where it isn't known.
    #[schema(required, minimum = -1000, maximum = 1000)]
    pub width_mm: Option<f32>,
    /// The gripping force at the end, in N; null while running, or where it isn't known.
    #[schema(required, minimum = -10000, maximum = 10000)]
    pub force_n: Option<f32>,
    /// When it was admitted.
    #[schema(value_type = String, format = DateTime)]
    pub started_at: Timestamp,
    /// From its admission to its end; null while running.
    #[schema(required, minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub duration_ms: Option<u64>,
    /// Who asked.
    #[schema(value_type = String)]
    pub client: Arc<str>,
    /// Whether this answers a request that was made before.
    pub replayed: bool,
    /// The FAST STOP that aborted it; only then.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Uuid>, nullable = false)]
    pub fast_stop_id: Option<FastStopId>,
    /// What a custom command's script answered, as hex; only then, and until the gateway ends.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, nullable = false, max_length = 8192)]
    pub payload: Option<Arc<str>>,
    /// Why it was refused: told as a problem to whoever waits for it.
    #[serde(skip)]
    pub rejection: Option<Rejection>,
    /// Who had it stopped, where that was not by a Stop or a FAST STOP: for the journal.
    #[serde(skip)]
    pub cancelled_by: Option<Arc<str>>,
    /// Whether clients may be told of it, since it is written down.
    #[serde(skip)]
    pub recorded: bool,
    /// Whether the device has accepted it with E_CMD_PENDING.
    #[serde(skip)]
    pub accepted: bool,
}

impl Command {
    /// A command that was just admitted.
    #[must_use]
    pub fn admitted(id: CommandId, gripper: Name, submission: &Submission, at: Timestamp) -> Self {
        Self {
            id,
            gripper,
            kind: submission.action.kind(),
            phase: Phase::Running,
            outcome: None,
            status: None,
            status_code: None,
            reached_goal: None,
            stalled: None,
            width_mm: None,
            force_n: None,
            started_at: at,
            duration_ms: None,
            client: submission.client.subject.clone(),
            replayed: false,
            fast_stop_id: None,
            payload: None,
            rejection: None,
            cancelled_by: None,
            recorded: false,
            accepted: false,
        }
    }

    /// Takes the device's status into the record.
    pub fn set_status(&mut self, status: Status) {
        self.status = Some(status.to_string());
        self.status_code = Some(status.code());
    }
}
