//! Options after the `?` of a URL. Unknown, repeated and out-of-range options give errors that list allowed values.

use std::fmt::Display;
use std::ops::RangeInclusive;

use url::Url;

/// Options of one URL.
#[derive(Debug)]
pub struct Options(Vec<(String, String)>);

impl Options {
    /// Parses the options of `url`.
    ///
    /// # Errors
    /// An option is not in `known`, or is given twice.
    pub fn of(url: &Url, known: &[&str]) -> Result<Self, String> {
        let mut options: Vec<(String, String)> = Vec::new();
        for (name, value) in url.query_pairs() {
            if !known.contains(&&*name) {
                let there_are = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
                return Err(format!("unknown option {name:?} for {}; known options: {there_are}", url.scheme()));
            }
            if options.iter().any(|(given, _)| *given == name) {
                return Err(format!("option {name} is given twice"));
            }
            options.push((name.into_owned(), value.into_owned()));
        }
        Ok(Self(options))
    }

    /// Text of an option, if given.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(given, _)| given == name).map(|(_, value)| value.as_str())
    }

    /// Decimal or (with `0x`) hexadecimal number in a range.
    pub fn number(&self, name: &str, allowed: RangeInclusive<u32>) -> Result<Option<u32>, String> {
        let Some(text) = self.text(name) else { return Ok(None) };
        let number = match text.strip_prefix("0x").or_else(|| text.strip_prefix("0X")) {
            Some(digits) => u32::from_str_radix(digits, 16),
            None => text.parse(),
        };
        let number = number.ok().filter(|number| allowed.contains(number));
        number.map(Some).ok_or_else(|| {
            let (min, max) = allowed.into_inner();
            format!("{name}={text} must be a number from {} to {}", like(text, min), like(text, max))
        })
    }

    /// Port from 1 to 65535.
    pub fn port(&self, name: &str) -> Result<Option<u16>, String> {
        Ok(self.number(name, 1..=u32::from(u16::MAX))?.map(|port| port as u16))
    }

    /// One of the `allowed` numbers.
    pub fn one_of(&self, name: &str, allowed: &[u32]) -> Result<Option<u32>, String> {
        let Some(text) = self.text(name) else { return Ok(None) };
        let number = text.parse().ok().filter(|number| allowed.contains(number));
        number.map(Some).ok_or_else(|| format!("{name}={text} must be one of {}", join(allowed)))
    }
}

/// Formats a bound in the base of `text`.
fn like(text: &str, bound: u32) -> String {
    if text.starts_with("0x") || text.starts_with("0X") { format!("{bound:#X}") } else { bound.to_string() }
}

fn join(values: &[impl Display]) -> String {
    values.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}
