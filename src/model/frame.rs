//! Frames and damage on the wire, as the wire log shows them.

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::Name;
use wsg::id;

/// Direction of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum FrameDirection {
    /// To the device.
    Sent,
    /// From the device.
    Received,
}

/// A frame sent to the device or received from it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = Frame, example = json!({
    "gripper": "left", "seq": 4711, "at": "2026-11-21T09:00:00.250Z", "direction": "sent", "id": 37, "name": "Grip",
    "hex": "aaaaaa2508000000a04100004842aa1e", "text": "Grip width=20 speed=50"
}))]
pub struct FrameRecord {
    /// Name of the gripper.
    pub gripper: Name,
    /// Sequence number of the frame among the frames and damages reported for this gripper, from 1.
    #[schema(minimum = 1)]
    pub seq: u64,
    /// Time at which the frame was sent or received.
    #[serde(serialize_with = "super::time::milliseconds")]
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

/// Kind of damage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "lowercase")]
pub enum WireDamage {
    /// A frame has a wrong checksum.
    Checksum,
    /// Bytes belong to no frame.
    Skipped,
}

/// Bytes from the device that do not form a valid frame. The gateway ignores them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = Damage, example = json!({
    "gripper": "left", "seq": 4712, "at": "2026-11-21T09:00:00.260Z", "direction": "received", "damage": "checksum",
    "id": 34, "name": "Stop", "bytes": 8, "hex": "aaaaaa2200000e77", "text": "Stop  [checksum wrong]"
}))]
pub struct DamageRecord {
    /// Name of the gripper.
    pub gripper: Name,
    /// Sequence number of the damage among the frames and damages reported for this gripper, from 1.
    #[schema(minimum = 1)]
    pub seq: u64,
    /// Time at which the bytes were received.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub at: Timestamp,
    /// Always `received`.
    pub direction: FrameDirection,
    /// Kind of damage.
    pub damage: WireDamage,
    /// Id in the damaged frame, which can be damaged too; null for skipped bytes.
    #[schema(required, minimum = 0, maximum = 255)]
    pub id: Option<u8>,
    /// Name of the command with that id; null if the id has no name.
    #[schema(required)]
    pub name: Option<String>,
    /// Number of bytes.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub bytes: usize,
    /// The bytes as hex: at most the first 256.
    #[schema(max_length = 512)]
    pub hex: String,
    /// Description, in the notation of `wsg-gateway decode`.
    pub text: String,
}

/// Entry of the wire log.
#[derive(Debug, Clone, PartialEq)]
pub enum WireRecord {
    Frame(FrameRecord),
    Damage(DamageRecord),
}

impl WireRecord {
    #[must_use]
    pub const fn seq(&self) -> u64 {
        match self {
            Self::Frame(frame) => frame.seq,
            Self::Damage(damage) => damage.seq,
        }
    }

    /// Whether this is an automatic update. The reply to a single read of such a value looks the same.
    #[must_use]
    pub fn is_update(&self) -> bool {
        matches!(self, Self::Frame(frame) if frame.direction == FrameDirection::Received && id::has_updates(frame.id))
    }
}
