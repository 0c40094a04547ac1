//! What becomes of the device and of its link.

use serde::Serialize;
use utoipa::ToSchema;

use super::super::Link;

/// A link's change.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LinkEvent {
    /// How it is now.
    pub link: Link,
    /// Why it isn't connected.
    #[schema(required)]
    pub link_cause: Option<String>,
}

/// What became of the device.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum DeviceEvent {
    /// It has restarted: its reference is gone.
    Restarted,
    /// Another device answers.
    Replaced {
        /// The one before.
        #[schema(format = Int64)]
        known_serial_number: u32,
        /// The one that answers.
        #[schema(format = Int64)]
        serial_number: u32,
    },
    /// Fault flags have come.
    Fault {
        /// Their names.
        flags: Vec<&'static str>,
    },
    /// Fault flags are gone.
    FaultCleared {
        /// Their names.
        flags: Vec<&'static str>,
    },
    /// The fingers move, and nobody here asked for it.
    ForeignMotion,
    /// Changes came so quickly that they were counted; the newest of each sort follows.
    Flickering {
        /// Which changes, such as `link reconnecting` or `fault TEMP_FAULT`.
        cause: String,
        /// How many were left out within one second.
        #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
        count: u64,
    },
    /// A script was asked to move them, by an id of `stream_ids`: the first time, or so often in one second.
    Streamed {
        /// Its id.
        raw_id: u8,
        /// How many requests were admitted.
        count: u64,
    },
    /// A part that was held is gone; the event belongs to its grip.
    PartLost {
        /// The opening width in mm where it was seen.
        #[schema(required)]
        width_mm: Option<f32>,
    },
}
