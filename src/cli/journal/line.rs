//! A record as a line that people read: when, its number, which gripper, who, what, and how it ended.

use serde_json::Value;

/// What says more than a record's kind, in the order of looking.
const SAYS_MORE: [&str; 5] = ["event", "link", "setting", "code", "phase"];

/// Why, in words.
const SAYS_WHY: [&str; 3] = ["cause", "link_cause", "reason"];

/// Of a body.
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
    fn a_line_says_when_which_who_what_and_how_it_ended() {
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
