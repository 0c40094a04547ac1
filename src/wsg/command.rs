//! Requests: every command of the manuals as a type without invalid values, with encoding and parsing.

use super::device::{DeviceTag, Finger, InvalidDeviceTag, SoftLimits};
use super::frame;
use super::id::{self, LengthRule};
use super::payload::PayloadReader;
use super::quantity::{Acceleration, Force, NotFinite, Speed, Width};
use super::status::Status;

/// The direction of Homing (`fw4-en 3.2.1`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum HomingDirection {
    /// 0: the direction configured on the device.
    #[default]
    Default,
    /// 1: positive, to the outer end stop.
    Outer,
    /// 2: negative, to the inner end stop.
    Inner,
}

/// Flags of Pre-position Fingers (`fw4-en 3.2.2`); bits D2 to D7 are unused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub struct MoveFlags {
    /// D0: the width is relative to the current width.
    pub relative: bool,
    /// D1: stop on block if set, clamp on block otherwise.
    pub stop_on_block: bool,
}

/// Automatic updates of a getter (`fw4-en 3.4.1`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum Updates {
    /// D0 = 0: one immediate reply; switches automatic updates off.
    #[default]
    Off,
    /// D0 = 1: switches automatic updates on.
    On {
        /// D1: send an update only when the value has changed.
        on_change: bool,
        /// Requested interval in ms: shortest time between two updates. The device uses at least 10 ms (fw4).
        period_ms: u16,
    },
}

/// A request to a device.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "named as in the manual, section by section")]
pub enum Command {
    Loop(LoopData),
    DisconnectAnnouncement,
    Homing(HomingDirection),
    PrePosition { flags: MoveFlags, width: Width, speed: Speed },
    Stop,
    FastStop,
    AcknowledgeFastStop,
    Grip { width: Width, speed: Speed },
    Release { width: Width, speed: Speed },
    SetAcceleration(Acceleration),
    GetAcceleration,
    SetForceLimit(Force),
    GetForceLimit,
    SetSoftLimits(SoftLimits),
    GetSoftLimits,
    ClearSoftLimits,
    OverdriveMode { on: bool },
    TareForceSensor,
    GetSystemState(Updates),
    GetGripperState(Updates),
    GetStatistics { reset: bool },
    GetWidth(Updates),
    GetSpeed(Updates),
    GetForce(Updates),
    GetTemperature,
    GetSystemInfo,
    SetDeviceTag(DeviceTag),
    GetDeviceTag,
    GetSystemLimits,
    GetFingerInfo(Finger),
    GetFingerFlags(Finger),
    FingerPower { finger: Finger, on: bool },
    GetFingerData(Finger),
    Custom(CustomCommand),
    Verbatim(VerbatimCommand),
}

/// Data of a Loop command, at most 256 bytes (`fw4-en 3.1.1`).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LoopData(Vec<u8>);

impl LoopData {
    /// Wraps `bytes`, or returns `None` if they exceed [`id::MAX_LOOP_BYTES`].
    #[must_use]
    pub fn new(bytes: Vec<u8>) -> Option<Self> {
        (bytes.len() <= id::MAX_LOOP_BYTES).then_some(Self(bytes))
    }

    /// The bytes that the device echoes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }
}

/// A command of a script on the device: an id that the manuals do not list, with opaque bytes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CustomCommand {
    id: u8,
    payload: Vec<u8>,
}

impl CustomCommand {
    /// Builds the command. Returns `None` if the manuals list `id`, if `id` is AAh (indistinguishable from the
    /// preamble), or if the payload exceeds [`id::MAX_OPAQUE_BYTES`].
    #[must_use]
    pub fn new(id: u8, payload: Vec<u8>) -> Option<Self> {
        let possible = id::describe(id).is_none() && id != frame::PREAMBLE[0];
        (possible && payload.len() <= id::MAX_OPAQUE_BYTES).then_some(Self { id, payload })
    }

    /// Command id, as defined by the script.
    #[must_use]
    pub const fn id(&self) -> u8 {
        self.id
    }

    /// Opaque parameter bytes.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.payload
    }
}

/// A command of the manuals with the bytes that a client gave, valid or not, so that the device itself judges them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VerbatimCommand {
    id: u8,
    payload: Vec<u8>,
}

impl VerbatimCommand {
    /// Builds the command. Returns `None` if the manuals do not list `id`, if it moves, stops, acknowledges or
    /// disconnects, if its replies look like automatic updates, or if the payload exceeds [`id::MAX_OPAQUE_BYTES`].
    #[must_use]
    pub fn new(id: u8, payload: Vec<u8>) -> Option<Self> {
        let is_reserved =
            matches!(id, id::DISCONNECT_ANNOUNCEMENT | id::STOP | id::FAST_STOP | id::ACKNOWLEDGE_FAST_STOP);
        let possible = id::describe(id).is_some() && !is_reserved && !id::is_motion(id) && !id::has_updates(id);
        (possible && payload.len() <= id::MAX_OPAQUE_BYTES).then_some(Self { id, payload })
    }

    /// The bytes of its parameters.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.payload
    }
}

/// Reason why bytes are not a valid request.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum InvalidRequest {
    /// Parameters for a command without parameters, such as 07h or 22h.
    #[error("{0} takes no parameters, but {1} bytes were given")]
    NoParameterExpected(&'static str, usize),
    /// A wrong length, or a wrong acknowledge key.
    #[error("parameters of {0} have a wrong length or format ({1} bytes were given)")]
    Format(&'static str, usize),
    /// A parameter value that the command does not define.
    #[error("parameter of {0} has an undefined value")]
    Value(&'static str),
    /// A parameter that is NaN or infinite.
    #[error("parameter of {0} is invalid: {1}")]
    Number(&'static str, NotFinite),
    /// An invalid tag in Set Device Tag (51h).
    #[error(transparent)]
    Tag(#[from] InvalidDeviceTag),
    /// An id that no frame can carry (AAh), or more than [`id::MAX_OPAQUE_BYTES`] of payload.
    #[error("custom command {0:02X}h with {1} bytes cannot be sent: reserved id or too many bytes")]
    Custom(u8, usize),
}

impl InvalidRequest {
    /// Status with which a device replies to the invalid request.
    #[must_use]
    pub const fn status(self) -> Status {
        match self {
            Self::NoParameterExpected(..) => Status::E_NO_PARAM_EXPECTED,
            Self::Format(..) => Status::E_CMD_FORMAT_ERROR,
            Self::Value(_) | Self::Number(..) | Self::Tag(InvalidDeviceTag::IllegalCharacter) => {
                Status::E_INVALID_PARAMETER
            }
            Self::Tag(InvalidDeviceTag::TooLong) | Self::Custom(..) => Status::E_OVERRUN,
        }
    }
}

/// The key of Acknowledge FAST STOP (`fw4-en 3.2.5`).
const ACKNOWLEDGE_KEY: &[u8; 3] = b"ack";

impl Command {
    /// Command id (`fw4-en 3`).
    #[must_use]
    pub fn id(&self) -> u8 {
        match self {
            Self::Loop(_) => id::LOOP,
            Self::DisconnectAnnouncement => id::DISCONNECT_ANNOUNCEMENT,
            Self::Homing(_) => id::HOMING,
            Self::PrePosition { .. } => id::PRE_POSITION,
            Self::Stop => id::STOP,
            Self::FastStop => id::FAST_STOP,
            Self::AcknowledgeFastStop => id::ACKNOWLEDGE_FAST_STOP,
            Self::Grip { .. } => id::GRIP,
            Self::Release { .. } => id::RELEASE,
            Self::SetAcceleration(_) => id::SET_ACCELERATION,
            Self::GetAcceleration => id::GET_ACCELERATION,
            Self::SetForceLimit(_) => id::SET_FORCE_LIMIT,
            Self::GetForceLimit => id::GET_FORCE_LIMIT,
            Self::SetSoftLimits(_) => id::SET_SOFT_LIMITS,
            Self::GetSoftLimits => id::GET_SOFT_LIMITS,
            Self::ClearSoftLimits => id::CLEAR_SOFT_LIMITS,
            Self::OverdriveMode { .. } => id::OVERDRIVE_MODE,
            Self::TareForceSensor => id::TARE_FORCE_SENSOR,
            Self::GetSystemState(_) => id::GET_SYSTEM_STATE,
            Self::GetGripperState(_) => id::GET_GRIPPER_STATE,
            Self::GetStatistics { .. } => id::GET_STATISTICS,
            Self::GetWidth(_) => id::GET_WIDTH,
            Self::GetSpeed(_) => id::GET_SPEED,
            Self::GetForce(_) => id::GET_FORCE,
            Self::GetTemperature => id::GET_TEMPERATURE,
            Self::GetSystemInfo => id::GET_SYSTEM_INFO,
            Self::SetDeviceTag(_) => id::SET_DEVICE_TAG,
            Self::GetDeviceTag => id::GET_DEVICE_TAG,
            Self::GetSystemLimits => id::GET_SYSTEM_LIMITS,
            Self::GetFingerInfo(finger) => by_finger(*finger, id::GET_FINGER_1_INFO, id::GET_FINGER_2_INFO),
            Self::GetFingerFlags(finger) => by_finger(*finger, id::GET_FINGER_1_FLAGS, id::GET_FINGER_2_FLAGS),
            Self::FingerPower { finger, .. } => by_finger(*finger, id::FINGER_1_POWER, id::FINGER_2_POWER),
            Self::GetFingerData(finger) => by_finger(*finger, id::GET_FINGER_1_DATA, id::GET_FINGER_2_DATA),
            Self::Custom(custom) => custom.id,
            Self::Verbatim(verbatim) => verbatim.id,
        }
    }

    /// Whether the command moves the fingers.
    #[must_use]
    pub fn is_motion(&self) -> bool {
        id::is_motion(self.id())
    }

    /// Whether the command only reads, changing neither the gripper nor its settings.
    #[must_use]
    pub fn is_read(&self) -> bool {
        match self {
            Self::Loop(_)
            | Self::GetAcceleration
            | Self::GetForceLimit
            | Self::GetSoftLimits
            | Self::GetSystemState(_)
            | Self::GetGripperState(_)
            | Self::GetStatistics { reset: false }
            | Self::GetWidth(_)
            | Self::GetSpeed(_)
            | Self::GetForce(_)
            | Self::GetTemperature
            | Self::GetSystemInfo
            | Self::GetDeviceTag
            | Self::GetSystemLimits
            | Self::GetFingerInfo(_)
            | Self::GetFingerFlags(_)
            | Self::GetFingerData(_) => true,
            Self::DisconnectAnnouncement
            | Self::Homing(_)
            | Self::PrePosition { .. }
            | Self::Stop
            | Self::FastStop
            | Self::AcknowledgeFastStop
            | Self::Grip { .. }
            | Self::Release { .. }
            | Self::SetAcceleration(_)
            | Self::SetForceLimit(_)
            | Self::SetSoftLimits(_)
            | Self::ClearSoftLimits
            | Self::OverdriveMode { .. }
            | Self::TareForceSensor
            | Self::GetStatistics { reset: true }
            | Self::SetDeviceTag(_)
            | Self::FingerPower { .. }
            | Self::Custom(_)
            | Self::Verbatim(_) => false,
        }
    }

    /// Whether the first reply is `E_CMD_PENDING` and a second reply carries the result (`fw4-en 1.3`).
    #[must_use]
    pub fn is_two_step(&self) -> bool {
        self.is_motion() || matches!(self.typed(), Some(Self::FingerPower { on: true, .. }))
    }

    /// Whether the command switches a finger off.
    #[must_use]
    pub fn is_power_off(&self) -> bool {
        let is_power = matches!(self.id(), id::FINGER_1_POWER | id::FINGER_2_POWER);
        is_power && matches!(self.typed(), Some(Self::FingerPower { on: false, .. }))
    }

    /// Returns the command with its parameters parsed; `None` if they are not valid.
    #[must_use]
    pub fn typed(&self) -> Option<Self> {
        match self {
            Self::Verbatim(VerbatimCommand { id, payload }) => Self::parse(*id, payload).ok(),
            command => Some(command.clone()),
        }
    }

    /// Appends the encoded parameters to `out`.
    pub fn write_payload(&self, out: &mut Vec<u8>) {
        match self {
            Self::Loop(LoopData(bytes)) => out.extend_from_slice(bytes),
            Self::Homing(direction) => out.push(*direction as u8),
            Self::PrePosition { flags, width, speed } => {
                out.push(u8::from(flags.relative) | u8::from(flags.stop_on_block) << 1);
                write_floats(out, &[width.mm(), speed.mm_s()]);
            }
            Self::AcknowledgeFastStop => out.extend_from_slice(ACKNOWLEDGE_KEY),
            Self::Grip { width, speed } | Self::Release { width, speed } => {
                write_floats(out, &[width.mm(), speed.mm_s()]);
            }
            Self::SetAcceleration(acceleration) => write_floats(out, &[acceleration.mm_s2()]),
            Self::SetForceLimit(force) => write_floats(out, &[force.n()]),
            Self::SetSoftLimits(limits) => write_floats(out, &[limits.minus().mm(), limits.plus().mm()]),
            Self::OverdriveMode { on } | Self::FingerPower { on, .. } | Self::GetStatistics { reset: on } => {
                out.push(u8::from(*on));
            }
            Self::GetSystemState(updates)
            | Self::GetGripperState(updates)
            | Self::GetWidth(updates)
            | Self::GetSpeed(updates)
            | Self::GetForce(updates) => updates.write(out),
            Self::SetDeviceTag(tag) => out.extend_from_slice(tag.as_bytes()),
            Self::Custom(custom) => out.extend_from_slice(&custom.payload),
            Self::Verbatim(verbatim) => out.extend_from_slice(&verbatim.payload),
            _ => {}
        }
    }

    /// Appends the whole frame to `out`.
    pub fn encode(&self, out: &mut Vec<u8>) {
        frame::encode_with(self.id(), out, |out| self.write_payload(out));
    }

    /// Parses a frame's payload as a request. An id that the manuals do not list gives [`Command::Custom`].
    ///
    /// # Errors
    /// [`InvalidRequest`]; its [`status`](InvalidRequest::status) is the device's reply.
    pub fn parse(id: u8, payload: &[u8]) -> Result<Self, InvalidRequest> {
        let Some(description) = id::describe(id) else {
            let custom = CustomCommand::new(id, payload.to_vec());
            return custom.map(Self::Custom).ok_or(InvalidRequest::Custom(id, payload.len()));
        };
        let name = description.name;
        check_length(name, description.parameters, payload.len())?;
        Self::parse_parameters(id, name, payload)
    }

    /// Parses a request whose payload of more than [`id::MAX_OPAQUE_BYTES`] was not kept. Only a FAST STOP has no
    /// limit.
    ///
    /// # Errors
    /// [`InvalidRequest`]; its [`status`](InvalidRequest::status) is the device's reply.
    pub fn parse_too_long(id: u8, payload_bytes: usize) -> Result<Self, InvalidRequest> {
        let Some(description) = id::describe(id) else { return Err(InvalidRequest::Custom(id, payload_bytes)) };
        check_length(description.name, description.parameters, payload_bytes)?;
        match description.parameters {
            LengthRule::Text => Err(InvalidDeviceTag::TooLong.into()),
            _ if id == id::FAST_STOP => Ok(Self::FastStop),
            _ => Err(InvalidRequest::Format(description.name, payload_bytes)),
        }
    }

    fn parse_parameters(id: u8, name: &'static str, payload: &[u8]) -> Result<Self, InvalidRequest> {
        let mut fields = PayloadReader::new(payload);
        let number = |error| InvalidRequest::Number(name, error);
        Ok(match id {
            id::LOOP => Self::Loop(LoopData(payload.to_vec())),
            id::DISCONNECT_ANNOUNCEMENT => Self::DisconnectAnnouncement,
            id::HOMING => Self::Homing(match fields.u8() {
                0 => HomingDirection::Default,
                1 => HomingDirection::Outer,
                2 => HomingDirection::Inner,
                _ => return Err(InvalidRequest::Value(name)),
            }),
            id::PRE_POSITION => {
                let flags = fields.u8();
                let flags = MoveFlags { relative: flags & 1 != 0, stop_on_block: flags & 2 != 0 };
                let (width, speed) = fields.width_and_speed().map_err(number)?;
                Self::PrePosition { flags, width, speed }
            }
            id::STOP => Self::Stop,
            id::FAST_STOP => Self::FastStop,
            id::ACKNOWLEDGE_FAST_STOP if payload == ACKNOWLEDGE_KEY => Self::AcknowledgeFastStop,
            id::ACKNOWLEDGE_FAST_STOP => return Err(InvalidRequest::Format(name, payload.len())),
            id::GRIP => {
                let (width, speed) = fields.width_and_speed().map_err(number)?;
                Self::Grip { width, speed }
            }
            id::RELEASE => {
                let (width, speed) = fields.width_and_speed().map_err(number)?;
                Self::Release { width, speed }
            }
            id::SET_ACCELERATION => Self::SetAcceleration(Acceleration::new(fields.f32()).map_err(number)?),
            id::GET_ACCELERATION => Self::GetAcceleration,
            id::SET_FORCE_LIMIT => Self::SetForceLimit(Force::new(fields.f32()).map_err(number)?),
            id::GET_FORCE_LIMIT => Self::GetForceLimit,
            id::SET_SOFT_LIMITS => {
                let minus = Width::new(fields.f32()).map_err(number)?;
                let plus = Width::new(fields.f32()).map_err(number)?;
                Self::SetSoftLimits(SoftLimits::new(minus, plus).ok_or(InvalidRequest::Value(name))?)
            }
            id::GET_SOFT_LIMITS => Self::GetSoftLimits,
            id::CLEAR_SOFT_LIMITS => Self::ClearSoftLimits,
            id::OVERDRIVE_MODE => Self::OverdriveMode { on: fields.u8() & 1 != 0 },
            id::TARE_FORCE_SENSOR => Self::TareForceSensor,
            id::GET_SYSTEM_STATE => Self::GetSystemState(Updates::read(&mut fields)),
            id::GET_GRIPPER_STATE => Self::GetGripperState(Updates::read(&mut fields)),
            id::GET_STATISTICS => Self::GetStatistics { reset: fields.u8() & 1 != 0 },
            id::GET_WIDTH => Self::GetWidth(Updates::read(&mut fields)),
            id::GET_SPEED => Self::GetSpeed(Updates::read(&mut fields)),
            id::GET_FORCE => Self::GetForce(Updates::read(&mut fields)),
            id::GET_TEMPERATURE => Self::GetTemperature,
            id::GET_SYSTEM_INFO => Self::GetSystemInfo,
            id::SET_DEVICE_TAG => Self::SetDeviceTag(DeviceTag::new(payload)?),
            id::GET_DEVICE_TAG => Self::GetDeviceTag,
            id::GET_SYSTEM_LIMITS => Self::GetSystemLimits,
            id::GET_FINGER_1_INFO | id::GET_FINGER_2_INFO => Self::GetFingerInfo(finger_of(id)),
            id::GET_FINGER_1_FLAGS | id::GET_FINGER_2_FLAGS => Self::GetFingerFlags(finger_of(id)),
            // Ruling: the parameter is byte 0, although fw4-en 3.6.3 calls it byte 1.
            id::FINGER_1_POWER | id::FINGER_2_POWER => match fields.u8() {
                on @ (0 | 1) => Self::FingerPower { finger: finger_of(id), on: on == 1 },
                _ => return Err(InvalidRequest::Value(name)),
            },
            id::GET_FINGER_1_DATA | id::GET_FINGER_2_DATA => Self::GetFingerData(finger_of(id)),
            _ => return Err(InvalidRequest::Custom(id, payload.len())),
        })
    }
}

fn check_length(name: &'static str, rule: LengthRule, bytes: usize) -> Result<(), InvalidRequest> {
    let is_right = match rule {
        LengthRule::NoneExpected if bytes > 0 => return Err(InvalidRequest::NoParameterExpected(name, bytes)),
        LengthRule::Exactly(exactly) => bytes == exactly,
        LengthRule::AtMost(most) => bytes <= most,
        LengthRule::NoneExpected | LengthRule::Text | LengthRule::Anything => true,
    };
    if is_right { Ok(()) } else { Err(InvalidRequest::Format(name, bytes)) }
}

impl Updates {
    fn write(self, out: &mut Vec<u8>) {
        let (flags, period_ms) = match self {
            Self::Off => (0, 0),
            Self::On { on_change, period_ms } => (1 | u8::from(on_change) << 1, period_ms),
        };
        out.push(flags);
        out.extend_from_slice(&period_ms.to_le_bytes());
    }

    fn read(fields: &mut PayloadReader<'_>) -> Self {
        let flags = fields.u8();
        let period_ms = fields.u16();
        if flags & 1 == 0 { Self::Off } else { Self::On { on_change: flags & 2 != 0, period_ms } }
    }
}

fn by_finger(finger: Finger, one: u8, two: u8) -> u8 {
    match finger {
        Finger::One => one,
        Finger::Two => two,
    }
}

/// Ids 60h to 63h address the first finger, 70h to 73h the second.
pub(super) fn finger_of(id: u8) -> Finger {
    if id < id::GET_FINGER_2_INFO { Finger::One } else { Finger::Two }
}

fn write_floats(out: &mut Vec<u8>, values: &[f32]) {
    for value in values {
        out.extend_from_slice(&value.to_le_bytes());
    }
}

#[cfg(test)]
#[path = "command_tests.rs"]
pub(super) mod tests;
