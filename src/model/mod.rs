//! Requests to a gripper and the data returned to clients: the vocabulary shared by all interfaces.
//!
//! Response types derive their JSON here, once, so that every interface sends the same bodies.

use std::fmt;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use wsg::{CustomCommand, Force, HomingDirection, MoveFlags, Speed, Width};

mod alarm;
mod client;
pub mod clock;
mod code;
mod custom;
pub mod error;
mod event;
mod fault;
mod frame;
mod ids;
pub mod lease;
mod measured;
mod names;
mod parameters;
mod recipe;
mod record;
mod report;
mod rules;
mod servo;
mod state;
mod status;
mod text;
pub mod time;
mod updates;
mod urgency;
mod values;

pub use alarm::{Alarm, AlarmCause, AlarmEvent, AlarmKind, AlarmPriority, AlarmStep};
pub use client::{Client, ClientLabel, Door, HolderName};
pub use clock::Now;
pub use code::Code;
pub use custom::CustomIds;
pub use event::{
    AcknowledgeEvent, Admitted, CommandEvent, Detail, DeviceEvent, Done, Event, FastStopEvent, FastStopStep,
    FingerSetChange, GatewayEvent, KeptShare, LinkEvent, RefusedEvent, SettingChange, SettingsEvent,
};
pub use fault::{FastStopCause, Fault};
pub use frame::{DamageRecord, FrameDirection, FrameRecord, WireDamage, WireRecord};
pub use ids::{AlarmId, CommandId, FastStopId, IdSource};
pub use lease::{
    Lease, LeaseEvent, LeaseRules, LeaseStep, LeaseToken, LossCause, LossEffect, OnLossHolding, OnLossMoving, TakeLease,
};
pub use measured::{Measured, Missing};
pub use parameters::{Direction, OnBlock, Parameters};
pub use recipe::{
    AcceptedWidths, AppliedRecipe, Recipe, RecipeDescription, RecipeEvent, RecipeFields, RecipeNumber, RecipeStep,
    RecipeValues,
};
pub use record::{GripRecord, OnJournalFailure, PersistedKey, PersistedState, RequestedValues, Sample};
pub use report::CommandReport;
pub use rules::{GripperRules, SharedRules};
pub use servo::{
    ScriptTarget, ServoAdapter, ServoAim, ServoEnd, ServoReport, ServoRules, ServoTarget, ServoTerms, Steer,
};
pub use state::{Latch, LatchFields, Link, State, Telemetry};
pub use status::GripperStatus;
pub use text::{FingerSetId, InvalidShownName, PartId, Reason, RequestId, ShownName, Text, without_byte_order_mark};
pub use updates::{UpdateMode, UpdateRules};
pub use urgency::Urgency;
pub use values::{LinkClock, MeasuredFields, Values};

/// A gripper's or a gateway's name: `[a-z0-9][a-z0-9_-]{0,31}`.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
#[serde(try_from = "String")]
#[schema(as = NameField, value_type = String, max_length = 32)]
pub struct Name(Arc<str>);

impl TryFrom<String> for Name {
    type Error = InvalidName;

    fn try_from(text: String) -> Result<Self, InvalidName> {
        text.parse()
    }
}

/// A text that is not a valid [`Name`], cut to more characters than a name can have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a valid name: use 1 to 32 characters of a-z, 0-9, _ and -, starting with a letter or digit")]
pub struct InvalidName(pub String);

impl std::str::FromStr for Name {
    type Err = InvalidName;

    fn from_str(text: &str) -> Result<Self, InvalidName> {
        let first = text.bytes().next().is_some_and(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit());
        if first && text.len() <= 32 && text.bytes().all(is_name_byte) {
            Ok(Self(text.into()))
        } else {
            Err(InvalidName(text.chars().take(40).collect()))
        }
    }
}

fn is_name_byte(byte: u8) -> bool {
    matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-')
}

impl Name {
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
        flags: MoveFlags,
        /// Target width, or the offset from the current width if `flags` says relative.
        width: Width,
        speed: Speed,
    },
    /// Grip Part (25h), after Set Force Limit (32h) if a force is given.
    Grip {
        /// Nominal width of the part.
        width: Width,
        speed: Speed,
        /// Force limit to set first; it stays set.
        force: Option<Force>,
        part_id: Option<PartId>,
        recipe: Option<AppliedRecipe>,
        /// Whether the part is a gauge.
        is_reference: bool,
    },
    /// Release Part (26h).
    Release {
        /// Width to open to.
        width: Width,
        speed: Speed,
    },
    /// A script on the device, which may move the fingers.
    Custom(CustomCommand),
}

impl Motion {
    /// The request that moves the fingers.
    #[must_use]
    pub fn request(&self) -> wsg::Command {
        use wsg::Command;
        match *self {
            Self::Home(direction) => Command::Homing(direction),
            Self::Move { flags, width, speed } => Command::PrePosition { flags, width, speed },
            Self::Grip { width, speed, .. } => Command::Grip { width, speed },
            Self::Release { width, speed } => Command::Release { width, speed },
            Self::Custom(ref custom) => Command::Custom(custom.clone()),
        }
    }

    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Home(_) => Kind::Home,
            Self::Move { .. } => Kind::Move,
            Self::Grip { is_reference: true, .. } => Kind::Reference,
            Self::Grip { .. } => Kind::Grip,
            Self::Release { .. } => Kind::Release,
            Self::Custom(_) => Kind::Custom,
        }
    }
}

/// A motion or a Stop.
#[derive(Debug, Clone, PartialEq)]
pub enum Action {
    Motion(Motion),
    /// Stop (22h): needs no lease, and ends a running motion.
    Stop,
}

impl Action {
    /// The action of a WSG protocol request, or `None` if it neither moves the fingers nor is a Stop.
    #[must_use]
    pub fn of(request: &wsg::Command) -> Option<Self> {
        use wsg::Command as C;
        Some(Self::Motion(match *request {
            C::Homing(direction) => Motion::Home(direction),
            C::PrePosition { flags, width, speed } => Motion::Move { flags, width, speed },
            C::Grip { width, speed } => {
                Motion::Grip { width, speed, force: None, part_id: None, recipe: None, is_reference: false }
            }
            C::Release { width, speed } => Motion::Release { width, speed },
            C::Stop => return Some(Self::Stop),
            _ => return None,
        }))
    }

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
    pub client: Client,
    pub action: Action,
    /// Makes the request safe to repeat.
    pub request_id: Option<RequestId>,
    pub lease: Option<LeaseToken>,
}

/// Kind of a command.
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
    VariantArray,
    EnumMessage,
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
    /// A custom command, run by a script on the device.
    Custom,
    /// Reference grip: Grip Part (25h) on a gauge, to detect wear of the fingers.
    Reference,
}

impl Kind {
    /// Whether the device gets Grip Part (25h).
    #[must_use]
    pub const fn is_grip(self) -> bool {
        matches!(self, Self::Grip | Self::Reference)
    }
}

/// Whether a command has ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// Admitted, and not ended yet.
    Running,
    /// Ended, with an outcome.
    Done,
}

/// Result of a command.
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
    strum::IntoStaticStr,
    VariantArray,
    EnumMessage,
)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
#[strum(serialize_all = "SCREAMING_SNAKE_CASE")]
pub enum Outcome {
    /// Done as requested.
    Success,
    /// The grip holds a part.
    PartHeld,
    /// The grip found no part; a result, not an error.
    NoPart,
    /// The axis was blocked.
    Blocked,
    /// Ended by a Stop, a FAST STOP or a cancel, or withdrawn before it started.
    Aborted,
    /// A soft or hard limit was reached during the motion.
    Range,
    /// The device reported a time-out of its own motion (E_TIMEOUT).
    Timeout,
    /// The device ended the command with another status code.
    Failed,
    /// Rejected before the device accepted the command, after the client had already received 202.
    Refused,
    /// The result never arrived; the motion may or may not have happened.
    Unknown,
    /// The grip holds a part whose contact width is outside the limits of the recipe.
    WrongPart,
}

impl Outcome {
    /// Number of the outcome, `outcome_code` in a command. Numbers never change, and 0 stands for no outcome yet.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Success => 1,
            Self::PartHeld => 2,
            Self::NoPart => 3,
            Self::Blocked => 4,
            Self::Aborted => 5,
            Self::Range => 6,
            Self::Timeout => 7,
            Self::Failed => 8,
            Self::Refused => 9,
            Self::Unknown => 10,
            Self::WrongPart => 11,
        }
    }

    /// Whether the command reached its goal.
    #[must_use]
    pub const fn is_ok(self) -> bool {
        matches!(self, Self::Success | Self::PartHeld)
    }

    /// Whether the command ended with a part between the fingers, the right one or not.
    #[must_use]
    pub const fn holds_part(self) -> bool {
        matches!(self, Self::PartHeld | Self::WrongPart)
    }
}
