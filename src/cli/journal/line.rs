//! A record as a readable line: time, sequence number, gripper, subject, kind with details, and outcome with cause.

use serde_json::Value;

/// Fields that refine a record's kind; the first one present is printed.
const SAYS_MORE: [&str; 5] = ["event", "link", "setting", "code", "phase"];

/// Fields with the cause in words; the first one present is printed.
const SAYS_WHY: [&str; 3] = ["cause", "link_cause", "reason"];

/// Fields with the value of a setting, and their units.
const SETTING_VALUES: [(&str, &str); 6] = [
    ("acceleration_mm_s2", "mm/s²"),
    ("force_n", "N"),
    ("minus_mm", "mm"),
    ("plus_mm", "mm"),
    ("tag", ""),
    ("finger_set", ""),
];

/// Formats a record's body.
pub(super) fn of(body: &str) -> String {
    let record: Value = serde_json::from_str(body).unwrap_or_default();
    let time = first_text(&record, &["at", "started_at"]).unwrap_or("-");
    let what = [text(&record, "kind"), text(&record, "command"), first_text(&record, &SAYS_MORE)];
    let what: Vec<_> = what.into_iter().flatten().collect();
    let value = value_of_setting(&record);
    let changes: Vec<_> = record["changes"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let changes = Some(changes.join("; ")).filter(|changes| !changes.is_empty());
    let end = [
        text(&record, "outcome"),
        text(&record, "part_id"),
        first_text(&record, &SAYS_WHY),
        value.as_deref(),
        changes.as_deref(),
    ];
    let end = end.into_iter().flatten();
    let line = format!(
        "{time:<24} {:>8}  {:<10} {:<22} {:<24} {}",
        record["seq"].to_string(),
        text(&record, "gripper").unwrap_or("-"),
        text(&record, "subject").unwrap_or("-"),
        what.join(" "),
        end.collect::<Vec<_>>().join("  "),
    );
    line.trim_end().to_owned()
}

/// Returns a text of the record that is not empty.
fn text<'a>(record: &'a Value, field: &str) -> Option<&'a str> {
    record[field].as_str().filter(|text| !text.is_empty())
}

fn first_text<'a>(record: &'a Value, fields: &[&str]) -> Option<&'a str> {
    fields.iter().find_map(|field| text(record, field))
}

/// Says what a setting was changed or restored to; `None` for other records and for settings without a value.
fn value_of_setting(record: &Value) -> Option<String> {
    record["setting"].as_str()?;
    if let Some(is_on) = record["enabled"].as_bool() {
        return Some(if is_on { "switched on" } else { "switched off" }.to_owned());
    }
    let values: Vec<_> = SETTING_VALUES.iter().filter_map(|(field, unit)| value(&record[*field], unit)).collect();
    let verb = if record["restored"] == true { "restored" } else { "changed" };
    (!values.is_empty()).then(|| format!("{verb} to {}", values.join(" to ")))
}

fn value(value: &Value, unit: &str) -> Option<String> {
    match value {
        Value::Number(number) => Some(format!("{number} {unit}")),
        Value::String(text) => Some(format!("{text:?}")),
        _ => None,
    }
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

    /// Returns the line of a settings event with these fields, from its setting on.
    fn of_setting(rest: &serde_json::Value) -> String {
        let mut body = serde_json::json!({"seq": 4, "kind": "settings", "restored": true});
        body.as_object_mut().unwrap().extend(rest.as_object().unwrap().clone());
        let line = of(&body.to_string());
        line.split("settings ").last().unwrap().split_whitespace().collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn changes_are_said_with_their_values() {
        let limit = serde_json::json!({"setting": "force_limit", "force_n": 30.0});
        assert_eq!(of_setting(&limit), "force_limit restored to 30.0 N");
        let limits = serde_json::json!({"setting": "soft_limits", "minus_mm": 10.0, "plus_mm": 90.5});
        assert_eq!(of_setting(&limits), "soft_limits restored to 10.0 mm to 90.5 mm");
        assert_eq!(of_setting(&serde_json::json!({"setting": "overdrive", "enabled": true})), "overdrive switched on");
        assert_eq!(of_setting(&serde_json::json!({"setting": "tare"})), "tare");
        let changes = ["hosts: changed", "mdns: changed"];
        let reloaded = serde_json::json!({"seq": 5, "kind": "gateway", "event": "reloaded", "changes": changes});
        assert!(of(&reloaded.to_string()).ends_with("hosts: changed; mdns: changed"));
    }
}
