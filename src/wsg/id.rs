//! The ids of the command set (`fw4-en 3`), their names, and the sizes that each id's payloads can have.

use super::device::DeviceTag;

/// 3.1.1
pub const LOOP: u8 = 0x06;
/// 3.1.2
pub const DISCONNECT_ANNOUNCEMENT: u8 = 0x07;
/// 3.2.1
pub const HOMING: u8 = 0x20;
/// 3.2.2
pub const PRE_POSITION: u8 = 0x21;
/// 3.2.3
pub const STOP: u8 = 0x22;
/// 3.2.4
pub const FAST_STOP: u8 = 0x23;
/// 3.2.5
pub const ACKNOWLEDGE_FAST_STOP: u8 = 0x24;
/// 3.2.6
pub const GRIP: u8 = 0x25;
/// 3.2.7. fw4-de calls it "(42h)" in one place: a misprint.
pub const RELEASE: u8 = 0x26;
/// 3.3.1
pub const SET_ACCELERATION: u8 = 0x30;
/// 3.3.2
pub const GET_ACCELERATION: u8 = 0x31;
/// 3.3.3
pub const SET_FORCE_LIMIT: u8 = 0x32;
/// 3.3.4
pub const GET_FORCE_LIMIT: u8 = 0x33;
/// 3.3.5
pub const SET_SOFT_LIMITS: u8 = 0x34;
/// 3.3.6
pub const GET_SOFT_LIMITS: u8 = 0x35;
/// 3.3.7
pub const CLEAR_SOFT_LIMITS: u8 = 0x36;
/// 3.3.8
pub const OVERDRIVE_MODE: u8 = 0x37;
/// 3.3.9
pub const TARE_FORCE_SENSOR: u8 = 0x38;
/// 3.4.1
pub const GET_SYSTEM_STATE: u8 = 0x40;
/// 3.4.2
pub const GET_GRIPPER_STATE: u8 = 0x41;
/// 3.4.3. Ruling: 42h; the line "Command ID: 40h" in all three manuals is a misprint.
pub const GET_STATISTICS: u8 = 0x42;
/// 3.4.4
pub const GET_WIDTH: u8 = 0x43;
/// 3.4.5
pub const GET_SPEED: u8 = 0x44;
/// 3.4.6
pub const GET_FORCE: u8 = 0x45;
/// 3.4.7, fw4 only
pub const GET_TEMPERATURE: u8 = 0x46;
/// 3.5.1
pub const GET_SYSTEM_INFO: u8 = 0x50;
/// 3.5.2
pub const SET_DEVICE_TAG: u8 = 0x51;
/// 3.5.3
pub const GET_DEVICE_TAG: u8 = 0x52;
/// 3.5.4
pub const GET_SYSTEM_LIMITS: u8 = 0x53;
/// 3.6.1, fw4 only, as all of the finger interface
pub const GET_FINGER_1_INFO: u8 = 0x60;
/// 3.6.2
pub const GET_FINGER_1_FLAGS: u8 = 0x61;
/// 3.6.3
pub const FINGER_1_POWER: u8 = 0x62;
/// 3.6.4
pub const GET_FINGER_1_DATA: u8 = 0x63;
/// 3.6.5
pub const GET_FINGER_2_INFO: u8 = 0x70;
/// 3.6.6
pub const GET_FINGER_2_FLAGS: u8 = 0x71;
/// 3.6.7
pub const FINGER_2_POWER: u8 = 0x72;
/// 3.6.8
pub const GET_FINGER_2_DATA: u8 = 0x73;

/// The most bytes that Loop takes (`fw4-en 3.1.1`).
pub const MAX_LOOP_BYTES: usize = 256;

/// The most bytes of a finger's data frame, or of a custom command in either direction. The manuals give no limit but
/// the size field's 65535; ours keeps a false header from blinding the decoder, and is far above any script in use.
pub const MAX_OPAQUE_BYTES: usize = 4096;

/// The bytes of a reply's status.
pub const STATUS_BYTES: usize = 2;

/// How a device checks the length of a request's parameters, and what it answers to a wrong one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameters {
    /// None, else `E_NO_PARAM_EXPECTED`.
    NoneExpected,
    /// Exactly this many bytes (which can be 0), else `E_CMD_FORMAT_ERROR`.
    Exactly(usize),
    /// At most this many, else `E_CMD_FORMAT_ERROR`.
    AtMost(usize),
    /// Text, whose length and characters have codes of their own (51h).
    Text,
    /// Anything: 23h stops whatever its payload, and custom commands are opaque.
    Anything,
}

/// The bytes after the status of a successful reply.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DataBytes {
    min: usize,
    max: usize,
}

impl DataBytes {
    const fn exactly(bytes: usize) -> Self {
        Self { min: bytes, max: bytes }
    }

    const fn between(min: usize, max: usize) -> Self {
        Self { min, max }
    }

    /// Whether a reply with so many bytes of data is possible.
    #[must_use]
    pub const fn allow(self, bytes: usize) -> bool {
        bytes >= self.min && bytes <= self.max
    }
}

/// What the manuals say of one id.
#[derive(Debug, Clone, Copy)]
pub struct Description {
    /// The id.
    pub id: u8,
    /// A short name, as `decode` prints it.
    pub name: &'static str,
    /// The request's parameters.
    pub parameters: Parameters,
    /// The successful reply's data.
    pub data: DataBytes,
}

const fn row(id: u8, name: &'static str, parameters: Parameters, data: DataBytes) -> Description {
    Description { id, name, parameters, data }
}

const NOTHING: DataBytes = DataBytes::exactly(0);
const FLOAT: DataBytes = DataBytes::exactly(4);
const NO_PARAMETERS: Parameters = Parameters::NoneExpected;
const UPDATES: Parameters = Parameters::Exactly(3);
/// Ruling: size at bytes 1..2 (fw4-de, and 70h in fw4-en); a 4-byte answer has it at 2..3 (60h in fw4-en).
const FINGER_INFO: DataBytes = DataBytes::between(3, 4);
const OPAQUE: DataBytes = DataBytes::between(0, MAX_OPAQUE_BYTES);

/// Every command of the manuals, by id.
pub const COMMANDS: &[Description] = &[
    row(LOOP, "Loop", Parameters::AtMost(MAX_LOOP_BYTES), DataBytes::between(0, MAX_LOOP_BYTES)),
    row(DISCONNECT_ANNOUNCEMENT, "DisconnectAnnouncement", NO_PARAMETERS, NOTHING),
    row(HOMING, "Homing", Parameters::Exactly(1), NOTHING),
    row(PRE_POSITION, "PrePosition", Parameters::Exactly(9), NOTHING),
    row(STOP, "Stop", NO_PARAMETERS, NOTHING),
    row(FAST_STOP, "FastStop", Parameters::Anything, NOTHING),
    row(ACKNOWLEDGE_FAST_STOP, "AcknowledgeFastStop", Parameters::Exactly(3), NOTHING),
    row(GRIP, "Grip", Parameters::Exactly(8), NOTHING),
    row(RELEASE, "Release", Parameters::Exactly(8), NOTHING),
    row(SET_ACCELERATION, "SetAcceleration", Parameters::Exactly(4), NOTHING),
    row(GET_ACCELERATION, "GetAcceleration", NO_PARAMETERS, FLOAT),
    row(SET_FORCE_LIMIT, "SetForceLimit", Parameters::Exactly(4), NOTHING),
    row(GET_FORCE_LIMIT, "GetForceLimit", NO_PARAMETERS, FLOAT),
    row(SET_SOFT_LIMITS, "SetSoftLimits", Parameters::Exactly(8), NOTHING),
    row(GET_SOFT_LIMITS, "GetSoftLimits", NO_PARAMETERS, DataBytes::exactly(8)),
    row(CLEAR_SOFT_LIMITS, "ClearSoftLimits", NO_PARAMETERS, NOTHING),
    row(OVERDRIVE_MODE, "OverdriveMode", Parameters::Exactly(1), NOTHING),
    row(TARE_FORCE_SENSOR, "TareForceSensor", NO_PARAMETERS, NOTHING),
    row(GET_SYSTEM_STATE, "GetSystemState", UPDATES, DataBytes::exactly(4)),
    row(GET_GRIPPER_STATE, "GetGripperState", UPDATES, DataBytes::exactly(1)),
    row(GET_STATISTICS, "GetStatistics", Parameters::Exactly(1), DataBytes::exactly(8)),
    row(GET_WIDTH, "GetWidth", UPDATES, FLOAT),
    row(GET_SPEED, "GetSpeed", UPDATES, FLOAT),
    row(GET_FORCE, "GetForce", UPDATES, FLOAT),
    row(GET_TEMPERATURE, "GetTemperature", NO_PARAMETERS, DataBytes::exactly(2)),
    row(GET_SYSTEM_INFO, "GetSystemInfo", NO_PARAMETERS, DataBytes::exactly(8)),
    row(SET_DEVICE_TAG, "SetDeviceTag", Parameters::Text, NOTHING),
    row(GET_DEVICE_TAG, "GetDeviceTag", NO_PARAMETERS, DataBytes::between(0, DeviceTag::MAX_BYTES)),
    row(GET_SYSTEM_LIMITS, "GetSystemLimits", NO_PARAMETERS, DataBytes::exactly(32)),
    row(GET_FINGER_1_INFO, "GetFinger1Info", Parameters::Exactly(0), FINGER_INFO),
    row(GET_FINGER_1_FLAGS, "GetFinger1Flags", Parameters::Exactly(0), DataBytes::exactly(2)),
    row(FINGER_1_POWER, "Finger1Power", Parameters::Exactly(1), NOTHING),
    row(GET_FINGER_1_DATA, "GetFinger1Data", Parameters::Exactly(0), OPAQUE),
    row(GET_FINGER_2_INFO, "GetFinger2Info", Parameters::Exactly(0), FINGER_INFO),
    row(GET_FINGER_2_FLAGS, "GetFinger2Flags", Parameters::Exactly(0), DataBytes::exactly(2)),
    row(FINGER_2_POWER, "Finger2Power", Parameters::Exactly(1), NOTHING),
    row(GET_FINGER_2_DATA, "GetFinger2Data", Parameters::Exactly(0), OPAQUE),
];

/// What the manuals say of `id`, or `None` for a custom one.
#[must_use]
pub fn describe(id: u8) -> Option<&'static Description> {
    COMMANDS.binary_search_by_key(&id, |row| row.id).ok().map(|index| &COMMANDS[index])
}

/// The short name of `id`, or `None` for a custom one.
#[must_use]
pub fn name(id: u8) -> Option<&'static str> {
    describe(id).map(|row| row.name)
}

/// Whether its first reply is `E_CMD_PENDING` and its result follows, when it moves the fingers (`fw4-en 1.3`).
#[must_use]
pub const fn is_motion(id: u8) -> bool {
    matches!(id, HOMING | PRE_POSITION | GRIP | RELEASE)
}

/// Whether it can send automatic updates (`fw4-en 3.4.1`).
#[must_use]
pub const fn has_updates(id: u8) -> bool {
    matches!(id, GET_SYSTEM_STATE | GET_GRIPPER_STATE | GET_WIDTH | GET_SPEED | GET_FORCE)
}

/// The largest payload that a reply of `id` can have: what a [`Decoder`](super::Decoder) of replies takes.
#[must_use]
pub fn max_reply_bytes(id: u8) -> usize {
    STATUS_BYTES + describe(id).map_or(MAX_OPAQUE_BYTES, |row| row.data.max)
}

/// The largest payload of a request that is read to its end: a longer one than the command takes has to be answered
/// with a status, so it has to be read first.
#[must_use]
pub const fn max_request_bytes(_id: u8) -> usize {
    MAX_OPAQUE_BYTES
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_in_order_of_ids_and_complete() {
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
    fn a_reply_is_no_larger_than_its_id_allows() {
        assert_eq!(max_reply_bytes(LOOP), 258);
        assert_eq!(max_reply_bytes(GET_GRIPPER_STATE), 3);
        assert_eq!(max_reply_bytes(GET_SYSTEM_LIMITS), 34);
        assert_eq!(max_reply_bytes(0xB0), 4098);
    }
}
