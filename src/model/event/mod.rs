//! Events of grippers and of the gateway, as the journal stores them.

use std::num::NonZero;
use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::{
    AlarmEvent, Client, ClientLabel, Code, CommandId, CommandReport, Door, FastStopCause, FastStopId, FingerSetId,
    Kind, Name, Outcome, Parameters, PartId, RecipeEvent, RequestId, RequestedValues, lease::LeaseEvent,
};

mod device;
mod gateway;

pub use device::{DeviceEvent, LinkEvent};
pub use gateway::{GatewayEvent, KeptShare};

/// An event. The journal adds a sequence number. `kind` and its fields are on the same level as the common fields.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Event {
    /// Time of the event.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub at: Timestamp,
    /// Name of the gripper; null if the event concerns all grippers.
    #[schema(required)]
    pub gripper: Option<Name>,
    /// Subject of the client that caused the event; null if no client did.
    #[schema(required)]
    pub subject: Option<Arc<str>>,
    /// Name that the client gave, if it has no credential. It is shown beside the subject, and proves nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub label: Option<ClientLabel>,
    /// Interface that the client used; null if no client caused the event.
    #[schema(required)]
    pub door: Option<Door>,
    /// Id of the command that the event belongs to; null if it belongs to none.
    #[schema(required)]
    pub command_id: Option<CommandId>,
    /// Number of earlier events of the same kind that this event also stands for; absent if it stands for itself
    /// alone. For a client that exceeds its rate, only the newest event is stored, at most once a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<u64>, nullable = false, minimum = 1)]
    pub aggregated: Option<NonZero<u64>>,
    #[serde(flatten)]
    pub detail: Detail,
}

impl Event {
    /// An event that no client caused.
    #[must_use]
    pub fn new(at: Timestamp, gripper: Option<Name>, detail: Detail) -> Self {
        Self { at, gripper, subject: None, label: None, door: None, command_id: None, aggregated: None, detail }
    }

    /// Adds the client that caused the event.
    #[must_use]
    pub fn by(self, client: &Client) -> Self {
        Self { subject: Some(client.subject.clone()), label: client.label.clone(), door: Some(client.door), ..self }
    }

    /// Adds the command that the event belongs to.
    #[must_use]
    pub fn of(self, command: CommandId) -> Self {
        Self { command_id: Some(command), ..self }
    }
}

/// Kind of an event, with the fields of that kind.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Detail {
    /// A command was admitted, or has ended.
    Command(CommandEvent),
    /// A FAST STOP was latched, or confirmed by the device's flags.
    FastStop(FastStopEvent),
    /// A FAST STOP or a fault of the device was acknowledged, or could not be.
    Acknowledge(AcknowledgeEvent),
    /// The lease changed.
    Lease(LeaseEvent),
    /// The connection state of the device link changed.
    Link(LinkEvent),
    /// The device restarted, was replaced, reported a fault, lost a part, or moved without a command.
    Device(DeviceEvent),
    /// A client changed a setting, the gateway restored one, or the device reduced its force limit.
    Settings(SettingsEvent),
    /// A request was refused.
    Refused(RefusedEvent),
    /// The gateway started, ended, or changed its records.
    Gateway(GatewayEvent),
    /// An alarm was raised, ended or was acknowledged.
    Alarm(Box<AlarmEvent>),
    /// A recipe was set or removed.
    Recipe(Box<RecipeEvent>),
}

/// Admission or end of a command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "phase", rename_all = "lowercase")]
pub enum CommandEvent {
    /// The command was admitted.
    Admitted(Box<Admitted>),
    /// The command has ended.
    Done(Box<Done>),
}

/// Admission of a command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Admitted {
    /// Kind of the command.
    pub command: Kind,
    /// Name of the lease holder, if the command was requested with the lease.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    #[schema(nullable = false)]
    pub holder: Option<Arc<str>>,
    /// Id by which a repeated request is recognised.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub request_id: Option<RequestId>,
    /// Parameters of the request.
    #[serde(flatten)]
    pub parameters: Parameters,
}

/// End of a command.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Done {
    /// Kind of the command.
    pub command: Kind,
    /// Result of the command.
    pub outcome: Outcome,
    /// Symbol of the last status code from the device.
    #[schema(required)]
    pub status: Option<String>,
    /// The same status code as a number.
    #[schema(required)]
    pub status_code: Option<u16>,
    /// Whether the command reached its goal.
    #[schema(required)]
    pub reached_goal: Option<bool>,
    /// Whether contact stopped the fingers.
    #[schema(required)]
    pub stalled: Option<bool>,
    /// Opening width at the end, in mm.
    #[schema(required)]
    pub width_mm: Option<f32>,
    /// Gripping force at the end, in N.
    #[schema(required)]
    pub force_n: Option<f32>,
    /// Opening width at which the fingers met the part, in mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub contact_width_mm: Option<f32>,
    /// Time of admission.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub started_at: Timestamp,
    /// Time from admission to end, in ms.
    #[schema(required)]
    pub duration_ms: Option<u64>,
    /// Id of the FAST STOP that came while the command ran.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub fast_stop_id: Option<FastStopId>,
    /// Name of the part.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub part_id: Option<PartId>,
    /// Subject of the client that cancelled the command.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub cancelled_by: Option<Arc<str>>,
    /// Code of the problem that ended the command as `BLOCKED`, `RANGE`, `TIMEOUT`, `FAILED`, `REFUSED` or `UNKNOWN`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub code: Option<Code>,
    /// Description of the problem that `code` identifies, and its remedy.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub cause: Option<String>,
    #[serde(flatten)]
    pub requested: RequestedValues,
}

impl Done {
    /// The end of a command, from its record. A missing outcome becomes [`Outcome::Unknown`].
    #[must_use]
    pub fn of(command: &CommandReport, part_id: Option<PartId>) -> Self {
        Self {
            command: command.kind,
            outcome: command.outcome.unwrap_or(Outcome::Unknown),
            status: command.status.clone(),
            status_code: command.status_code,
            reached_goal: command.reached_goal,
            stalled: command.stalled,
            width_mm: command.width_mm,
            force_n: command.force_n,
            contact_width_mm: command.contact_width_mm,
            started_at: command.started_at,
            duration_ms: command.duration_ms,
            fast_stop_id: command.fast_stop_id,
            part_id,
            cancelled_by: command.cancelled_by.clone(),
            code: command.code,
            cause: command.detail.clone(),
            requested: command.requested.clone(),
        }
    }
}

/// Step of a FAST STOP.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FastStopEvent {
    /// Step that was reached.
    pub event: FastStopStep,
    /// Id that an acknowledgement has to name.
    pub fast_stop_id: FastStopId,
    /// Cause of the FAST STOP.
    pub cause: FastStopCause,
    /// Reason given by the client; may be empty.
    pub reason: String,
    /// Number of FAST STOPs that this event stands for. Repeated requests are counted, and only the newest is stored,
    /// once a second.
    #[schema(minimum = 1)]
    pub count: u64,
}

/// Step of a FAST STOP.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "snake_case")]
pub enum FastStopStep {
    /// Requested by a client, or reported by the device.
    Latched,
    /// Shown by the device's flags.
    Confirmed,
}

/// Result of an acknowledgement.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct AcknowledgeEvent {
    /// Id of the FAST STOP that the acknowledgement named; null for a fault of the device without a FAST STOP.
    #[schema(required)]
    pub fast_stop_id: Option<FastStopId>,
    /// Whether the FAST STOP was cleared. For a fault without a FAST STOP: whether the device accepted the
    /// acknowledgement.
    pub cleared: bool,
    /// Reason for a failure, as text; absent if the FAST STOP was cleared.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub cause: Option<String>,
}

/// Change of a setting.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct SettingsEvent {
    /// Whether the gateway restored the setting on a device that had lost it.
    pub restored: bool,
    #[serde(flatten)]
    pub setting: SettingChange,
}

/// A setting and its value.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(tag = "setting", rename_all = "snake_case")]
pub enum SettingChange {
    /// Set Acceleration (30h).
    Acceleration {
        /// Acceleration in mm/s².
        acceleration_mm_s2: f32,
    },
    /// Set Force Limit (32h).
    ForceLimit {
        /// Force limit in N.
        force_n: f32,
    },
    /// Set Soft Limits (34h).
    SoftLimits {
        /// Smallest allowed width in mm.
        minus_mm: f32,
        /// Largest allowed width in mm.
        plus_mm: f32,
    },
    /// Clear Soft Limits (36h).
    SoftLimitsCleared,
    /// Overdrive Mode (37h).
    Overdrive {
        /// Whether Overdrive Mode is on.
        enabled: bool,
    },
    /// Set Device Tag (51h).
    DeviceTag {
        /// Text of the tag.
        tag: String,
    },
    /// Finger Power Control (62h, 72h).
    FingerPower {
        /// Number of the finger, 1 or 2.
        finger: u8,
        /// Whether the power is on.
        enabled: bool,
    },
    /// Tare Force Sensor (38h).
    Tare,
    /// The statistics were reset.
    StatisticsReset,
    /// A finger set was mounted, or its maintenance limits were set.
    FingerSet(Box<FingerSetChange>),
}

/// The finger set of a gripper, as a client has named it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FingerSetChange {
    /// Id of the finger set.
    pub finger_set: FingerSetId,
    /// Time from which the use of the set is counted.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub mounted_at: Timestamp,
    /// Number of grips after which the set needs maintenance; null without a limit.
    #[schema(required)]
    pub maintenance_cycles: Option<u64>,
    /// Distance after which the set needs maintenance, in m; null without a limit.
    #[schema(required)]
    pub maintenance_travel_m: Option<f64>,
}

/// A refusal, or several equal ones. Equal refusals that follow within an hour are counted together.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RefusedEvent {
    /// Requested operation: the last part of the path, or the method's name.
    pub command: String,
    /// Code of the problem.
    pub code: String,
    /// Text of the problem.
    pub cause: String,
    /// Number of refusals.
    pub count: u64,
}
