//! A record as a readable line: time, sequence number, gripper, subject, kind with details, and outcome with cause.

use serde_json::Value;

/// Fields that refine a record's kind; the first one present is printed.
const SAYS_MORE: [&str; 5] = ["event", "link", "setting", "code", "phase"];

/// Fields with the cause in words; the first one present is printed.
const SAYS_WHY: [&str; 3] = ["cause", "link_cause", "reason"];

/// Formats a record's body.
pub(super) fn of(body: &str) -> String {
    let record: Value = serde_json::from_str(body).unwrap_or_default();
    let text = |field: &str| record[field].as_str().filter(|text| !text.is_empty());
    let first = |fields: &[&str]| fields.iter().find_map(|field| text(field));
    let time = first(&["at", "started_at"]).unwrap_or("-");
    let what: Vec<_> = [text("kind"), text("command"), first(&SAYS_MORE)].into_iter().flatten().collect();
    let end = [text("outcome"), text("part_id"), first(&SAYS_WHY)].into_iter().flatten();
    let line = format!(
        "{time:<24} {:>8}  {:<10} {:<22} {:<24} {}",
        record["seq"].to_string(),
        text("gripper").unwrap_or("-"),
        text("subject").unwrap_or("-"),
        what.join(" "),
        end.collect::<Vec<_>>().join("  "),
    );
    line.trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn line_has_time_gripper_subject_kind_and_outcome() {
        let done = r#"{"seq":17,"at":"2026-11-21T09:00:00.123Z","gripper":"left","subject":"http:127.0.0.1","kind":"command","phase":"done","command":"grip","outcome":"NO_PART","part_id":"P-1"}"#;
        let expected = "2026-11-21T09:00:00.123Z       17  left       http:127.0.0.1         command grip done        NO_PART  P-1";
        assert_eq!(of(done), expected);
        let link = r#"{"seq":3,"at":"2026-11-21T09:00:00Z","gripper":"left","subject":null,"kind":"link","link":"reconnecting","link_cause":"reset by peer"}"#;
        assert_eq!(
            of(link),
            "2026-11-21T09:00:00Z            3  left       -                      link reconnecting        reset by peer"
        );
        let grip =
            r#"{"seq":1,"started_at":"2026-11-21T09:00:00Z","gripper":"left","kind":"grip","outcome":"PART_HELD"}"#;
        assert!(of(grip).ends_with("grip                     PART_HELD"), "{}", of(grip));
    }
}
