//! Events of the device and of its link.

use serde::Serialize;
use utoipa::ToSchema;

use super::super::{Link, ServoAdapter, ServoEnd};

/// Change of the link's connection state.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LinkEvent {
    /// New connection state.
    pub link: Link,
    /// Reason that the link is not connected; null if it is.
    #[schema(required)]
    pub link_cause: Option<String>,
}

/// An event of the device.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum DeviceEvent {
    /// The device has restarted and lost its reference.
    Restarted,
    /// A different device answers.
    Replaced {
        /// Serial number of the previous device.
        #[schema(format = Int64)]
        known_serial_number: u32,
        /// Serial number of the device that answers now.
        #[schema(format = Int64)]
        serial_number: u32,
    },
    /// Fault flags were set.
    Fault {
        /// Names of the flags.
        flags: Vec<&'static str>,
    },
    /// Fault flags were cleared.
    FaultCleared {
        /// Names of the flags.
        flags: Vec<&'static str>,
    },
    /// The fingers moved without a command of this gateway.
    ForeignMotion,
    /// Changes came so fast that some were only counted. The newest change of each sort follows as an event of its own.
    Flickering {
        /// Sorts of changes, such as `link reconnecting` or `fault TEMP_FAULT`.
        cause: String,
        /// Number of changes left out within one second.
        #[schema(minimum = 1)]
        count: u64,
    },
    /// Clients sent a script motions with an id from `stream_ids`. The first request is recorded at once, and further
    /// ones are counted each second.
    Streamed {
        /// Id of the custom command.
        raw_id: u8,
        /// Number of admitted requests.
        count: u64,
    },
    /// A stream of script motions fell silent while the fingers moved, so the gateway sent a Stop.
    StreamSilent {
        /// Id of the custom command.
        raw_id: u8,
    },
    /// A client began to steer the fingers in a servo session.
    ServoStarted {
        /// Way in which targets reach the fingers.
        adapter: ServoAdapter,
        /// Silence after which the session ends with a Stop, in ms.
        timeout_ms: u64,
        /// Greatest speed of a target in mm/s.
        max_speed_mm_s: f32,
        /// Force limit that the session sets in N; null if it sets none.
        #[schema(required)]
        force_n: Option<f32>,
    },
    /// A servo session ended.
    ServoEnded {
        /// Way in which targets reached the fingers.
        adapter: ServoAdapter,
        /// Reason for the end.
        reason: ServoEnd,
        /// Duration of the session in ms.
        duration_ms: u64,
        /// Number of accepted targets.
        accepted: u64,
        /// Number of accepted targets that a newer one has replaced before they were sent.
        superseded: u64,
        /// Number of refused targets.
        refused: u64,
        /// Longest time between two accepted targets, in ms.
        longest_gap_ms: u64,
        /// Way that the fingers have travelled, in mm.
        travel_mm: f64,
    },
    /// Values became unknown, because the device does not send them, or sends an error or an impossible number.
    ValuesUnknown {
        /// Names of the values, as in the state.
        values: Vec<&'static str>,
        /// Reason that the values are unknown, as text.
        cause: String,
    },
    /// Values are known again.
    ValuesKnown {
        /// Names of the values, as in the state.
        values: Vec<&'static str>,
    },
    /// A held part was lost. The event belongs to the command that gripped the part.
    PartLost {
        /// Opening width in mm when the loss was noticed; null if unknown.
        #[schema(required)]
        width_mm: Option<f32>,
    },
}
