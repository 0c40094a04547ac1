//! Requests to a gripper and the data returned to clients: the vocabulary shared by all interfaces.
//!
//! Response types derive their JSON here, once, so that every interface sends the same bodies.

use std::fmt;
use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::error::Rejection;
use crate::wsg::{CustomCommand, Force, HomingDirection, MoveFlags, Speed, Status, Width};

mod alarm;
mod client;
mod code;
mod custom;
mod event;
mod fault;
mod frame;
mod ids;
pub mod lease;
mod names;
mod parameters;
mod recipe;
mod record;
mod state;
mod status;
mod text;
pub mod time;
mod updates;
mod urgency;

pub use alarm::{Alarm, AlarmCause, AlarmEvent, AlarmKind, AlarmPriority, AlarmStep};
pub use client::{Client, ClientLabel, Door};
pub use code::Code;
pub use custom::CustomIds;
pub use event::{
    AcknowledgeEvent, Admitted, CommandEvent, Detail, DeviceEvent, Done, Event, FastStopEvent, FastStopStep,
    FingerSetChange, GatewayEvent, LinkEvent, RefusedEvent, SettingChange, SettingsEvent,
};
pub use fault::Fault;
pub use frame::{DamageRecord, FrameDirection, FrameRecord, WireDamage, WireRecord};
pub use ids::{AlarmId, CommandId, FastStopId, IdSource};
pub use lease::{
    HolderName, Lease, LeaseEvent, LeaseRules, LeaseStep, LeaseToken, LossCause, LossEffect, OnLossHolding,
    OnLossMoving, TakeLease,
};
pub use parameters::{Direction, OnBlock, Parameters};
pub use recipe::{
    AcceptedWidths, AppliedRecipe, Recipe, RecipeDescription, RecipeEvent, RecipeFields, RecipeNumber, RecipeStep,
    RecipeValues,
};
pub use record::{GripRecord, OnJournalFailure, PersistedKey, PersistedState, RequestedValues, Sample};
pub use state::{FastStopCause, Latch, LatchFields, Link, State, Telemetry};
pub use status::GripperStatus;
pub use text::{InvalidShownName, PartId, Reason, RequestId, ShownName, Text};
pub use updates::{UpdateMode, UpdateRules};
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

/// A text that is not a valid [`Name`], cut to more characters than a name can have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is not a valid name: use 1 to 32 characters of a-z, 0-9, _ and -, starting with a letter or digit")]
pub struct InvalidName(pub String);

impl std::str::FromStr for Name {
    type Err = InvalidName;

    fn from_str(text: &str) -> Result<Self, InvalidName> {
        let allowed = |byte: &u8| matches!(byte, b'a'..=b'z' | b'0'..=b'9' | b'_' | b'-');
        let first = text.bytes().next().is_some_and(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit());
        if first && text.len() <= 32 && text.as_bytes().iter().all(allowed) {
            Ok(Self(text.into()))
        } else {
            Err(InvalidName(text.chars().take(40).collect()))
        }
    }
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
    pub fn of(request: &crate::wsg::Command) -> Option<Self> {
        use crate::wsg::Command as C;
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
///
/// - `home`: Homing (20h)
/// - `move`: Pre-position Fingers (21h)
/// - `grip`: Grip Part (25h)
/// - `release`: Release Part (26h)
/// - `stop`: Stop (22h)
/// - `custom`: a custom command, run by a script on the device
/// - `reference`: reference grip: Grip Part (25h) on a gauge, to detect wear of the fingers
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
    Home,
    Move,
    Grip,
    Release,
    Stop,
    Custom,
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
///
/// - `running`: admitted, and not ended yet
/// - `done`: ended, with an outcome
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    Running,
    Done,
}

/// Result of a command.
///
/// - `SUCCESS`: done as requested
/// - `PART_HELD`: the grip holds a part
/// - `NO_PART`: the grip found no part; a result, not an error
/// - `BLOCKED`: the axis was blocked
/// - `ABORTED`: ended by a Stop, a FAST STOP or a cancel, or withdrawn before it started
/// - `RANGE`: a soft or hard limit was reached during the motion
/// - `TIMEOUT`: the device reported a time-out of its own motion (E_TIMEOUT)
/// - `FAILED`: the device ended the command with another status code
/// - `REFUSED`: rejected before the device accepted the command, after the client had already received 202
/// - `UNKNOWN`: the result never arrived; the motion may or may not have happened
/// - `WRONG_PART`: the grip holds a part whose contact width is outside the limits of the recipe
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, strum::IntoStaticStr, strum::VariantArray,
)]
#[serde(rename_all = "SCREAMING_SNAKE_CASE")]
#[strum(serialize_all = "SCREAMING_SNAKE_CASE")]
pub enum Outcome {
    Success,
    PartHeld,
    NoPart,
    Blocked,
    Aborted,
    Range,
    Timeout,
    Failed,
    Refused,
    Unknown,
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

/// A command, running or ended.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Command, example = json!({
    "id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "gripper": "left", "number": 17, "kind": "grip", "phase": "done",
    "outcome": "PART_HELD", "outcome_code": 2, "status": "E_SUCCESS", "status_code": 0, "reached_goal": true, "stalled": true,
    "width_mm": 20.0, "force_n": 40.0, "started_at": "2026-11-21T09:00:00.000Z", "duration_ms": 412,
    "subject": "http:127.0.0.1", "client": "http:127.0.0.1", "replayed": false
}))]
pub struct CommandReport {
    /// Id of the command, a version 7 UUID.
    #[schema(value_type = Uuid)]
    pub id: CommandId,
    /// Name of the gripper.
    #[schema(value_type = String, max_length = 32)]
    pub gripper: Name,
    /// Number of the motion, which `last_command` in the gripper's status repeats. Null for a Stop, for a streamed
    /// command, and for an older command after a restart of the gateway.
    #[schema(required)]
    pub number: Option<u32>,
    /// Kind of the command.
    pub kind: Kind,
    /// Whether the command has ended.
    pub phase: Phase,
    /// Result of the command; null while it runs.
    #[schema(required)]
    pub outcome: Option<Outcome>,
    /// Result of the command as a number:
    ///
    /// - 0: the command runs
    /// - 1 to 11: `SUCCESS`, `PART_HELD`, `NO_PART`, `BLOCKED`, `ABORTED`, `RANGE`, `TIMEOUT`, `FAILED`, `REFUSED`,
    ///   `UNKNOWN`, `WRONG_PART`
    #[schema(minimum = 0, maximum = 255)]
    pub outcome_code: u8,
    /// Symbol of the last status code from the device, such as `E_SUCCESS`; null if the device sent none.
    #[schema(required)]
    pub status: Option<String>,
    /// The same status code as a number.
    #[schema(required, minimum = 0, maximum = 65535)]
    pub status_code: Option<u16>,
    /// Whether the command reached its goal: the target width, or a held part. Null while unknown.
    #[schema(required)]
    pub reached_goal: Option<bool>,
    /// Whether contact stopped the fingers. Null while unknown.
    #[schema(required)]
    pub stalled: Option<bool>,
    /// Opening width at the end, in mm; null while running or if unknown.
    #[schema(required, minimum = -1000, maximum = 1000)]
    pub width_mm: Option<f32>,
    /// Gripping force at the end, in N; null while running or if unknown.
    #[schema(required, minimum = -10000, maximum = 10000)]
    pub force_n: Option<f32>,
    /// Opening width at which the fingers met the part, in mm; absent unless a part was gripped.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false, minimum = -1000, maximum = 1000)]
    pub contact_width_mm: Option<f32>,
    /// Force with the greatest magnitude up to the end of a grip, in N. The grip record's peak also covers the second
    /// after the end.
    #[serde(skip)]
    pub peak_force_n: Option<f32>,
    /// Time of admission.
    #[serde(serialize_with = "time::milliseconds")]
    #[schema(value_type = String, format = DateTime)]
    pub started_at: Timestamp,
    /// Time from admission to end, in ms; null while running.
    #[schema(required, minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    pub duration_ms: Option<u64>,
    /// Subject of the client that requested the command.
    #[schema(value_type = String)]
    pub subject: Arc<str>,
    /// Same as `subject`.
    #[schema(value_type = String, deprecated)]
    pub client: Arc<str>,
    /// Whether this is the reply to a repeated request, whose command was admitted earlier.
    pub replayed: bool,
    /// Id of the FAST STOP that came while the command ran; otherwise absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Uuid>, nullable = false)]
    pub fast_stop_id: Option<FastStopId>,
    /// Reply of a custom command's script, as hex; absent for other commands and after a restart of the gateway.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, nullable = false, max_length = 8192)]
    pub payload: Option<Arc<str>>,
    /// Code of the problem that ended the command as `BLOCKED`, `RANGE`, `TIMEOUT`, `FAILED`, `REFUSED` or `UNKNOWN`;
    /// otherwise absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub code: Option<Code>,
    /// Description of that problem and its remedy, for people.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub detail: Option<String>,
    /// Holder, id and values of the request, for the journal.
    #[serde(skip)]
    pub requested: RequestedValues,
    /// Reason for a refusal, which waiting clients get as a problem.
    #[serde(skip)]
    pub rejection: Option<Rejection>,
    /// Subject of the client that cancelled the command, for the journal.
    #[serde(skip)]
    pub cancelled_by: Option<Arc<str>>,
    /// Whether the admission is recorded in the journal, so that clients can learn of the command.
    #[serde(skip)]
    pub recorded: bool,
    /// Whether the device has accepted the command with E_CMD_PENDING.
    #[serde(skip)]
    pub accepted: bool,
}

impl CommandReport {
    #[must_use]
    pub fn admitted(id: CommandId, gripper: Name, submission: &Submission, at: Timestamp) -> Self {
        let requested = RequestedValues::of(&submission.action, submission.request_id.clone());
        let subject = submission.client.subject.clone();
        Self { requested, ..Self::running(id, gripper, submission.action.kind(), subject, at) }
    }

    /// Returns the report of a running command. All other fields are empty.
    #[must_use]
    pub fn running(id: CommandId, gripper: Name, kind: Kind, subject: Arc<str>, at: Timestamp) -> Self {
        Self {
            id,
            gripper,
            number: None,
            kind,
            phase: Phase::Running,
            outcome: None,
            outcome_code: 0,
            status: None,
            status_code: None,
            reached_goal: None,
            stalled: None,
            width_mm: None,
            force_n: None,
            contact_width_mm: None,
            peak_force_n: None,
            started_at: at,
            duration_ms: None,
            client: subject.clone(),
            subject,
            replayed: false,
            fast_stop_id: None,
            payload: None,
            code: None,
            detail: None,
            requested: RequestedValues::default(),
            rejection: None,
            cancelled_by: None,
            recorded: false,
            accepted: false,
        }
    }

    /// Sets the result of the command.
    pub fn set_outcome(&mut self, outcome: Outcome) {
        self.outcome = Some(outcome);
        self.outcome_code = outcome.code();
    }

    /// Adds the reason for an outcome.
    pub fn explain(&mut self, code: Code, reason: &impl ToString) {
        self.code = Some(code);
        self.detail = Some(reason.to_string());
    }

    pub fn set_status(&mut self, status: Status) {
        self.status = Some(status.to_string());
        self.status_code = Some(status.code());
    }
}
