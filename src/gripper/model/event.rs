//! What is written down of a gripper and of the gateway: one event for each thing that happened.

use std::num::NonZero;
use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{
    Client, Command, CommandId, Door, FastStopCause, FastStopId, Kind, Name, Outcome, Parameters, PartId, RequestId,
    lease::LeaseEvent,
};

mod device;

pub use device::{DeviceEvent, LinkEvent};

/// Something that happened. The journal gives it a sequence number; `kind` and its fields stand beside the common ones.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Event {
    /// When.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// To which gripper; none where it concerns all.
    #[schema(value_type = Option<String>, required, max_length = 32)]
    pub gripper: Option<Name>,
    /// Who asked for it; none where nobody did.
    #[schema(value_type = Option<String>, required)]
    pub subject: Option<Arc<str>>,
    /// Through which door.
    #[schema(required)]
    pub door: Option<Door>,
    /// The command that it belongs to.
    #[schema(value_type = Option<uuid::Uuid>, required)]
    pub command_id: Option<CommandId>,
    /// How many earlier events of its kind it stands for. A client that repeats itself beyond its rate is written down by its newest event, once a second at most. Left out where there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<u64>, nullable = false, minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub aggregated: Option<NonZero<u64>>,
    /// What happened.
    #[serde(flatten)]
    pub detail: Detail,
}

impl Event {
    /// Something that nobody asked for.
    #[must_use]
    pub fn new(at: Timestamp, gripper: Option<Name>, detail: Detail) -> Self {
        Self { at, gripper, subject: None, door: None, command_id: None, aggregated: None, detail }
    }

    /// Something that a client asked for.
    #[must_use]
    pub fn by(self, client: &Client) -> Self {
        Self { subject: Some(client.subject.clone()), door: Some(client.door), ..self }
    }

    /// A part of a command.
    #[must_use]
    pub fn of(self, command: CommandId) -> Self {
        Self { command_id: Some(command), ..self }
    }
}

/// What happened, with its kind's fields.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Detail {
    /// A command was admitted, or has ended.
    Command(CommandEvent),
    /// A FAST STOP was latched, or confirmed by the device's flags.
    FastStop(FastStopEvent),
    /// A FAST STOP was acknowledged, or could not be.
    Acknowledge(AcknowledgeEvent),
    /// The lease has changed.
    Lease(LeaseEvent),
    /// The link has changed.
    Link(LinkEvent),
    /// The device has said something of itself, or lost something.
    Device(DeviceEvent),
    /// A client has set something, or it was set again for the client.
    Settings(SettingsEvent),
    /// A request was refused.
    Refused(RefusedEvent),
    /// The gateway itself.
    Gateway(GatewayEvent),
}

/// A command's two records.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "phase", rename_all = "lowercase")]
pub enum CommandEvent {
    /// It was admitted.
    Admitted(Admitted),
    /// It has ended.
    Done(Box<Done>),
}

/// A command that was admitted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Admitted {
    /// `home`, `move`, `grip`, `release`, `stop` or `custom`.
    pub command: Kind,
    /// What makes a repetition the same request.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, nullable = false, max_length = 64)]
    pub request_id: Option<RequestId>,
    /// What was asked for.
    #[serde(flatten)]
    pub parameters: Parameters,
}

/// A command that has ended.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Done {
    /// Its kind, like [`Admitted::command`].
    pub command: Kind,
    /// How it ended.
    pub outcome: Outcome,
    /// The device's last status, by its symbol.
    #[schema(required)]
    pub status: Option<String>,
    /// The same, by its number.
    #[schema(required)]
    pub status_code: Option<u16>,
    /// Whether the goal was reached.
    #[schema(required)]
    pub reached_goal: Option<bool>,
    /// Whether a contact stopped the fingers.
    #[schema(required)]
    pub stalled: Option<bool>,
    /// The opening width at the end, in mm.
    #[schema(required)]
    pub width_mm: Option<f32>,
    /// The gripping force at the end, in N.
    #[schema(required)]
    pub force_n: Option<f32>,
    /// When it was admitted.
    #[schema(value_type = String, format = DateTime)]
    pub started_at: Timestamp,
    /// From its admission to its end.
    #[schema(required)]
    pub duration_ms: Option<u64>,
    /// The FAST STOP that ended it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<uuid::Uuid>, nullable = false)]
    pub fast_stop_id: Option<FastStopId>,
    /// The part's name.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, nullable = false, max_length = 48)]
    pub part_id: Option<PartId>,
    /// Who cancelled it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, nullable = false)]
    pub cancelled_by: Option<Arc<str>>,
    /// Why it was refused, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub cause: Option<String>,
}

impl Done {
    /// Of a command's record. One that has no outcome may have happened.
    #[must_use]
    pub fn of(command: &Command, part_id: Option<PartId>) -> Self {
        Self {
            command: command.kind,
            outcome: command.outcome.unwrap_or(Outcome::Unknown),
            status: command.status.clone(),
            status_code: command.status_code,
            reached_goal: command.reached_goal,
            stalled: command.stalled,
            width_mm: command.width_mm,
            force_n: command.force_n,
            started_at: command.started_at,
            duration_ms: command.duration_ms,
            fast_stop_id: command.fast_stop_id,
            part_id,
            cancelled_by: command.cancelled_by.clone(),
            cause: command.rejection.as_ref().map(ToString::to_string),
        }
    }
}

/// A FAST STOP's records.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FastStopEvent {
    /// Which of its records.
    pub event: FastStopStep,
    /// What an acknowledge has to name.
    #[schema(value_type = uuid::Uuid)]
    pub fast_stop_id: FastStopId,
    /// Why, in the gateway's words.
    pub cause: FastStopCause,
    /// Why, in the client's words.
    pub reason: String,
    /// How many it stands for: of those that a client repeats while one holds, the newest is told, once a second.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub count: u64,
}

/// How far a FAST STOP is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum FastStopStep {
    /// Asked for, or seen.
    Latched,
    /// The device's flags show it.
    Confirmed,
}

/// An acknowledge's end.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct AcknowledgeEvent {
    /// The FAST STOP that it named.
    #[schema(value_type = uuid::Uuid)]
    pub fast_stop_id: FastStopId,
    /// Whether the FAST STOP is gone.
    pub cleared: bool,
    /// Why it isn't, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub cause: Option<String>,
}

/// What was set.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct SettingsEvent {
    /// Whether the gateway has set it again, for a device that had forgotten it.
    pub restored: bool,
    /// What.
    #[serde(flatten)]
    pub setting: SettingChange,
}

/// A setting and its value.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(tag = "setting", rename_all = "snake_case")]
pub enum SettingChange {
    /// 30h
    Acceleration {
        /// In mm/s².
        acceleration_mm_s2: f32,
    },
    /// 32h
    ForceLimit {
        /// In N.
        force_n: f32,
    },
    /// 34h
    SoftLimits {
        /// In mm.
        minus_mm: f32,
        /// In mm.
        plus_mm: f32,
    },
    /// 36h
    SoftLimitsCleared,
    /// 37h
    Overdrive {
        /// Whether it is on.
        enabled: bool,
    },
    /// 51h
    DeviceTag {
        /// The text.
        tag: String,
    },
    /// A finger's power.
    FingerPower {
        /// 1 or 2.
        finger: u8,
        /// Whether it is on.
        enabled: bool,
    },
    /// 38h
    Tare,
    /// The statistics were reset.
    StatisticsReset,
}

/// A refusal, or several of the same in one second.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RefusedEvent {
    /// What was asked for: the last part of the path, or the method's name.
    pub command: String,
    /// The problem's code.
    pub code: String,
    /// The problem's words.
    pub cause: String,
    /// How many of them.
    pub count: u64,
}

/// What became of the gateway.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum GatewayEvent {
    /// It has started.
    Started {
        /// Its version.
        version: &'static str,
        /// Its name.
        gateway: String,
    },
    /// The configuration that it runs with.
    Configuration {
        /// Where it serves HTTP.
        listen: String,
        /// The grippers, each as `name=URL`.
        grippers: Vec<String>,
    },
    /// Its last run has not ended in order.
    UncleanEnd {
        /// The commands that were running: each is told as `UNKNOWN`.
        #[schema(value_type = Vec<uuid::Uuid>)]
        running: Vec<CommandId>,
    },
    /// It has ended in order.
    Ended,
    /// Records found no place while the disk did not take them.
    RecordsLost {
        /// How many.
        count: u64,
    },
    /// Old records were removed.
    Pruned {
        /// The last event that is removed from now on; 0 where none was yet.
        up_to_seq: i64,
        /// Its hash, as hex: what is left begins behind it.
        hash: String,
        /// The last grip record that is; 0 where none was yet.
        grips_up_to_seq: i64,
        /// Its hash, as hex.
        grips_hash: String,
    },
}
