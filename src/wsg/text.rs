//! Text form of frames, one line each: `Grip width=20 speed=50`.
//!
//! A custom command is written as its id and its bytes: `0xB0 0x20 150.0f "text"`, as in the command editor of the WSG
//! Commander (`fw4-en 2`). Bytes are decimal or hexadecimal, floats end in `f`, and texts are quoted.

use std::fmt;
use std::str::FromStr;

use super::command::{Command, CustomCommand, HomingDirection, LoopData, MoveFlags, Updates};
use super::device::{DeviceTag, Finger, SoftLimits};
use super::id;
use super::quantity::{Acceleration, Force, Speed, Width};
use super::reply::{Data, Reply};

/// Reason why a text is not a valid request.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidText {
    /// The first word is neither a command name nor a number.
    #[error("unknown command {0:?}: write a name as in `Grip width=20 speed=50`, or an id as in `0xB0`")]
    UnknownCommand(String),
    /// The command does not have this field.
    #[error("{command} has no field {field:?}")]
    UnknownField {
        /// Name of the command.
        command: String,
        /// Name of the unknown field.
        field: String,
    },
    /// A required field is missing.
    #[error("{command} needs {field}=…")]
    MissingField {
        /// Name of the command.
        command: String,
        /// Name of the missing field.
        field: &'static str,
    },
    /// A value has the wrong format.
    #[error("{field}={value} is invalid: expected {expected}")]
    Value {
        /// Name of the field.
        field: String,
        /// The rejected value.
        value: String,
        /// Description of valid values.
        expected: &'static str,
    },
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match id::name(self.id()) {
            Some(name) => f.write_str(name)?,
            None => write!(f, "0x{:02X}", self.id())?,
        }
        match self {
            Self::Loop(data) => write!(f, " data={}", hex::encode(data.as_bytes())),
            Self::Homing(direction) => f.write_str(match direction {
                HomingDirection::Default => " direction=default",
                HomingDirection::Outer => " direction=outer",
                HomingDirection::Inner => " direction=inner",
            }),
            Self::PrePosition { flags, width, speed } => write!(
                f,
                " width={} speed={} relative={} stop_on_block={}",
                width.mm(),
                speed.mm_s(),
                flags.relative,
                flags.stop_on_block
            ),
            Self::Grip { width, speed } | Self::Release { width, speed } => {
                write!(f, " width={} speed={}", width.mm(), speed.mm_s())
            }
            Self::SetAcceleration(acceleration) => write!(f, " acceleration={}", acceleration.mm_s2()),
            Self::SetForceLimit(force) => write!(f, " force={}", force.n()),
            Self::SetSoftLimits(limits) => write!(f, " minus={} plus={}", limits.minus().mm(), limits.plus().mm()),
            Self::OverdriveMode { on } | Self::FingerPower { on, .. } => write!(f, " on={on}"),
            Self::GetStatistics { reset } => write!(f, " reset={reset}"),
            Self::GetSystemState(updates)
            | Self::GetGripperState(updates)
            | Self::GetWidth(updates)
            | Self::GetSpeed(updates)
            | Self::GetForce(updates) => match updates {
                Updates::Off => Ok(()),
                Updates::On { on_change, period_ms } => write!(f, " period_ms={period_ms} on_change={on_change}"),
            },
            Self::SetDeviceTag(tag) => write!(f, " tag={:?}", tag.text()),
            Self::Custom(custom) => write_bytes(f, custom.payload()),
            Self::Verbatim(verbatim) => write_bytes(f, verbatim.payload()),
            _ => Ok(()),
        }
    }
}

fn write_bytes(f: &mut fmt::Formatter<'_>, bytes: &[u8]) -> fmt::Result {
    bytes.iter().try_for_each(|byte| write!(f, " 0x{byte:02X}"))
}

impl fmt::Display for Reply {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.status())?;
        let Self::Success(data) = self else { return Ok(()) };
        match data {
            Data::None => Ok(()),
            Data::Loop(bytes) | Data::FingerData(_, bytes) | Data::Custom(bytes) => {
                write!(f, " data={}", hex::encode(bytes))
            }
            Data::Acceleration(acceleration) => write!(f, " acceleration={}", acceleration.mm_s2()),
            Data::ForceLimit(force) | Data::Force(force) => write!(f, " force={}", force.n()),
            Data::SoftLimits(limits) => write!(f, " minus={} plus={}", limits.minus().mm(), limits.plus().mm()),
            Data::SystemState(state) => {
                let mut names = String::new();
                for name in state.names() {
                    names.push_str(if names.is_empty() { "" } else { "," });
                    names.push_str(name);
                }
                write!(f, " flags=0x{:08X} {names}", state.bits())
            }
            Data::GripperState(state) => write!(f, " state={} {}", state.code(), state.name()),
            Data::Statistics(statistics) => write!(
                f,
                " total={} no_part={} lost_part={}",
                statistics.total, statistics.no_part, statistics.lost_part
            ),
            Data::Width(width) => write!(f, " width={}", width.mm()),
            Data::Speed(speed) => write!(f, " speed={}", speed.mm_s()),
            Data::Temperature(temperature) => write!(f, " temperature={}", temperature.celsius()),
            Data::SystemInfo(info) => write!(
                f,
                " type={:?} hardware_revision={} firmware={} serial_number={}",
                info.device_type.to_string(),
                info.hardware_revision,
                info.firmware,
                info.serial_number
            ),
            Data::DeviceTag(tag) => write!(f, " tag={:?}", tag.text()),
            Data::SystemLimits(limits) => write!(
                f,
                " stroke={} speed={}..{} acceleration={}..{} force={}..{}..{}",
                limits.stroke.mm(),
                limits.min_speed.mm_s(),
                limits.max_speed.mm_s(),
                limits.min_acceleration.mm_s2(),
                limits.max_acceleration.mm_s2(),
                limits.min_force.n(),
                limits.nominal_force.n(),
                limits.overdrive_force.n()
            ),
            Data::FingerInfo(_, info) => {
                write!(f, " type={:?} data_bytes={}", info.finger_type.to_string(), info.data_bytes)
            }
            Data::FingerFlags(_, flags) => {
                write!(f, " flags=0x{:04X}", flags.bits())?;
                flags.names().try_for_each(|name| write!(f, " {name}"))
            }
        }
    }
}

impl FromStr for Command {
    type Err = InvalidText;

    fn from_str(text: &str) -> Result<Self, InvalidText> {
        let words = words(text);
        let (name, arguments) = words.split_first().ok_or_else(|| InvalidText::UnknownCommand(String::new()))?;
        let known = id::COMMANDS.iter().find(|row| row.name.eq_ignore_ascii_case(name));
        match known {
            Some(row) => Fields::parse(row.name, arguments)?.into_command(row.id),
            None => custom(name, arguments),
        }
    }
}

/// Splits text at whitespace, except within quotes.
fn words(text: &str) -> Vec<String> {
    let mut words = Vec::new();
    let mut word = String::new();
    let mut is_quoted = false;
    for character in text.chars() {
        is_quoted ^= character == '"';
        if character.is_whitespace() && !is_quoted {
            words.extend((!word.is_empty()).then(|| std::mem::take(&mut word)));
        } else {
            word.push(character);
        }
    }
    words.extend((!word.is_empty()).then_some(word));
    words
}

fn custom(name: &str, arguments: &[String]) -> Result<Command, InvalidText> {
    let id = byte(name).ok_or_else(|| InvalidText::UnknownCommand(name.to_owned()))?;
    let mut payload = Vec::new();
    for argument in arguments {
        let float = argument.strip_suffix('f').filter(|_| !argument.starts_with("0x"));
        if let Some(text) = argument.strip_prefix('"') {
            payload.extend_from_slice(text.trim_end_matches('"').as_bytes());
        } else if let Some(float) = float.and_then(|float| float.parse::<f32>().ok()) {
            payload.extend_from_slice(&float.to_le_bytes());
        } else {
            let expected = "a byte (32 or 0x20), a float (150.0f) or a text in quotes";
            payload.push(byte(argument).ok_or_else(|| wrong("payload", argument, expected))?);
        }
    }
    match CustomCommand::new(id, payload.clone()) {
        Some(custom) => Ok(Command::Custom(custom)),
        None => Command::parse(id, &payload).map_err(|_| InvalidText::Value {
            field: "payload".to_owned(),
            value: hex::encode(&payload),
            expected: "a payload that the manuals define for this id",
        }),
    }
}

fn byte(text: &str) -> Option<u8> {
    match text.strip_prefix("0x") {
        Some(digits) => u8::from_str_radix(digits, 16).ok(),
        None => text.parse().ok(),
    }
}

/// `name=value` pairs, removed one by one.
struct Fields {
    command: &'static str,
    pairs: Vec<(String, String)>,
}

impl Fields {
    fn parse(command: &'static str, arguments: &[String]) -> Result<Self, InvalidText> {
        let mut pairs = Vec::new();
        for argument in arguments {
            let Some((field, value)) = argument.split_once('=') else {
                return Err(InvalidText::UnknownField { command: command.to_owned(), field: argument.clone() });
            };
            pairs.push((field.to_owned(), value.trim_matches('"').to_owned()));
        }
        Ok(Self { command, pairs })
    }

    fn optional(&mut self, field: &'static str) -> Option<String> {
        let index = self.pairs.iter().position(|(name, _)| name == field)?;
        Some(self.pairs.remove(index).1)
    }

    fn required(&mut self, field: &'static str) -> Result<String, InvalidText> {
        self.optional(field).ok_or(InvalidText::MissingField { command: self.command.to_owned(), field })
    }

    fn quantity<T, E>(&mut self, field: &'static str, new: fn(f32) -> Result<T, E>) -> Result<T, InvalidText> {
        let value = self.required(field)?;
        let quantity = value.parse().ok().and_then(|number| new(number).ok());
        quantity.ok_or_else(|| wrong(field, &value, "a finite number"))
    }

    fn flag(&mut self, field: &'static str) -> Result<Option<bool>, InvalidText> {
        let Some(value) = self.optional(field) else { return Ok(None) };
        value.parse().map(Some).map_err(|_| wrong(field, &value, "true or false"))
    }

    fn on(&mut self, field: &'static str) -> Result<bool, InvalidText> {
        self.flag(field)?.ok_or(InvalidText::MissingField { command: self.command.to_owned(), field })
    }

    fn updates(&mut self) -> Result<Updates, InvalidText> {
        let on_change = self.flag("on_change")?.unwrap_or_default();
        let Some(value) = self.optional("period_ms") else { return Ok(Updates::Off) };
        let period_ms = value.parse().map_err(|_| wrong("period_ms", &value, "a number from 0 to 65535"))?;
        Ok(Updates::On { on_change, period_ms })
    }

    fn width_and_speed(&mut self) -> Result<(Width, Speed), InvalidText> {
        Ok((self.quantity("width", Width::new)?, self.quantity("speed", Speed::new)?))
    }

    fn into_command(mut self, id: u8) -> Result<Command, InvalidText> {
        let command = self.command_of(id)?;
        match self.pairs.pop() {
            Some((field, _)) => Err(InvalidText::UnknownField { command: self.command.to_owned(), field }),
            None => Ok(command),
        }
    }

    fn command_of(&mut self, id: u8) -> Result<Command, InvalidText> {
        Ok(match id {
            id::LOOP => {
                let value = self.required("data")?;
                let data = hex::decode(&value).ok().and_then(LoopData::new);
                Command::Loop(data.ok_or_else(|| wrong("data", &value, "at most 256 bytes in hex"))?)
            }
            id::HOMING => match self.optional("direction").as_deref() {
                None | Some("default") => Command::Homing(HomingDirection::Default),
                Some("outer") => Command::Homing(HomingDirection::Outer),
                Some("inner") => Command::Homing(HomingDirection::Inner),
                Some(value) => return Err(wrong("direction", value, "default, outer or inner")),
            },
            id::PRE_POSITION => {
                let (width, speed) = self.width_and_speed()?;
                let relative = self.flag("relative")?.unwrap_or(false);
                let stop_on_block = self.flag("stop_on_block")?.unwrap_or(true);
                Command::PrePosition { flags: MoveFlags { relative, stop_on_block }, width, speed }
            }
            id::GRIP => {
                let (width, speed) = self.width_and_speed()?;
                Command::Grip { width, speed }
            }
            id::RELEASE => {
                let (width, speed) = self.width_and_speed()?;
                Command::Release { width, speed }
            }
            id::SET_ACCELERATION => Command::SetAcceleration(self.quantity("acceleration", Acceleration::new)?),
            id::SET_FORCE_LIMIT => Command::SetForceLimit(self.quantity("force", Force::new)?),
            id::SET_SOFT_LIMITS => {
                let minus = self.quantity("minus", Width::new)?;
                let plus = self.quantity("plus", Width::new)?;
                let limits = SoftLimits::new(minus, plus);
                Command::SetSoftLimits(limits.ok_or_else(|| wrong("minus", &minus.mm().to_string(), "at most plus"))?)
            }
            id::OVERDRIVE_MODE => Command::OverdriveMode { on: self.on("on")? },
            id::FINGER_1_POWER => Command::FingerPower { finger: Finger::One, on: self.on("on")? },
            id::FINGER_2_POWER => Command::FingerPower { finger: Finger::Two, on: self.on("on")? },
            id::GET_STATISTICS => Command::GetStatistics { reset: self.flag("reset")?.unwrap_or(false) },
            id::GET_SYSTEM_STATE => Command::GetSystemState(self.updates()?),
            id::GET_GRIPPER_STATE => Command::GetGripperState(self.updates()?),
            id::GET_WIDTH => Command::GetWidth(self.updates()?),
            id::GET_SPEED => Command::GetSpeed(self.updates()?),
            id::GET_FORCE => Command::GetForce(self.updates()?),
            id::SET_DEVICE_TAG => {
                let value = self.required("tag")?;
                let expected = "at most 64 printable characters of ISO 8859-1";
                Command::SetDeviceTag(DeviceTag::from_text(&value).map_err(|_| wrong("tag", &value, expected))?)
            }
            id::ACKNOWLEDGE_FAST_STOP => Command::AcknowledgeFastStop,
            // All other commands have no parameters, so their payload is empty.
            _ => Command::parse(id, &[]).map_err(|_| InvalidText::UnknownCommand(self.command.to_owned()))?,
        })
    }
}

fn wrong(field: &str, value: &str, expected: &'static str) -> InvalidText {
    InvalidText::Value { field: field.to_owned(), value: value.to_owned(), expected }
}

/// Direction of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
pub enum WireDirection {
    /// To the device.
    Request,
    /// From the device.
    Reply,
    /// Unknown direction: the description covers every possible reading.
    #[default]
    Unknown,
}

/// Describes a frame with a wrong checksum.
#[must_use]
pub fn describe_damaged(id: u8) -> String {
    let name = id::name(id).map_or_else(|| format!("0x{id:02X}"), str::to_owned);
    format!("{name}  [checksum wrong]")
}

/// Describes a frame whose payload is too long to be shown.
#[must_use]
pub fn describe_too_long(id: u8, payload_bytes: usize) -> String {
    let name = id::name(id).map_or_else(|| format!("0x{id:02X}"), str::to_owned);
    format!("{name}  ({payload_bytes} bytes, too many to be shown)")
}

/// Describes bytes outside any frame.
#[must_use]
pub fn describe_skipped(bytes: u64) -> String {
    format!("({bytes} bytes outside any frame)")
}

/// Describes a frame in one line.
#[must_use]
pub fn describe(frame: super::Frame<'_>, direction: WireDirection) -> String {
    let name = id::name(frame.id).map_or_else(|| format!("0x{:02X}", frame.id), str::to_owned);
    let is_known = id::name(frame.id).is_some();
    let request = Command::parse(frame.id, frame.payload).ok().filter(|_| direction != WireDirection::Reply);
    let reply = Reply::parse(frame.id, frame.payload).ok().filter(|_| direction != WireDirection::Request);
    match (request, reply) {
        // Any bytes parse as a custom request, so for custom ids a reply is the better guess.
        (Some(request), Some(reply)) if is_known => format!("{request} (or its reply: {reply})"),
        (_, Some(reply)) => format!("{name} -> {reply}"),
        (Some(request), None) => request.to_string(),
        (None, None) => format!("{name} payload={} (invalid payload for this id)", hex::encode(frame.payload)),
    }
}

#[cfg(test)]
#[path = "text_tests.rs"]
mod tests;
