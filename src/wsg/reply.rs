//! Replies and automatic updates, which have one format: a status, and data after `E_SUCCESS` (`fw4-en 1.2.2`).

use super::command::finger_of;
use super::device::{
    DeviceTag, DeviceType, Finger, FingerFlags, FingerInfo, FingerType, Firmware, SoftLimits, Statistics, SystemInfo,
    SystemLimits,
};
use super::frame;
use super::id::{self, STATUS_BYTES};
use super::payload::PayloadReader;
use super::quantity::{Acceleration, Force, NotFinite, Speed, Width};
use super::state::{GripperState, SystemState};
use super::status::Status;

/// Payload of a reply.
#[derive(Debug, Clone, PartialEq)]
pub enum Reply {
    /// `E_SUCCESS` with its data.
    Success(Data),
    /// Any other status, including `E_CMD_PENDING`, without data.
    Status(Status),
}

/// Data of a successful reply.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "named after the commands that return them")]
pub enum Data {
    /// No data.
    None,
    Loop(Vec<u8>),
    Acceleration(Acceleration),
    ForceLimit(Force),
    SoftLimits(SoftLimits),
    SystemState(SystemState),
    GripperState(GripperState),
    Statistics(Statistics),
    Width(Width),
    Speed(Speed),
    Force(Force),
    Temperature(Temperature),
    SystemInfo(SystemInfo),
    DeviceTag(DeviceTag),
    SystemLimits(SystemLimits),
    FingerInfo(Finger, FingerInfo),
    FingerFlags(Finger, FingerFlags),
    FingerData(Finger, Vec<u8>),
    Custom(Vec<u8>),
}

/// A temperature in steps of 0.1 °C (`fw4-en 3.4.7`).
///
/// Ruling: the manuals' example FFF5h = -1.0 °C is wrong (FFF6h is; FFF5h is -1.1).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Temperature(pub i16);

impl Temperature {
    /// Temperature in °C.
    #[must_use]
    pub fn celsius(self) -> f32 {
        f32::from(self.0) / 10.0
    }
}

/// Reason why a payload with a correct checksum is not a valid reply. The checksum is weak, so sizes and values are
/// checked too.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum InvalidReply {
    /// The payload is too short for a status, or its data length does not match the id.
    #[error("reply to {id:02X}h has an invalid length of {bytes} bytes")]
    Size {
        /// Command id of the reply.
        id: u8,
        /// Payload size in bytes, including the status.
        bytes: usize,
    },
    /// A number is NaN or infinite.
    #[error("reply to {id:02X}h is invalid: {source}")]
    Number {
        /// Command id of the reply.
        id: u8,
        /// The rejected number.
        source: NotFinite,
    },
    /// A value is undefined or implausible.
    #[error("reply to {id:02X}h has an impossible value")]
    Value {
        /// Command id of the reply.
        id: u8,
    },
}

impl Reply {
    /// Status code of the reply.
    #[must_use]
    pub const fn status(&self) -> Status {
        match self {
            Self::Success(_) => Status::E_SUCCESS,
            Self::Status(status) => *status,
        }
    }

    /// Parses a frame's payload as a reply or an automatic update.
    ///
    /// # Errors
    /// [`InvalidReply`] if no device could send this size or these values.
    pub fn parse(id: u8, payload: &[u8]) -> Result<Self, InvalidReply> {
        let size = InvalidReply::Size { id, bytes: payload.len() };
        let (status, data) = payload.split_first_chunk::<STATUS_BYTES>().ok_or(size)?;
        let status = Status::from_code(u16::from_le_bytes(*status));
        let Some(description) = id::describe(id) else {
            return Ok(if status == Status::E_SUCCESS {
                Self::Success(Data::Custom(data.to_vec()))
            } else {
                Self::Status(status)
            });
        };
        if status != Status::E_SUCCESS {
            return if data.is_empty() { Ok(Self::Status(status)) } else { Err(size) };
        }
        if !description.data.allow_more(data.len()) {
            return Err(size);
        }
        let known = data.get(..description.data.max()).unwrap_or(data);
        Data::parse(id, known).map(Self::Success)
    }

    /// Appends the frame of the reply to command `id` to `out`.
    pub fn encode(&self, id: u8, out: &mut Vec<u8>) {
        frame::encode_with(id, out, |out| {
            out.extend_from_slice(&self.status().code().to_le_bytes());
            if let Self::Success(data) = self {
                data.write(out);
            }
        });
    }
}

impl Data {
    fn parse(id: u8, data: &[u8]) -> Result<Self, InvalidReply> {
        let mut fields = PayloadReader::new(data);
        let number = |source| InvalidReply::Number { id, source };
        let value = InvalidReply::Value { id };
        Ok(match id {
            id::LOOP => Self::Loop(data.to_vec()),
            id::GET_ACCELERATION => Self::Acceleration(Acceleration::new(fields.f32()).map_err(number)?),
            id::GET_FORCE_LIMIT => Self::ForceLimit(Force::new(fields.f32()).map_err(number)?),
            id::GET_SOFT_LIMITS => {
                let minus = Width::new(fields.f32()).map_err(number)?;
                let plus = Width::new(fields.f32()).map_err(number)?;
                Self::SoftLimits(SoftLimits::new(minus, plus).ok_or(value)?)
            }
            id::GET_SYSTEM_STATE => Self::SystemState(SystemState::from_bits_retain(fields.u32())),
            id::GET_GRIPPER_STATE => Self::GripperState(GripperState::from_code(fields.u8())),
            id::GET_STATISTICS => {
                Self::Statistics(Statistics { total: fields.u32(), no_part: fields.u16(), lost_part: fields.u16() })
            }
            id::GET_WIDTH => Self::Width(Width::new(fields.f32()).map_err(number)?),
            id::GET_SPEED => Self::Speed(Speed::new(fields.f32()).map_err(number)?),
            id::GET_FORCE => Self::Force(Force::new(fields.f32()).map_err(number)?),
            id::GET_TEMPERATURE => Self::Temperature(Temperature(fields.i16())),
            id::GET_SYSTEM_INFO => Self::SystemInfo(SystemInfo {
                device_type: DeviceType::from_code(fields.u8()),
                hardware_revision: fields.u8(),
                firmware: Firmware(fields.u16()),
                serial_number: fields.u32(),
            }),
            id::GET_DEVICE_TAG => Self::DeviceTag(DeviceTag::reported(data).map_err(|_| value)?),
            id::GET_SYSTEM_LIMITS => {
                let limits = read_limits(&mut fields).map_err(number)?;
                Self::SystemLimits(if limits.are_plausible() { limits } else { return Err(value) })
            }
            id::GET_FINGER_1_INFO | id::GET_FINGER_2_INFO => {
                let finger_type = FingerType::from_code(fields.u8());
                if data.len() == 4 {
                    fields.u8();
                }
                Self::FingerInfo(finger_of(id), FingerInfo { finger_type, data_bytes: fields.u16() })
            }
            id::GET_FINGER_1_FLAGS | id::GET_FINGER_2_FLAGS => {
                Self::FingerFlags(finger_of(id), FingerFlags::from_bits_retain(fields.u16()))
            }
            id::GET_FINGER_1_DATA | id::GET_FINGER_2_DATA => Self::FingerData(finger_of(id), fields.rest().to_vec()),
            _ => Self::None,
        })
    }

    /// Returns the data if a reply to `id` can carry data of this size, else [`Data::None`]. A setter's own reply has
    /// no data: its value was read back with another request.
    #[must_use]
    pub fn of_reply(self, id: u8) -> Self {
        let mut bytes = Vec::new();
        self.write(&mut bytes);
        let is_possible = id::describe(id).is_none_or(|description| description.data.allow(bytes.len()));
        if is_possible { self } else { Self::None }
    }

    /// Appends the bytes that follow the status.
    pub fn write(&self, out: &mut Vec<u8>) {
        match self {
            Self::None => {}
            Self::Loop(bytes) | Self::FingerData(_, bytes) | Self::Custom(bytes) => out.extend_from_slice(bytes),
            Self::Acceleration(acceleration) => out.extend_from_slice(&acceleration.mm_s2().to_le_bytes()),
            Self::ForceLimit(force) | Self::Force(force) => out.extend_from_slice(&force.n().to_le_bytes()),
            Self::SoftLimits(limits) => {
                out.extend_from_slice(&limits.minus().mm().to_le_bytes());
                out.extend_from_slice(&limits.plus().mm().to_le_bytes());
            }
            Self::SystemState(state) => out.extend_from_slice(&state.bits().to_le_bytes()),
            Self::GripperState(state) => out.push(state.code()),
            Self::Statistics(statistics) => {
                out.extend_from_slice(&statistics.total.to_le_bytes());
                out.extend_from_slice(&statistics.no_part.to_le_bytes());
                out.extend_from_slice(&statistics.lost_part.to_le_bytes());
            }
            Self::Width(width) => out.extend_from_slice(&width.mm().to_le_bytes()),
            Self::Speed(speed) => out.extend_from_slice(&speed.mm_s().to_le_bytes()),
            Self::Temperature(temperature) => out.extend_from_slice(&temperature.0.to_le_bytes()),
            Self::SystemInfo(info) => {
                out.extend_from_slice(&[info.device_type.code(), info.hardware_revision]);
                out.extend_from_slice(&info.firmware.0.to_le_bytes());
                out.extend_from_slice(&info.serial_number.to_le_bytes());
            }
            Self::DeviceTag(tag) => out.extend_from_slice(tag.as_bytes()),
            Self::SystemLimits(limits) => write_limits(limits, out),
            Self::FingerInfo(_, info) => {
                out.push(info.finger_type.code());
                out.extend_from_slice(&info.data_bytes.to_le_bytes());
            }
            Self::FingerFlags(_, flags) => out.extend_from_slice(&flags.bits().to_le_bytes()),
        }
    }
}

fn read_limits(fields: &mut PayloadReader<'_>) -> Result<SystemLimits, NotFinite> {
    Ok(SystemLimits {
        stroke: Width::new(fields.f32())?,
        min_speed: Speed::new(fields.f32())?,
        max_speed: Speed::new(fields.f32())?,
        min_acceleration: Acceleration::new(fields.f32())?,
        max_acceleration: Acceleration::new(fields.f32())?,
        min_force: Force::new(fields.f32())?,
        nominal_force: Force::new(fields.f32())?,
        overdrive_force: Force::new(fields.f32())?,
    })
}

fn write_limits(limits: &SystemLimits, out: &mut Vec<u8>) {
    let values = [
        limits.stroke.mm(),
        limits.min_speed.mm_s(),
        limits.max_speed.mm_s(),
        limits.min_acceleration.mm_s2(),
        limits.max_acceleration.mm_s2(),
        limits.min_force.n(),
        limits.nominal_force.n(),
        limits.overdrive_force.n(),
    ];
    for value in values {
        out.extend_from_slice(&value.to_le_bytes());
    }
}

#[cfg(test)]
#[path = "reply_tests.rs"]
mod tests;
