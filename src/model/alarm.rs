//! Alarms: conditions that a person must know about, until they have ended and are acknowledged.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::{AlarmId, ClientLabel, FastStopId, Name, PartId};

/// Condition that raises an alarm.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Hash,
    Serialize,
    Deserialize,
    ToSchema,
    EnumMessage,
    VariantArray,
)]
#[serde(rename_all = "snake_case")]
pub enum AlarmKind {
    /// A FAST STOP is latched; its acknowledgement also acknowledges the alarm.
    FastStop,
    /// The temperature of the device is critical (`TEMP_FAULT`).
    TemperatureFault,
    /// The supply voltage of the device is out of range (`POWER_FAULT`).
    PowerFault,
    /// The motor reached its thermal limit (`CURR_FAULT`).
    CurrentFault,
    /// A finger reported a fault (`FINGER_FAULT`).
    FingerFault,
    /// The device is in the state ERROR, and nobody has acknowledged a FAST STOP since.
    DeviceError,
    /// The device has not been reached since the gateway started.
    NotReached,
    /// The link to the device is lost, or the device is silent.
    LinkDown,
    /// The device does not send a value, or sends an error or an impossible number instead.
    ValueUnknown,
    /// The link was closed by a `disconnect` request.
    LinkReleased,
    /// The lease holder was lost while a part was held or a motion continued, and the gripper is reserved for it.
    HolderLost,
    /// The device has lost its part.
    PartLost,
    /// The device lost settings that could not be restored.
    SettingsLost,
    /// The journal cannot be written.
    JournalDown,
    /// Earlier records of the journal are damaged.
    JournalDamaged,
    /// The journal does not continue that of the last run: it was restored from a copy, or records were deleted; its
    /// acknowledgement confirms that no client repeats requests of the time without records.
    JournalRestored,
    /// The wall clock has jumped far ahead, so no record is removed for its age; its acknowledgement confirms the time.
    ClockDoubtful,
    /// Another gateway of the fleet is gone.
    GatewayGone,
    /// The temperature of the device is close to its limit (`TEMP_WARNING`).
    TemperatureWarning,
    /// A script on the device has failed (`SCRIPT_FAILURE`).
    ScriptFailure,
    /// The contact widths of a part or gauge drift.
    DriftWarning,
    /// The finger set has reached one of its maintenance limits.
    MaintenanceDue,
    /// The token or PIN ends within 14 days, or has ended.
    TokenExpiring,
    /// The TLS certificate ends within 14 days, or has ended.
    CertificateExpiring,
    /// The receiver of the webhook has accepted no delivery for a minute.
    WebhookFailing,
    /// A connection to the MQTT broker has been down for a minute.
    MqttFailing,
}

impl AlarmKind {
    #[must_use]
    pub const fn priority(self) -> AlarmPriority {
        match self {
            Self::FastStop
            | Self::TemperatureFault
            | Self::PowerFault
            | Self::CurrentFault
            | Self::FingerFault
            | Self::DeviceError => AlarmPriority::Critical,
            Self::NotReached
            | Self::LinkDown
            | Self::ValueUnknown
            | Self::HolderLost
            | Self::PartLost
            | Self::SettingsLost
            | Self::JournalDown
            | Self::JournalDamaged
            | Self::JournalRestored
            | Self::ClockDoubtful
            | Self::GatewayGone => AlarmPriority::High,
            Self::LinkReleased
            | Self::TemperatureWarning
            | Self::ScriptFailure
            | Self::DriftWarning
            | Self::MaintenanceDue
            | Self::TokenExpiring
            | Self::CertificateExpiring
            | Self::WebhookFailing
            | Self::MqttFailing => AlarmPriority::Low,
        }
    }
}

/// Priority of an alarm, highest first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum AlarmPriority {
    Critical,
    High,
    Low,
}

/// The cause of an alarm.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
pub struct AlarmCause {
    /// Cause as text: the cause of a FAST STOP or of a lost link, the unknown values, the name of a lost lease holder, the
    /// figures of a drift, or the use of a finger set. Also the end of a credential, or the failure of a webhook or
    /// of MQTT. Null if the kind of the alarm says everything.
    #[schema(required)]
    pub cause: Option<Arc<str>>,
    /// Id of the FAST STOP; null for other alarms.
    #[schema(required)]
    pub fast_stop_id: Option<FastStopId>,
    /// Subject of the client that requested the FAST STOP, or `device`; null for other alarms.
    #[schema(required)]
    pub fast_stop_by: Option<Arc<str>>,
    /// Reason given for the FAST STOP, may be empty; null for other alarms.
    #[schema(required)]
    pub fast_stop_reason: Option<Arc<str>>,
    /// Id of the part or gauge whose contact widths drift; null for other alarms.
    #[serde(default)]
    #[schema(required)]
    pub part_id: Option<PartId>,
    /// Name of the token or webhook, file of the certificate, or URL of the MQTT broker; null for other alarms.
    #[serde(default)]
    #[schema(required)]
    pub name: Option<Arc<str>>,
}

/// An alarm that is active, or not acknowledged yet.
// The schema has another name than its field `alarm`, since generated clients use both as names of variables.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = RaisedAlarm, example = json!({
    "id": "019aa5c8-5a71-7d02-8c11-5b6f0e2d9a34", "alarm": "link_down", "priority": "high", "gripper": "left",
    "gateway": null, "cause": "connection refused", "fast_stop_id": null, "fast_stop_by": null,
    "fast_stop_reason": null, "part_id": null, "name": null, "began_at": "2026-11-21T09:00:00.250Z", "ended_at": null, "count": 1,
    "acknowledged_at": null, "acknowledged_by": null
}))]
pub struct Alarm {
    /// Id to name in the acknowledgement. Each occurrence has an id of its own.
    pub id: AlarmId,
    /// Kind of the alarm.
    pub alarm: AlarmKind,
    /// Priority of this kind.
    pub priority: AlarmPriority,
    /// Name of the gripper; null if the alarm concerns the gateway.
    #[schema(required)]
    pub gripper: Option<Name>,
    /// Name of the gateway that is gone; null for other alarms.
    #[schema(required)]
    pub gateway: Option<Name>,
    #[serde(flatten)]
    pub cause: AlarmCause,
    /// Time at which the newest occurrence began.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub began_at: Timestamp,
    /// Time at which it ended; null while the alarm is active.
    #[serde(serialize_with = "super::time::milliseconds_or_null")]
    #[schema(required)]
    pub ended_at: Option<Timestamp>,
    /// Number of occurrences since the last acknowledgement.
    #[schema(minimum = 1)]
    pub count: u64,
    /// Time of the acknowledgement; null if nobody has acknowledged the alarm yet.
    #[serde(serialize_with = "super::time::milliseconds_or_null")]
    #[schema(required)]
    pub acknowledged_at: Option<Timestamp>,
    /// Subject of the client that acknowledged the alarm; null if nobody has, or if it is unknown who did.
    #[schema(required)]
    pub acknowledged_by: Option<Arc<str>>,
    /// Name that this client gave, if it has no credential.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub acknowledged_label: Option<ClientLabel>,
}

/// Step in the life of an alarm.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct AlarmEvent {
    /// Step that was reached.
    pub event: AlarmStep,
    /// Id of the occurrence.
    pub alarm_id: AlarmId,
    /// Kind of the alarm.
    pub alarm: AlarmKind,
    /// Priority of this kind.
    pub priority: AlarmPriority,
    /// Name of the gateway that is gone; absent for other alarms.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub gateway: Option<Name>,
    /// Number of occurrences since the last acknowledgement.
    #[schema(minimum = 1)]
    pub count: u64,
    #[serde(flatten)]
    pub cause: AlarmCause,
}

impl AlarmEvent {
    #[must_use]
    pub fn of(event: AlarmStep, alarm: &Alarm) -> Self {
        Self {
            event,
            alarm_id: alarm.id,
            alarm: alarm.alarm,
            priority: alarm.priority,
            gateway: alarm.gateway.clone(),
            count: alarm.count,
            cause: alarm.cause.clone(),
        }
    }
}

/// Step in the life of an alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "snake_case")]
pub enum AlarmStep {
    /// The condition began.
    Raised,
    /// The condition ended.
    Ended,
    /// A client acknowledged the alarm.
    Acknowledged,
}
