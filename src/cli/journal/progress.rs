//! The progress line of a long task, on a terminal.

use std::fmt::Display;
use std::io::{IsTerminal as _, Write as _, stderr};

/// Erases the terminal's line (ECMA-48, EL).
const ERASE_LINE: &str = "\r\x1b[K";

/// A line on standard error that is replaced by each newer one, and erased at the end.
pub(super) struct ProgressLine {
    verb: &'static str,
    is_shown: bool,
    percent: Option<u64>,
}

impl ProgressLine {
    /// Shows nothing unless standard error is a terminal.
    pub(super) fn new(verb: &'static str, is_wanted: bool) -> Self {
        Self { verb, is_shown: is_wanted && stderr().is_terminal(), percent: None }
    }

    pub(super) fn show(&mut self, what: impl Display) {
        if self.is_shown {
            let _ = write!(stderr(), "{ERASE_LINE}{}: {what}", self.verb);
        }
    }

    /// Shows a part of the whole in percent.
    pub(super) fn show_part(&mut self, part: u64, whole: u64) {
        let percent = percent(part, whole);
        if self.percent.replace(percent) != Some(percent) {
            self.show(format_args!("{percent} %"));
        }
    }
}

impl Drop for ProgressLine {
    fn drop(&mut self) {
        if self.is_shown {
            let _ = write!(stderr(), "{ERASE_LINE}");
        }
    }
}

/// Returns a part of the whole in percent. New records can make the part larger than the whole.
fn percent(part: u64, whole: u64) -> u64 {
    (part.saturating_mul(100) / whole.max(1)).min(100)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percent_stays_within_its_range() {
        assert_eq!([percent(0, 0), percent(1, 3), percent(3, 3), percent(4, 3)], [0, 33, 100, 100]);
    }
}
