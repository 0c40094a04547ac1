//! Command ids (`fw4-en 3`) with their names and allowed payload sizes.

use super::device::DeviceTag;

/// `fw4-en 3.1.1`.
pub const LOOP: u8 = 0x06;
/// `fw4-en 3.1.2`.
pub const DISCONNECT_ANNOUNCEMENT: u8 = 0x07;
/// `fw4-en 3.2.1`.
pub const HOMING: u8 = 0x20;
/// `fw4-en 3.2.2`.
pub const PRE_POSITION: u8 = 0x21;
/// `fw4-en 3.2.3`.
pub const STOP: u8 = 0x22;
/// `fw4-en 3.2.4`.
pub const FAST_STOP: u8 = 0x23;
/// `fw4-en 3.2.5`.
pub const ACKNOWLEDGE_FAST_STOP: u8 = 0x24;
/// `fw4-en 3.2.6`.
pub const GRIP: u8 = 0x25;
/// `fw4-en 3.2.7`. The "(42h)" in one place of fw4-de is a misprint.
pub const RELEASE: u8 = 0x26;
/// `fw4-en 3.3.1`.
pub const SET_ACCELERATION: u8 = 0x30;
/// `fw4-en 3.3.2`.
pub const GET_ACCELERATION: u8 = 0x31;
/// `fw4-en 3.3.3`.
pub const SET_FORCE_LIMIT: u8 = 0x32;
/// `fw4-en 3.3.4`.
pub const GET_FORCE_LIMIT: u8 = 0x33;
/// `fw4-en 3.3.5`.
pub const SET_SOFT_LIMITS: u8 = 0x34;
/// `fw4-en 3.3.6`.
pub const GET_SOFT_LIMITS: u8 = 0x35;
/// `fw4-en 3.3.7`.
pub const CLEAR_SOFT_LIMITS: u8 = 0x36;
/// `fw4-en 3.3.8`.
pub const OVERDRIVE_MODE: u8 = 0x37;
/// `fw4-en 3.3.9`.
pub const TARE_FORCE_SENSOR: u8 = 0x38;
/// `fw4-en 3.4.1`.
pub const GET_SYSTEM_STATE: u8 = 0x40;
/// `fw4-en 3.4.2`.
pub const GET_GRIPPER_STATE: u8 = 0x41;
/// `fw4-en 3.4.3`. Ruling: 42h; the line "Command ID: 40h" in all three manuals is a misprint.
pub const GET_STATISTICS: u8 = 0x42;
/// `fw4-en 3.4.4`.
pub const GET_WIDTH: u8 = 0x43;
/// `fw4-en 3.4.5`.
pub const GET_SPEED: u8 = 0x44;
/// `fw4-en 3.4.6`.
pub const GET_FORCE: u8 = 0x45;
/// `fw4-en 3.4.7`, fw4 only.
pub const GET_TEMPERATURE: u8 = 0x46;
/// `fw4-en 3.5.1`.
pub const GET_SYSTEM_INFO: u8 = 0x50;
/// `fw4-en 3.5.2`.
pub const SET_DEVICE_TAG: u8 = 0x51;
/// `fw4-en 3.5.3`.
pub const GET_DEVICE_TAG: u8 = 0x52;
/// `fw4-en 3.5.4`.
pub const GET_SYSTEM_LIMITS: u8 = 0x53;
/// `fw4-en 3.6.1`. The whole finger interface (60h to 73h) is fw4 only.
pub const GET_FINGER_1_INFO: u8 = 0x60;
/// `fw4-en 3.6.2`.
pub const GET_FINGER_1_FLAGS: u8 = 0x61;
/// `fw4-en 3.6.3`.
pub const FINGER_1_POWER: u8 = 0x62;
/// `fw4-en 3.6.4`.
pub const GET_FINGER_1_DATA: u8 = 0x63;
/// `fw4-en 3.6.5`.
pub const GET_FINGER_2_INFO: u8 = 0x70;
/// `fw4-en 3.6.6`.
pub const GET_FINGER_2_FLAGS: u8 = 0x71;
/// `fw4-en 3.6.7`.
pub const FINGER_2_POWER: u8 = 0x72;
/// `fw4-en 3.6.8`.
pub const GET_FINGER_2_DATA: u8 = 0x73;

/// Limit of Loop's data in bytes (`fw4-en 3.1.1`).
pub const MAX_LOOP_BYTES: usize = 256;

/// Limit in bytes of a finger's data frame, and of a custom command in either direction. The manuals give only the size
/// field's 65535. This lower limit bounds the memory of a decoder, and exceeds any script in use.
pub const MAX_OPAQUE_BYTES: usize = 4096;

/// Limit in bytes of fields that a later firmware may have added to a reply. It is small, so that a damaged size blinds
/// the decoder for a few frames at most.
pub const MAX_ADDED_BYTES: usize = 64;

/// Size in bytes of the status at the start of a reply.
pub const STATUS_BYTES: usize = 2;

/// Rule by which a device checks the length of a request's parameters, with the status for a violation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LengthRule {
    /// No parameters, otherwise `E_NO_PARAM_EXPECTED`.
    NoneExpected,
    /// Exactly this many bytes (possibly 0), otherwise `E_CMD_FORMAT_ERROR`.
    Exactly(usize),
    /// At most this many bytes, otherwise `E_CMD_FORMAT_ERROR`.
    AtMost(usize),
    /// Text (51h): length and characters have their own status codes.
    Text,
    /// Any bytes: 23h stops with any payload, and custom commands are opaque.
    Anything,
}

/// Allowed number of bytes after the status of a successful reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DataBytes {
    min: usize,
    max: usize,
    /// Whether a later firmware can have added fields behind the known ones.
    is_extensible: bool,
}

impl DataBytes {
    const fn exactly(bytes: usize) -> Self {
        Self { min: bytes, max: bytes, is_extensible: bytes > 0 }
    }

    const fn between(min: usize, max: usize) -> Self {
        Self { min, max, is_extensible: false }
    }

    /// Largest number of bytes.
    #[must_use]
    pub const fn max(self) -> usize {
        self.max
    }

    /// Largest number of bytes that is accepted, with fields that a later firmware has added.
    const fn max_extended(self) -> usize {
        if self.is_extensible { self.max + MAX_ADDED_BYTES } else { self.max }
    }

    /// Whether a reply can have `bytes` bytes of data.
    #[must_use]
    pub const fn allow(self, bytes: usize) -> bool {
        bytes >= self.min && bytes <= self.max
    }

    /// Whether a reply can have `bytes` bytes of data, if a later firmware has added fields behind the known ones.
    #[must_use]
    pub const fn allow_more(self, bytes: usize) -> bool {
        self.allow(bytes) || self.is_extensible && bytes > self.max && bytes <= self.max + MAX_ADDED_BYTES
    }
}

/// One command as the manuals describe it.
#[derive(Debug, Clone, Copy)]
pub struct Description {
    /// Command id.
    pub id: u8,
    /// Short name, as printed by `decode`.
    pub name: &'static str,
    /// Length rule for the request's parameters.
    pub parameters: LengthRule,
    /// Length rule for the data of a successful reply.
    pub data: DataBytes,
}

const fn row(id: u8, name: &'static str, parameters: LengthRule, data: DataBytes) -> Description {
    Description { id, name, parameters, data }
}

const NOTHING: DataBytes = DataBytes::exactly(0);
const FLOAT: DataBytes = DataBytes::exactly(4);
const NO_PARAMETERS: LengthRule = LengthRule::NoneExpected;
const UPDATES: LengthRule = LengthRule::Exactly(3);
/// Ruling: the size is at bytes 1 and 2 (fw4-de, and 70h in fw4-en), or at 2 and 3 of a 4-byte reply (60h in fw4-en).
const FINGER_INFO: DataBytes = DataBytes::between(3, 4);
const OPAQUE: DataBytes = DataBytes::between(0, MAX_OPAQUE_BYTES);

/// Every command of the manuals, sorted by id.
pub const COMMANDS: &[Description] = &[
    row(LOOP, "Loop", LengthRule::AtMost(MAX_LOOP_BYTES), DataBytes::between(0, MAX_LOOP_BYTES)),
    row(DISCONNECT_ANNOUNCEMENT, "DisconnectAnnouncement", NO_PARAMETERS, NOTHING),
    row(HOMING, "Homing", LengthRule::Exactly(1), NOTHING),
    row(PRE_POSITION, "PrePosition", LengthRule::Exactly(9), NOTHING),
    row(STOP, "Stop", NO_PARAMETERS, NOTHING),
    row(FAST_STOP, "FastStop", LengthRule::Anything, NOTHING),
    row(ACKNOWLEDGE_FAST_STOP, "AcknowledgeFastStop", LengthRule::Exactly(3), NOTHING),
    row(GRIP, "Grip", LengthRule::Exactly(8), NOTHING),
    row(RELEASE, "Release", LengthRule::Exactly(8), NOTHING),
    row(SET_ACCELERATION, "SetAcceleration", LengthRule::Exactly(4), NOTHING),
    row(GET_ACCELERATION, "GetAcceleration", NO_PARAMETERS, FLOAT),
    row(SET_FORCE_LIMIT, "SetForceLimit", LengthRule::Exactly(4), NOTHING),
    row(GET_FORCE_LIMIT, "GetForceLimit", NO_PARAMETERS, FLOAT),
    row(SET_SOFT_LIMITS, "SetSoftLimits", LengthRule::Exactly(8), NOTHING),
    row(GET_SOFT_LIMITS, "GetSoftLimits", NO_PARAMETERS, DataBytes::exactly(8)),
    row(CLEAR_SOFT_LIMITS, "ClearSoftLimits", NO_PARAMETERS, NOTHING),
    row(OVERDRIVE_MODE, "OverdriveMode", LengthRule::Exactly(1), NOTHING),
    row(TARE_FORCE_SENSOR, "TareForceSensor", NO_PARAMETERS, NOTHING),
    row(GET_SYSTEM_STATE, "GetSystemState", UPDATES, DataBytes::exactly(4)),
    row(GET_GRIPPER_STATE, "GetGripperState", UPDATES, DataBytes::exactly(1)),
    row(GET_STATISTICS, "GetStatistics", LengthRule::Exactly(1), DataBytes::exactly(8)),
    row(GET_WIDTH, "GetWidth", UPDATES, FLOAT),
    row(GET_SPEED, "GetSpeed", UPDATES, FLOAT),
    row(GET_FORCE, "GetForce", UPDATES, FLOAT),
    row(GET_TEMPERATURE, "GetTemperature", NO_PARAMETERS, DataBytes::exactly(2)),
    row(GET_SYSTEM_INFO, "GetSystemInfo", NO_PARAMETERS, DataBytes::exactly(8)),
    row(SET_DEVICE_TAG, "SetDeviceTag", LengthRule::Text, NOTHING),
    row(GET_DEVICE_TAG, "GetDeviceTag", NO_PARAMETERS, DataBytes::between(0, DeviceTag::MAX_BYTES)),
    row(GET_SYSTEM_LIMITS, "GetSystemLimits", NO_PARAMETERS, DataBytes::exactly(32)),
    row(GET_FINGER_1_INFO, "GetFinger1Info", LengthRule::Exactly(0), FINGER_INFO),
    row(GET_FINGER_1_FLAGS, "GetFinger1Flags", LengthRule::Exactly(0), DataBytes::exactly(2)),
    row(FINGER_1_POWER, "Finger1Power", LengthRule::Exactly(1), NOTHING),
    row(GET_FINGER_1_DATA, "GetFinger1Data", LengthRule::Exactly(0), OPAQUE),
    row(GET_FINGER_2_INFO, "GetFinger2Info", LengthRule::Exactly(0), FINGER_INFO),
    row(GET_FINGER_2_FLAGS, "GetFinger2Flags", LengthRule::Exactly(0), DataBytes::exactly(2)),
    row(FINGER_2_POWER, "Finger2Power", LengthRule::Exactly(1), NOTHING),
    row(GET_FINGER_2_DATA, "GetFinger2Data", LengthRule::Exactly(0), OPAQUE),
];

/// Returns the description of `id`, or `None` for a custom id.
#[must_use]
pub fn describe(id: u8) -> Option<&'static Description> {
    COMMANDS.binary_search_by_key(&id, |row| row.id).ok().map(|index| &COMMANDS[index])
}

/// Returns the short name of `id`, or `None` for a custom id.
#[must_use]
pub fn name(id: u8) -> Option<&'static str> {
    describe(id).map(|row| row.name)
}

/// Whether `id` moves the fingers: `E_CMD_PENDING` first, then the result (`fw4-en 1.3`).
#[must_use]
pub const fn is_motion(id: u8) -> bool {
    matches!(id, HOMING | PRE_POSITION | GRIP | RELEASE)
}

/// Whether no manual describes `id`, so that it belongs to a script on the device.
#[must_use]
pub fn is_custom(id: u8) -> bool {
    describe(id).is_none()
}

/// Whether `id` can move the fingers.
#[must_use]
pub fn is_motion_or_script(id: u8) -> bool {
    is_motion(id) || is_custom(id)
}

/// Whether `id` changes something on the gripper: it moves the fingers, sets a value or switches a finger's power.
#[must_use]
pub fn acts(id: u8) -> bool {
    is_motion_or_script(id)
        || matches!(
            id,
            SET_ACCELERATION
                | SET_FORCE_LIMIT
                | SET_SOFT_LIMITS
                | CLEAR_SOFT_LIMITS
                | OVERDRIVE_MODE
                | TARE_FORCE_SENSOR
                | FINGER_1_POWER
                | FINGER_2_POWER
        )
}

/// Whether `id` supports automatic updates (`fw4-en 3.4.1`).
#[must_use]
pub const fn has_updates(id: u8) -> bool {
    matches!(id, GET_SYSTEM_STATE | GET_GRIPPER_STATE | GET_WIDTH | GET_SPEED | GET_FORCE)
}

/// Largest payload in bytes of a reply to `id`: the limit for a [`Decoder`](super::Decoder) of replies.
#[must_use]
pub fn max_reply_bytes(id: u8) -> usize {
    STATUS_BYTES + describe(id).map_or(MAX_OPAQUE_BYTES, |row| row.data.max_extended())
}

/// Whether a reply to `id` with this payload has more bytes than the manuals say.
#[must_use]
pub fn is_longer_than_its_manual(id: u8, payload_bytes: usize) -> bool {
    describe(id).is_some_and(|row| payload_bytes > STATUS_BYTES + row.data.max)
}

/// Whether a reply to `id` contains anybody's bytes, so that they can look like frames.
#[must_use]
pub fn has_opaque_replies(id: u8) -> bool {
    matches!(id, LOOP | GET_FINGER_1_DATA | GET_FINGER_2_DATA) || is_custom(id)
}

/// Largest request payload in bytes that is kept. A longer one still gets a status.
#[must_use]
pub const fn max_request_bytes(_id: u8) -> usize {
    MAX_OPAQUE_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_table_is_sorted_and_complete() {
        assert!(COMMANDS.is_sorted_by_key(|row| row.id));
        assert_eq!(COMMANDS.len(), 37);
        assert_eq!(name(0x25), Some("Grip"));
        assert_eq!(name(0xB0), None);
    }

    #[test]
    fn ruling_statistics_have_id_42h_and_release_26h() {
        assert_eq!((GET_STATISTICS, RELEASE), (0x42, 0x26));
    }

    #[test]
    fn reply_size_limit_depends_on_id() {
        assert_eq!(max_reply_bytes(LOOP), 258);
        assert_eq!(max_reply_bytes(GET_GRIPPER_STATE), 3 + 64);
        assert_eq!(max_reply_bytes(GET_SYSTEM_LIMITS), 34 + 64);
        assert_eq!(max_reply_bytes(0xB0), 4098);
    }
}
