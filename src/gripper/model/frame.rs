//! One frame on the wire, as whoever looks for a mistake is told of it.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::Name;

/// Which way a frame went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum FrameDirection {
    /// To the device.
    Sent,
    /// From the device.
    Received,
}

/// A frame that was sent to the device, or received from it. Damaged ones are not told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "seq": 4711, "at": "2026-11-21T09:00:00.25Z", "direction": "sent", "id": 37, "name": "Grip",
    "hex": "aaaaaa2508000000a04100004842aa1e", "text": "Grip width=20 speed=50"
}))]
pub struct Frame {
    /// The gripper's name.
    #[schema(value_type = String, max_length = 32)]
    pub gripper: Name,
    /// Counts the frames of this gripper that were told, from 1.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub seq: u64,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// Which way it went.
    pub direction: FrameDirection,
    /// The command's id.
    #[schema(minimum = 0, maximum = 255)]
    pub id: u8,
    /// The manual's name for it; null for a custom command.
    #[schema(required)]
    pub name: Option<String>,
    /// All its bytes, preamble and checksum among them, as hex.
    pub hex: String,
    /// What it says, as `wsg-gateway decode` has it.
    pub text: String,
}
