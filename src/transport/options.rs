//! The options behind a URL's `?`: each known, given once, and in its range, or named in the error with what is allowed.

use std::fmt::Display;
use std::ops::RangeInclusive;

use url::Url;

/// The options of one URL.
#[derive(Debug)]
pub struct Options(Vec<(String, String)>);

impl Options {
    /// Of this URL, whose transport knows these.
    ///
    /// # Errors
    /// Which option is not known, or given twice, and which there are.
    pub fn of(url: &Url, known: &[&str]) -> Result<Self, String> {
        let mut options: Vec<(String, String)> = Vec::new();
        for (name, value) in url.query_pairs() {
            if !known.contains(&&*name) {
                let there_are = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
                return Err(format!("there is no option {name:?} for {}; there are: {there_are}", url.scheme()));
            }
            if options.iter().any(|(given, _)| *given == name) {
                return Err(format!("the option {name} is given twice"));
            }
            options.push((name.into_owned(), value.into_owned()));
        }
        Ok(Self(options))
    }

    /// An option's text, where it was given.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(given, _)| given == name).map(|(_, value)| value.as_str())
    }

    /// A decimal number, or one in hexadecimal behind `0x`, from a range.
    ///
    /// # Errors
    /// What it may be.
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

    /// A port, 1 to 65535.
    ///
    /// # Errors
    /// What it may be.
    pub fn port(&self, name: &str) -> Result<Option<u16>, String> {
        Ok(self.number(name, 1..=u32::from(u16::MAX))?.map(|port| port as u16))
    }

    /// One of a few numbers.
    ///
    /// # Errors
    /// Which there are.
    pub fn one_of(&self, name: &str, allowed: &[u32]) -> Result<Option<u32>, String> {
        let Some(text) = self.text(name) else { return Ok(None) };
        let number = text.parse().ok().filter(|number| allowed.contains(number));
        number.map(Some).ok_or_else(|| format!("{name}={text} must be one of {}", join(allowed)))
    }
}

/// A bound, written as what was given was written.
fn like(text: &str, bound: u32) -> String {
    if text.starts_with("0x") || text.starts_with("0X") { format!("{bound:#X}") } else { bound.to_string() }
}

fn join(values: &[impl Display]) -> String {
    values.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}
