//! Check of this machine's clock, which gives records their times.

use jiff::{SignedDuration, Timestamp};
use serde::Deserialize;

use super::{Diagnosis, Installation};
use crate::config::JournalLocation;
use crate::journal::{EventQuery, Limit, Reader, is_synchronised};

/// Tolerance for a clock that was set back a little.
const TOLERANCE: SignedDuration = SignedDuration::from_secs(10);

#[derive(Deserialize)]
struct Time {
    at: Timestamp,
}

pub(super) fn check(installation: &Installation) -> Vec<Diagnosis> {
    let built = std::env::current_exe().and_then(std::fs::metadata).and_then(|program| program.modified());
    let built = built.ok().and_then(|built| Timestamp::try_from(built).ok());
    let newest = match &installation.config.journal.place {
        JournalLocation::File(path) => newest_event(path),
        JournalLocation::Memory => None,
    };
    vec![judge(Timestamp::now(), built, newest, is_synchronised())]
}

fn newest_event(journal: &std::path::Path) -> Option<Timestamp> {
    let query = EventQuery { limit: Limit::new(1).ok()?, ..EventQuery::default() };
    let page = Reader::open(journal).ok()?.events(&query).ok()?;
    Some(serde_json::from_str::<Time>(page.bodies.first()?).ok()?.at)
}

/// Judges the time by two times that must be earlier: those of the program's file and of the journal's newest event.
fn judge(
    now: Timestamp,
    built: Option<Timestamp>,
    newest: Option<Timestamp>,
    is_synchronised: Option<bool>,
) -> Diagnosis {
    let remedy = "set the clock, and let a time server keep it (timedatectl set-ntp true)";
    let earlier = [(built, "the program's file"), (newest, "the journal's newest event")];
    for (time, what) in earlier {
        if let Some(time) = time.filter(|time| now < *time - TOLERANCE) {
            return Diagnosis::problem("clock", format_args!("{now} is before {what} ({time}): {remedy}"));
        }
    }
    match is_synchronised {
        Some(true) => Diagnosis::good("clock", format_args!("{now}, from a time server")),
        Some(false) => Diagnosis::warning("clock", format_args!("{now}, but no time server keeps it: {remedy}")),
        None => Diagnosis::good("clock", now),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Severity;
    use super::*;

    #[test]
    fn clock_before_the_newest_event_is_a_problem() {
        let at = |text: &str| text.parse::<Timestamp>().unwrap();
        let (early, late) = (at("2026-11-22T10:00:00Z"), at("2026-11-22T11:00:00Z"));
        let wrong = judge(early, None, Some(late), Some(true));
        assert_eq!(wrong.severity, Severity::Problem);
        assert!(wrong.text.contains("before the journal's newest event") && wrong.text.contains("set-ntp"), "{wrong}");
        assert_eq!(judge(early, Some(late), None, None).severity, Severity::Problem);
        assert_eq!(judge(late, Some(early), Some(early), Some(false)).severity, Severity::Warning);
        assert_eq!(judge(late, Some(early), Some(early), None).severity, Severity::Good);
    }
}
