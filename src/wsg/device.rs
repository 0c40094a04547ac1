//! Device information: model, firmware, limits, tag, statistics and fingers (`fw4-en 3.4.3`, `3.5`, `3.6`).

use std::fmt;

use super::quantity::{Acceleration, Force, Speed, Width};

/// Device type in the reply to Get System Information (50h). fw2 defines only 0 and 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum DeviceType {
    /// 0: unknown.
    Unknown,
    /// 1: WSG 50.
    Wsg50,
    /// 2: WSG 32.
    Wsg32,
    /// 3: KMS 40, a force-torque sensor.
    Kms40,
    /// 4: WTS, a tactile sensing module.
    Wts,
    /// 5: WSG 25.
    Wsg25,
    /// 6: WSG 70.
    Wsg70,
    /// A code that the manuals do not list.
    Other(u8),
}

impl DeviceType {
    /// Decodes the type byte of 50h.
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

    /// Type byte of 50h.
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

/// Firmware version in four nibbles (`fw4-en 3.5.1`). fw2 says only "firmware revision", an integer.
///
/// Ruling: a number whose first nibble is 0 is such a revision, since no firmware has the major version 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Firmware(pub u16);

impl Firmware {
    /// Major version, which distinguishes the protocol generations.
    #[must_use]
    pub const fn major(self) -> u8 {
        (self.0 >> 12) as u8
    }

    const fn nibble(self, shift: u16) -> u16 {
        (self.0 >> shift) & 0xF
    }
}

impl fmt::Display for Firmware {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.major() == 0 {
            return write!(f, "{}", self.0);
        }
        write!(f, "{}.{}.{}", self.nibble(12), self.nibble(8), self.nibble(4))?;
        match self.nibble(0) {
            0 => Ok(()),
            candidate => write!(f, "-rc{candidate}"),
        }
    }
}

/// Reply data of Get System Information (50h, `fw4-en 3.5.1`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SystemInfo {
    /// Device model.
    pub device_type: DeviceType,
    /// Hardware revision number.
    pub hardware_revision: u8,
    /// Firmware version of the device.
    pub firmware: Firmware,
    /// Serial number of the device.
    pub serial_number: u32,
}

/// Reply data of Get System Limits (53h, `fw4-en 3.5.4`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SystemLimits {
    /// Stroke: opening widths range from 0 to this.
    pub stroke: Width,
    /// Lowest speed.
    pub min_speed: Speed,
    /// Highest speed.
    pub max_speed: Speed,
    /// Lowest acceleration.
    pub min_acceleration: Acceleration,
    /// Highest acceleration.
    pub max_acceleration: Acceleration,
    /// Lowest gripping force.
    pub min_force: Force,
    /// Nominal gripping force: the highest without Overdrive Mode.
    pub nominal_force: Force,
    /// Highest gripping force in Overdrive Mode.
    pub overdrive_force: Force,
}

impl SystemLimits {
    /// Whether a gripper can have these limits: none is negative, and no lower limit exceeds its upper one.
    #[must_use]
    pub fn are_plausible(&self) -> bool {
        self.stroke > Width::ZERO
            && (Speed::ZERO..=self.max_speed).contains(&self.min_speed)
            && (Acceleration::ZERO..=self.max_acceleration).contains(&self.min_acceleration)
            && (Force::ZERO..=self.nominal_force).contains(&self.min_force)
    }
}

/// Soft limits (34h, 35h; `fw4-en 3.3.5`): widths outside `minus..=plus` are forbidden.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SoftLimits {
    minus: Width,
    plus: Width,
}

impl SoftLimits {
    /// Builds limits from `minus` to `plus`, or returns `None` if `minus` exceeds `plus`.
    #[must_use]
    pub fn new(minus: Width, plus: Width) -> Option<Self> {
        (minus <= plus).then_some(Self { minus, plus })
    }

    /// Smallest allowed width.
    #[must_use]
    pub const fn minus(self) -> Width {
        self.minus
    }

    /// Largest allowed width.
    #[must_use]
    pub const fn plus(self) -> Width {
        self.plus
    }

    /// Whether a motion from the width `from_mm` to `target` is allowed: it ends within the limits, or, from outside,
    /// moves towards them.
    ///
    /// Ruling: any other target outside is a range error, from either direction. Outside, "finger movement is only
    /// allowed in the direction out of the restricted area" (`fw4-en 3.3.5`): the direction counts, not the target.
    #[must_use]
    pub fn allow_from(self, from_mm: f32, target: Width) -> bool {
        (self.minus.mm().min(from_mm)..=self.plus.mm().max(from_mm)).contains(&target.mm())
    }
}

/// A device tag (51h, 52h): at most 64 characters of one byte each, without control characters. fw4-en 3.5.2 demands
/// ASCII. fw2 3.5.2 does not, so such a tag can have any printable character of ISO 8859-1.
#[derive(Clone, PartialEq, Eq, Hash)]
pub struct DeviceTag(Vec<u8>);

impl fmt::Debug for DeviceTag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "DeviceTag(\"{}\")", self.0.escape_ascii())
    }
}

/// Reason why a text is not a valid device tag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum InvalidDeviceTag {
    /// The text exceeds [`DeviceTag::MAX_BYTES`].
    #[error("a device tag can have at most 64 characters")]
    TooLong,
    /// The text contains a control character, or one that is not in ISO 8859-1.
    #[error("a device tag must be printable characters of ISO 8859-1, or of ASCII on firmware 4 and newer")]
    IllegalCharacter,
}

impl DeviceTag {
    /// Limit in bytes (`fw4-en 3.5.2`).
    pub const MAX_BYTES: usize = 64;

    /// Limit in bytes with trailing NULs, which a driver may send because fw2 strips them. More NULs are left out.
    const MAX_BYTES_WITH_NULS: usize = 2 * Self::MAX_BYTES;

    /// Builds a tag that is to be set. Trailing NULs stay: fw2 3.5.2 strips them, and for fw4 they are control
    /// characters, so the device decides.
    ///
    /// # Errors
    /// [`InvalidDeviceTag`]; a device returns `E_OVERRUN` or `E_INVALID_PARAMETER` instead.
    pub fn new(bytes: &[u8]) -> Result<Self, InvalidDeviceTag> {
        let text = without_trailing_nuls(bytes);
        if text.len() > Self::MAX_BYTES {
            return Err(InvalidDeviceTag::TooLong);
        }
        if text.iter().any(|&byte| char::from(byte).is_control()) {
            return Err(InvalidDeviceTag::IllegalCharacter);
        }
        Ok(Self(bytes.iter().copied().take(Self::MAX_BYTES_WITH_NULS).collect()))
    }

    /// Builds a tag that is to be set from its text.
    ///
    /// # Errors
    /// [`InvalidDeviceTag`].
    pub fn from_text(text: &str) -> Result<Self, InvalidDeviceTag> {
        let bytes =
            text.chars().map(|character| u8::try_from(character).map_err(|_| InvalidDeviceTag::IllegalCharacter));
        Self::new(&bytes.collect::<Result<Vec<_>, _>>()?)
    }

    /// Builds the tag that a device reports. Another program may have set it, in another character set.
    ///
    /// # Errors
    /// [`InvalidDeviceTag`] if it contains a control character of ASCII, or is too long: the frame is damaged.
    pub fn reported(bytes: &[u8]) -> Result<Self, InvalidDeviceTag> {
        let text = without_trailing_nuls(bytes);
        if text.len() > Self::MAX_BYTES {
            return Err(InvalidDeviceTag::TooLong);
        }
        if text.iter().any(u8::is_ascii_control) {
            return Err(InvalidDeviceTag::IllegalCharacter);
        }
        Ok(Self(bytes.to_vec()))
    }

    /// The tag without trailing NULs.
    #[must_use]
    pub fn stripped(&self) -> Self {
        Self(without_trailing_nuls(&self.0).to_vec())
    }

    /// Whether all characters are printable ASCII.
    #[must_use]
    pub fn is_ascii(&self) -> bool {
        self.0.iter().all(|byte| matches!(byte, 0x20..=0x7E))
    }

    /// Whether the tag has no bytes.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The bytes as they are sent.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.0
    }

    /// The tag as text, read as ISO 8859-1, without trailing NULs, and with `\u{fffd}` for control characters.
    #[must_use]
    pub fn text(&self) -> String {
        let characters = without_trailing_nuls(&self.0).iter().map(|&byte| char::from(byte));
        characters
            .map(|character| if character.is_control() { char::REPLACEMENT_CHARACTER } else { character })
            .collect()
    }
}

fn without_trailing_nuls(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
    &bytes[..end]
}

/// Reply data of Get Gripping Statistics (42h, `fw4-en 3.4.3`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Statistics {
    /// Number of executed grips.
    pub total: u32,
    /// Number of grips that found no part.
    pub no_part: u16,
    /// Number of grips whose part was lost before the gripper opened again.
    pub lost_part: u16,
}

/// A finger: ids 60h to 63h address the first, 70h to 73h the second.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Finger {
    /// Finger 1.
    One,
    /// Finger 2.
    Two,
}

/// Finger type (60h, 70h).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FingerType {
    /// 0: generic finger, or no finger.
    Generic,
    /// 1: WSG-FMF, force measurement finger.
    Fmf,
    /// 2: WSG-DSA, tactile finger.
    Dsa,
    /// 3 and up: reserved.
    Reserved(u8),
}

impl FingerType {
    /// Decodes the type byte of 60h and 70h.
    #[must_use]
    pub const fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Generic,
            1 => Self::Fmf,
            2 => Self::Dsa,
            reserved => Self::Reserved(reserved),
        }
    }

    /// Type byte of 60h and 70h.
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

/// Reply data of Get Finger Info (60h, 70h; `fw4-en 3.6.1`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FingerInfo {
    /// Type of the finger.
    pub finger_type: FingerType,
    /// Size in bytes of one data frame (63h, 73h); 0 if the finger has no data.
    pub data_bytes: u16,
}

bitflags::bitflags! {
    /// Finger flags (61h, 71h; `fw4-en 3.6.2`). Reserved bits survive a round trip.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default)]
    pub struct FingerFlags: u16 {
        /// The finger is powered.
        const POWER_ON = 1;
        /// The finger has configuration data, so it is an intelligent finger.
        const CONFIG_AVAIL = 1 << 1;
        /// The finger's communication interface is open.
        const COMM_OPEN = 1 << 2;
        /// Over-current in the finger's supply.
        const POWER_FAULT = 1 << 8;
        /// Communication fault at run time.
        const COMM_FAULT = 1 << 9;

        const _ = !0;
    }
}

impl FingerFlags {
    /// Names of the flags that are set. Reserved bits have no name.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        self.iter_names().map(|(name, _)| name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn firmware_version_has_four_nibbles() {
        assert_eq!(Firmware(0x4020).to_string(), "4.0.2");
        assert_eq!(Firmware(0x2203).to_string(), "2.2.0-rc3");
        assert_eq!(Firmware(0x4020).major(), 4);
    }

    #[test]
    fn ruling_revision_of_firmware_2_is_a_number() {
        assert_eq!(Firmware(220).to_string(), "220");
    }

    #[test]
    fn type_codes_survive_a_round_trip() {
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
        assert!(limits.allow_from(30.0, width(10.0)) && limits.allow_from(30.0, width(60.0)));
        assert!(!limits.allow_from(30.0, width(9.9)) && !limits.allow_from(30.0, width(60.1)));
        assert!(limits.allow_from(70.0, width(65.0)) && !limits.allow_from(70.0, width(70.1)));
        assert!(limits.allow_from(5.0, width(9.0)) && !limits.allow_from(5.0, width(61.0)));
        assert_eq!(SoftLimits::new(width(60.0), width(10.0)), None);
    }

    #[test]
    fn tag_takes_at_most_64_printable_characters() {
        assert!(DeviceTag::new(&[b'x'; 64]).is_ok());
        assert_eq!(DeviceTag::new(&[b'x'; 65]), Err(InvalidDeviceTag::TooLong));
        for illegal in ["a\nb", "a\0b", "a\u{7f}", "a\u{85}", "€", "Ω"] {
            assert_eq!(DeviceTag::from_text(illegal), Err(InvalidDeviceTag::IllegalCharacter), "{illegal:?}");
        }
        let tag = DeviceTag::from_text("Zelle ü").unwrap();
        assert_eq!((tag.as_bytes(), tag.is_ascii()), (&b"Zelle \xFC"[..], false));
        assert_eq!(tag.text(), "Zelle ü");
        assert!(DeviceTag::new(b"cell 7").unwrap().is_ascii());
    }

    /// fw2 3.5.2 strips trailing NULs; fw4-en 3.5.2 knows them as control characters only. The device decides.
    #[test]
    fn trailing_nuls_are_sent_and_not_shown() {
        let tag = DeviceTag::new(b"cell 7\0\0").unwrap();
        assert_eq!((tag.as_bytes(), tag.text().as_str()), (&b"cell 7\0\0"[..], "cell 7"));
        assert_eq!(tag.stripped().as_bytes(), b"cell 7");
        assert!(!tag.is_ascii() && tag.stripped().is_ascii());
        let padded = [&[b'x'; 64][..], &[0; 300]].concat();
        assert_eq!(DeviceTag::new(&padded).unwrap().as_bytes().len(), 128);
    }

    #[test]
    fn reported_tag_is_shown_in_any_character_set() {
        assert_eq!(DeviceTag::reported(b"Zelle \xFC\0").unwrap().text(), "Zelle ü");
        assert_eq!(DeviceTag::reported(b"10 \x80").unwrap().text(), "10 \u{fffd}");
        assert_eq!(DeviceTag::reported(b"a\nb"), Err(InvalidDeviceTag::IllegalCharacter));
        assert_eq!(DeviceTag::reported(&[b'x'; 65]), Err(InvalidDeviceTag::TooLong));
    }
}
