//! Texts from clients: names that distinguish clients for people, and free texts.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};
use unicode_general_category::{GeneralCategory, get_general_category};
use unicode_normalization::is_nfc;
use unicode_security::{GeneralSecurityProfile as _, RestrictionLevel, RestrictionLevelDetection as _};
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{ObjectBuilder, Schema, Type};
use utoipa::{PartialSchema, ToSchema};

/// Returns a text without the byte order mark with which some editors and spreadsheets begin a file.
#[must_use]
pub fn without_byte_order_mark(text: &[u8]) -> &[u8] {
    text.strip_prefix("\u{FEFF}".as_bytes()).unwrap_or(text)
}

/// Text from a client, of at most `MAX` bytes and without control characters.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct Text<const MAX: usize>(String);

impl<const MAX: usize> PartialSchema for Text<MAX> {
    fn schema() -> RefOr<Schema> {
        ObjectBuilder::new().schema_type(Type::String).max_length(Some(MAX)).build().into()
    }
}

impl<const MAX: usize> ToSchema for Text<MAX> {
    fn name() -> Cow<'static, str> {
        format!("Text{MAX}Field").into()
    }
}

impl<const MAX: usize> TryFrom<String> for Text<MAX> {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        Self::new(&text).ok_or_else(|| format!("{text:?} is longer than {MAX} bytes or contains a control character"))
    }
}

impl<const MAX: usize> Text<MAX> {
    /// Returns `None` if the text is longer than `MAX` bytes or contains a control character.
    #[must_use]
    pub fn new(text: &str) -> Option<Self> {
        (text.len() <= MAX && !text.chars().any(char::is_control)).then(|| Self(text.to_owned()))
    }

    /// Cuts `text` to `MAX` bytes, without its invisible and bidirectional characters. For a text that must be accepted
    /// whatever it contains.
    #[must_use]
    pub fn truncated(text: &str) -> Self {
        let mut kept = String::new();
        for character in text.chars().filter(|character| is_seen(*character)) {
            if kept.len() + character.len_utf8() > MAX {
                break;
            }
            kept.push(character);
        }
        Self(kept)
    }

    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Whether a reader can see a character. Control and format characters (zero width, bidirectional), other line ends,
/// and unassigned code points are not visible.
fn is_seen(character: char) -> bool {
    use GeneralCategory as G;
    let category = get_general_category(character);
    let unseen =
        [G::Control, G::Format, G::LineSeparator, G::ParagraphSeparator, G::PrivateUse, G::Surrogate, G::Unassigned];
    !unseen.contains(&category)
}

/// A client's reason for a FAST STOP.
pub type Reason = Text<64>;
/// Name of a part, as the MES knows it.
pub type PartId = Text<48>;
/// Id of a finger set, e.g. the number that is engraved on it.
pub type FingerSetId = Text<48>;
/// Id by which a repeated request is recognised (`Idempotency-Key`).
pub type RequestId = Text<64>;

/// A name that distinguishes clients for people, of at most `MAX` bytes. Two names that look the same are the same, as
/// far as the rules of UTS #39 go. Allowed are printable ASCII, and letters, marks and digits that Unicode allows in
/// identifiers, in composed form (NFC) and of scripts that are written together. A name in one script that imitates
/// another script, such as Cyrillic `сосо`, is allowed; its subject distinguishes the client.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct ShownName<const MAX: usize>(String);

/// Reason that a text is not a valid [`ShownName`], with the remedy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidShownName {
    #[error("is {bytes} bytes long; at most {max} are allowed")]
    TooLong { bytes: usize, max: usize },
    /// A character that is invisible, bidirectional, unassigned or a variant of another one.
    #[error("contains U+{:04X}, not allowed in names: use printable ASCII, or letters and digits of one script", u32::from(*.0))]
    Character(char),
    /// An accent that is separate from its letter.
    #[error("contains an accent separate from its letter: use the composed form (NFC)")]
    NotComposed,
    #[error("mixes scripts with look-alike letters, such as Latin and Cyrillic: use only one script")]
    MixedScripts,
}

impl<const MAX: usize> ShownName<MAX> {
    pub fn new(text: &str) -> Result<Self, InvalidShownName> {
        if text.len() > MAX {
            return Err(InvalidShownName::TooLong { bytes: text.len(), max: MAX });
        }
        let is_allowed =
            |character: char| matches!(character, ' '..='~') || !character.is_ascii() && character.identifier_allowed();
        if let Some(character) = text.chars().find(|character| !is_allowed(*character)) {
            return Err(InvalidShownName::Character(character));
        }
        if !is_nfc(text) {
            return Err(InvalidShownName::NotComposed);
        }
        // ASCII spaces and punctuation belong to every script.
        let letters: String = text.chars().filter(|character| character.identifier_allowed()).collect();
        if !letters.as_str().check_restriction_level(RestrictionLevel::HighlyRestrictive) {
            return Err(InvalidShownName::MixedScripts);
        }
        Ok(Self(text.to_owned()))
    }

    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn name(text: &str) -> Result<ShownName<32>, InvalidShownName> {
        ShownName::new(text)
    }

    #[test]
    fn names_of_people_and_machines_are_valid() {
        for text in
            ["", "robot-1", "Cell #4 (left)", "Müller", "Иванов", "机器人1", "ロボットA", "로봇", "יוסי", "Ελένη"]
        {
            assert_eq!(name(text).as_ref().map(ShownName::as_str), Ok(text));
        }
    }

    #[test]
    fn confusable_names_are_refused() {
        for (text, character) in [
            ("robot\u{200B}1", '\u{200B}'),
            ("\u{202E}tobor", '\u{202E}'),
            ("robot\u{AD}", '\u{AD}'),
            ("ro\u{A0}bot", '\u{A0}'),
            ("\u{3164}", '\u{3164}'),
            ("a\u{FE0F}", '\u{FE0F}'),
            ("\u{2800}", '\u{2800}'),
            ("\u{E0041}", '\u{E0041}'),
            ("\u{378}", '\u{378}'),
            ("\u{E000}", '\u{E000}'),
            ("ｒobot", 'ｒ'),
            ("𝐫obot", '𝐫'),
            ("a\nb", '\n'),
            ("a\u{85}b", '\u{85}'),
        ] {
            assert_eq!(name(text), Err(InvalidShownName::Character(character)), "{text:?}");
        }
        assert_eq!(name("Mu\u{308}ller"), Err(InvalidShownName::NotComposed));
        assert_eq!(name("r\u{43E}bot"), Err(InvalidShownName::MixedScripts), "a Cyrillic o");
        assert_eq!(name("\u{3BF}liver"), Err(InvalidShownName::MixedScripts), "a Greek o");
    }

    #[test]
    fn names_are_bounded_in_bytes() {
        assert!(name(&"ü".repeat(16)).is_ok());
        assert_eq!(name(&"ü".repeat(17)), Err(InvalidShownName::TooLong { bytes: 34, max: 32 }));
    }

    #[test]
    fn reasons_lose_invisible_characters() {
        let reason = Reason::truncated("\u{202E}light\u{200B} curtain\u{2028}\u{FEFF}\u{E0001}\n 🛑 é");
        assert_eq!(reason.as_str(), "light curtain 🛑 é");
        assert_eq!(Reason::truncated(&"ü".repeat(40)).as_str(), "ü".repeat(32));
    }
}
