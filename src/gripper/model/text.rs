//! Texts from clients, by what they are for: names that people tell clients apart by, and free texts.

use serde::{Deserialize, Serialize};
use unicode_general_category::{GeneralCategory, get_general_category};
use unicode_normalization::is_nfc;
use unicode_security::{GeneralSecurityProfile as _, RestrictionLevel, RestrictionLevelDetection as _};

/// Text from a client without control characters, of at most `MAX` bytes.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct Text<const MAX: usize>(String);

impl<const MAX: usize> TryFrom<String> for Text<MAX> {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        Self::new(&text).ok_or_else(|| format!("{text:?} is longer than {MAX} bytes, or has a control character"))
    }
}

impl<const MAX: usize> Text<MAX> {
    /// The text, or `None` where it is longer than `MAX` bytes or has a control character.
    #[must_use]
    pub fn new(text: &str) -> Option<Self> {
        (text.len() <= MAX && !text.chars().any(char::is_control)).then(|| Self(text.to_owned()))
    }

    /// As much of `text` as fits, without the characters that are not seen or that turn others around: for a text that
    /// must be taken whatever it says.
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

    /// The text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Whether a character has a meaning to a reader: control and format characters (zero width, bidirectional), other line
/// ends, and what Unicode has not assigned have none.
fn is_seen(character: char) -> bool {
    use GeneralCategory as G;
    let category = get_general_category(character);
    let unseen =
        [G::Control, G::Format, G::LineSeparator, G::ParagraphSeparator, G::PrivateUse, G::Surrogate, G::Unassigned];
    !unseen.contains(&category)
}

/// Why somebody stopped a gripper.
pub type Reason = Text<64>;
/// A part's name, as the MES knows it.
pub type PartId = Text<48>;
/// What makes a request the same as an earlier one (`Idempotency-Key`).
pub type RequestId = Text<64>;

/// A name that people tell clients apart by, of at most `MAX` bytes. Two names that look the same are the same, as far
/// as the rules of UTS #39 go: printable ASCII, and letters, marks and digits that Unicode allows in identifiers, in
/// composed form (NFC) and of scripts that are written together. Names of one foreign script that imitate another, such
/// as Cyrillic `сосо`, are left to the subject to tell apart.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct ShownName<const MAX: usize>(String);

/// A text that is not a [`ShownName`], with the remedy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidShownName {
    /// It is too long.
    #[error("has {bytes} bytes, and may have {max} at most")]
    TooLong {
        /// Its bytes in UTF-8.
        bytes: usize,
        /// The bound.
        max: usize,
    },
    /// It has a character that is invisible, bidirectional, unassigned or a variant of another one.
    #[error("has U+{:04X}, which a name may not have: use printable ASCII, or letters and digits of one script", u32::from(*.0))]
    Character(char),
    /// It has an accent apart from its letter.
    #[error("has an accent apart from its letter: write it in composed form (NFC)")]
    NotComposed,
    /// It mixes scripts whose letters look alike.
    #[error("mixes scripts whose letters look alike, such as Latin and Cyrillic: use one")]
    MixedScripts,
}

impl<const MAX: usize> ShownName<MAX> {
    /// A name, where it is one.
    ///
    /// # Errors
    /// [`InvalidShownName`]
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
        // Spaces and punctuation of ASCII belong to every script.
        let letters: String = text.chars().filter(|character| character.identifier_allowed()).collect();
        if !letters.as_str().check_restriction_level(RestrictionLevel::HighlyRestrictive) {
            return Err(InvalidShownName::MixedScripts);
        }
        Ok(Self(text.to_owned()))
    }

    /// As it is written.
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
    fn names_of_people_and_machines_are_names() {
        for text in
            ["", "robot-1", "Cell #4 (left)", "Müller", "Иванов", "机器人1", "ロボットA", "로봇", "יוסי", "Ελένη"]
        {
            assert_eq!(name(text).as_ref().map(ShownName::as_str), Ok(text));
        }
    }

    #[test]
    fn names_that_cannot_be_told_apart_are_refused() {
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
    fn reasons_lose_what_is_not_seen() {
        let reason = Reason::truncated("\u{202E}light\u{200B} curtain\u{2028}\u{FEFF}\u{E0001}\n 🛑 é");
        assert_eq!(reason.as_str(), "light curtain 🛑 é");
        assert_eq!(Reason::truncated(&"ü".repeat(40)).as_str(), "ü".repeat(32));
    }
}
