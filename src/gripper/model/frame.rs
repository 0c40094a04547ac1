//! A frame on the wire, as the wire log shows it.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::Name;

/// Direction of a frame.
///
/// - `sent`: to the device
/// - `received`: from the device
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum FrameDirection {
    Sent,
    Received,
}

/// A frame sent to the device or received from it. Damaged frames are left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = Frame, example = json!({
    "gripper": "left", "seq": 4711, "at": "2026-11-21T09:00:00.25Z", "direction": "sent", "id": 37, "name": "Grip",
    "hex": "aaaaaa2508000000a04100004842aa1e", "text": "Grip width=20 speed=50"
}))]
pub struct FrameRecord {
    /// Name of the gripper.
    #[schema(value_type = String, max_length = 32)]
    pub gripper: Name,
    /// Sequence number of the frame among those reported for this gripper, from 1.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub seq: u64,
    /// Time at which the frame was sent or received.
    #[serde(serialize_with = "super::time::milliseconds")]
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// Direction of the frame.
    pub direction: FrameDirection,
    /// Id of the command.
    #[schema(minimum = 0, maximum = 255)]
    pub id: u8,
    /// Name of the command in the manual; null for a custom command.
    #[schema(required)]
    pub name: Option<String>,
    /// All bytes as hex, including preamble and checksum.
    pub hex: String,
    /// Decoded content, in the notation of `wsg-gateway decode`.
    pub text: String,
}
