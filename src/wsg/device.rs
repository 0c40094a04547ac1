//! What a device says of itself: model, firmware, limits, tag, statistics, fingers (`fw4-en 3.4.3`, `3.5`, `3.6`).

use std::fmt;

use super::quantity::{Acceleration, Force, Speed, Width};

/// The type that Get System Information (50h) returns. fw2 knows 0 and 1 alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeviceType {
    /// 0
    Unknown,
    /// 1
    Wsg50,
    /// 2
    Wsg32,
    /// 3: a force-torque sensor.
    Kms40,
    /// 4: a tactile sensing module.
    Wts,
    /// 5
    Wsg25,
    /// 6
    Wsg70,
    /// A type that the manuals do not list.
    Other(u8),
}

impl DeviceType {
    /// From the byte of 50h.
    #[must_use]
    pub const fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Unknown,
            1 => Self::Wsg50,
            2 => Self::Wsg32,
            3 => Self::Kms40,
            4 => Self::Wts,
            5 => Self::Wsg25,
            6 => Self::Wsg70,
            other => Self::Other(other),
        }
    }

    /// The byte of 50h.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Unknown => 0,
            Self::Wsg50 => 1,
            Self::Wsg32 => 2,
            Self::Kms40 => 3,
            Self::Wts => 4,
            Self::Wsg25 => 5,
            Self::Wsg70 => 6,
            Self::Other(code) => code,
        }
    }
}

impl fmt::Display for DeviceType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Unknown => "unknown",
            Self::Wsg50 => "WSG 50",
            Self::Wsg32 => "WSG 32",
            Self::Kms40 => "KMS 40",
            Self::Wts => "WTS",
            Self::Wsg25 => "WSG 25",
            Self::Wsg70 => "WSG 70",
            Self::Other(code) => return write!(f, "type {code}"),
        })
    }
}

/// A firmware version, four nibbles (`fw4-en 3.5.1`; fw2 says "firmware revision" and no more).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Firmware(pub u16);

impl Firmware {
    /// The major version: what tells the generations of the protocol apart.
    #[must_use]
    pub const fn major(self) -> u8 {
        (self.0 >> 12) as u8
    }
}

impl fmt::Display for Firmware {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let nibble = |shift: u16| (self.0 >> shift) & 0xF;
        write!(f, "{}.{}.{}", nibble(12), nibble(8), nibble(4))?;
        match nibble(0) {
            0 => Ok(()),
            candidate => write!(f, "-rc{candidate}"),
        }
    }
}

/// What Get System Information (50h) returns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SystemInfo {
    /// The model.
    pub device_type: DeviceType,
    /// The hardware revision.
    pub hardware_revision: u8,
    /// The firmware version.
    pub firmware: Firmware,
    /// The serial number.
    pub serial_number: u32,
}

/// What Get System Limits (53h) returns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SystemLimits {
    /// The stroke: widths go from 0 to this.
    pub stroke: Width,
    /// The lowest speed.
    pub min_speed: Speed,
    /// The highest speed.
    pub max_speed: Speed,
    /// The lowest acceleration.
    pub min_acceleration: Acceleration,
    /// The highest acceleration.
    pub max_acceleration: Acceleration,
    /// The lowest gripping force.
    pub min_force: Force,
    /// The nominal gripping force: the highest without Overdrive Mode.
    pub nominal_force: Force,
    /// The highest gripping force in Overdrive Mode.
    pub overdrive_force: Force,
}

impl SystemLimits {
    /// Whether a gripper can have them: nothing is negative, and no lower limit above its upper one.
    #[must_use]
    pub fn are_plausible(&self) -> bool {
        self.stroke > Width::ZERO
            && (Speed::ZERO..=self.max_speed).contains(&self.min_speed)
            && (Acceleration::ZERO..=self.max_acceleration).contains(&self.min_acceleration)
            && (Force::ZERO..=self.nominal_force).contains(&self.min_force)
    }
}

/// Soft limits (34h, 35h): widths outside `minus..=plus` are forbidden.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoftLimits {
    minus: Width,
    plus: Width,
}

impl SoftLimits {
    /// From `minus` to `plus`, or `None` where `minus` is above `plus`.
    #[must_use]
    pub fn new(minus: Width, plus: Width) -> Option<Self> {
        (minus <= plus).then_some(Self { minus, plus })
    }

    /// The smallest allowed width.
    #[must_use]
    pub const fn minus(self) -> Width {
        self.minus
    }

    /// The largest allowed width.
    #[must_use]
    pub const fn plus(self) -> Width {
        self.plus
    }

    /// Ruling: a target outside is a range error, whichever way it is reached.
    #[must_use]
    pub fn allow(self, target: Width) -> bool {
        (self.minus..=self.plus).contains(&target)
    }
}

/// A device tag (51h, 52h): at most 64 ASCII characters, none of them a control character.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct DeviceTag(String);

/// Why a text is no device tag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum InvalidDeviceTag {
    /// More than [`DeviceTag::MAX_BYTES`].
    #[error("a device tag has 64 characters at most")]
    TooLong,
    /// Not ASCII, or a control character.
    #[error("a device tag is ASCII without control characters")]
    IllegalCharacter,
}

impl DeviceTag {
    /// `fw4-en 3.5.2`
    pub const MAX_BYTES: usize = 64;

    /// The tag of these characters, trailing NULs stripped (fw2 3.5.2).
    ///
    /// # Errors
    /// [`InvalidDeviceTag`], which a device tells as `E_OVERRUN` or `E_INVALID_PARAMETER`.
    pub fn new(bytes: &[u8]) -> Result<Self, InvalidDeviceTag> {
        let stripped = bytes.len() - bytes.iter().rev().take_while(|&&byte| byte == 0).count();
        let bytes = &bytes[..stripped];
        if bytes.len() > Self::MAX_BYTES {
            return Err(InvalidDeviceTag::TooLong);
        }
        match std::str::from_utf8(bytes) {
            Ok(text) if bytes.iter().all(|byte| matches!(byte, 0x20..=0x7E)) => Ok(Self(text.to_owned())),
            _ => Err(InvalidDeviceTag::IllegalCharacter),
        }
    }

    /// Its characters.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// What Get Gripping Statistics (42h) returns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Statistics {
    /// Executed grips.
    pub total: u32,
    /// Grips that found no part.
    pub no_part: u16,
    /// Grips whose part was lost before the gripper was opened again.
    pub lost_part: u16,
}

/// Which finger: 60h to 63h speak of the first, 70h to 73h of the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Finger {
    /// Finger 1.
    One,
    /// Finger 2.
    Two,
}

/// The type of a finger (60h, 70h).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FingerType {
    /// 0: generic, or none.
    Generic,
    /// 1: WSG-FMF, force measurement.
    Fmf,
    /// 2: WSG-DSA, tactile.
    Dsa,
    /// 3 and up: reserved.
    Reserved(u8),
}

impl FingerType {
    /// From the byte of 60h.
    #[must_use]
    pub const fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Generic,
            1 => Self::Fmf,
            2 => Self::Dsa,
            reserved => Self::Reserved(reserved),
        }
    }

    /// The byte of 60h.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Generic => 0,
            Self::Fmf => 1,
            Self::Dsa => 2,
            Self::Reserved(code) => code,
        }
    }
}

impl fmt::Display for FingerType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Generic => f.write_str("generic"),
            Self::Fmf => f.write_str("WSG-FMF"),
            Self::Dsa => f.write_str("WSG-DSA"),
            Self::Reserved(code) => write!(f, "type {code}"),
        }
    }
}

/// What Get Finger Info (60h, 70h) returns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FingerInfo {
    /// Its type.
    pub finger_type: FingerType,
    /// The bytes of one data frame (63h, 73h); 0 where the finger has none.
    pub data_bytes: u16,
}

bitflags::bitflags! {
    /// The finger flags (61h, 71h; `fw4-en 3.6.2`). Reserved bits survive a round trip.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct FingerFlags: u16 {
        /// Powered.
        const POWER_ON = 1;
        /// It has configuration data: an intelligent finger.
        const CONFIG_AVAIL = 1 << 1;
        /// Its communication interface is open.
        const COMM_OPEN = 1 << 2;
        /// Over-current.
        const POWER_FAULT = 1 << 8;
        /// A communication fault at run time.
        const COMM_FAULT = 1 << 9;

        const _ = !0;
    }
}

impl FingerFlags {
    /// The names of the flags that are set; reserved bits have none.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        self.iter_names().map(|(name, _)| name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn firmware_is_four_nibbles() {
        assert_eq!(Firmware(0x4020).to_string(), "4.0.2");
        assert_eq!(Firmware(0x2203).to_string(), "2.2.0-rc3");
        assert_eq!(Firmware(0x4020).major(), 4);
    }

    #[test]
    fn every_device_and_finger_type_survives() {
        for code in 0..=u8::MAX {
            assert_eq!(DeviceType::from_code(code).code(), code);
            assert_eq!(FingerType::from_code(code).code(), code);
        }
        assert_eq!(DeviceType::from_code(6).to_string(), "WSG 70");
    }

    #[test]
    fn ruling_a_target_outside_the_soft_limits_is_a_range_error() {
        let width = |mm| Width::new(mm).unwrap();
        let limits = SoftLimits::new(width(10.0), width(60.0)).unwrap();
        assert!(limits.allow(width(10.0)) && limits.allow(width(60.0)));
        assert!(!limits.allow(width(9.9)) && !limits.allow(width(60.1)));
        assert_eq!(SoftLimits::new(width(60.0), width(10.0)), None);
    }

    #[test]
    fn a_tag_has_64_printable_ascii_characters_at_most() {
        assert_eq!(DeviceTag::new(b"cell 7\0\0").unwrap().as_str(), "cell 7");
        assert!(DeviceTag::new(&[b'x'; 64]).is_ok());
        assert_eq!(DeviceTag::new(&[b'x'; 65]), Err(InvalidDeviceTag::TooLong));
        assert_eq!(DeviceTag::new(b"a\nb"), Err(InvalidDeviceTag::IllegalCharacter));
        assert_eq!(DeviceTag::new("ü".as_bytes()), Err(InvalidDeviceTag::IllegalCharacter));
    }
}
