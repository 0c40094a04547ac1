//! Pages and curves as CSV. The columns of a list are always the same, whatever fields its records have.

use serde_json::{Map, Value};

use crate::model::Sample;

/// Columns of events of all kinds.
pub const EVENT_COLUMNS: &[&str] = &[
    "seq",
    "at",
    "kind",
    "gripper",
    "subject",
    "door",
    "command_id",
    "phase",
    "command",
    "event",
    "outcome",
    "status",
    "status_code",
    "reached_goal",
    "stalled",
    "width_mm",
    "speed_mm_s",
    "force_n",
    "part_id",
    "direction",
    "relative",
    "on_block",
    "raw_id",
    "payload",
    "request_id",
    "holder",
    "requested_width_mm",
    "requested_speed_mm_s",
    "requested_force_n",
    "started_at",
    "duration_ms",
    "fast_stop_id",
    "cause",
    "reason",
    "cleared",
    "link",
    "link_cause",
    "known_serial_number",
    "serial_number",
    "flags",
    "setting",
    "restored",
    "acceleration_mm_s2",
    "minus_mm",
    "plus_mm",
    "enabled",
    "tag",
    "finger",
    "code",
    "count",
    "version",
    "gateway",
    "listen",
    "grippers",
    "running",
    "up_to_seq",
    "hash",
    "grips_up_to_seq",
    "grips_hash",
    "aggregated",
    "alarm_id",
    "alarm",
    "priority",
    "fast_stop_by",
    "fast_stop_reason",
    "label",
    "recipe",
    "recipe_version",
    "accept_min_mm",
    "accept_max_mm",
    "contact_width_mm",
    "other",
];

/// Columns of grip records.
pub const GRIP_COLUMNS: &[&str] = &[
    "seq",
    "id",
    "gripper",
    "kind",
    "part_id",
    "outcome",
    "subject",
    "started_at",
    "duration_ms",
    "width_mm",
    "force_n",
    "peak_force_n",
    "contact_width_mm",
    "time_to_contact_ms",
    "samples",
    "part_lost_at",
    "gateway",
    "serial_number",
    "holder",
    "request_id",
    "requested_width_mm",
    "requested_speed_mm_s",
    "requested_force_n",
    "code",
    "detail",
    "recipe",
    "recipe_version",
    "accept_min_mm",
    "accept_max_mm",
    "travel_mm",
    "other",
];

/// Characters that begin a formula in a spreadsheet, or that a spreadsheet skips before one.
const FORMULA_STARTS: [char; 11] = ['=', '+', '-', '@', '\t', '\r', '\n', '＝', '＋', '－', '＠'];

const CURVE_COLUMNS: [&str; 4] = ["t_ms", "width_mm", "speed_mm_s", "force_n"];

/// Formats the header line.
#[must_use]
pub fn header(columns: &[&str]) -> String {
    text(&[columns.iter().map(ToString::to_string).collect()])
}

/// Formats a line for each body. The last column takes, as JSON, all fields without a column of their own.
#[must_use]
pub fn lines<'a>(columns: &[&str], bodies: impl IntoIterator<Item = &'a str>) -> String {
    let rows: Vec<_> = bodies.into_iter().map(|body| row(columns, body)).collect();
    text(&rows)
}

/// Formats a header, and a line for each object. Fields without a column are left out.
#[must_use]
pub fn table(columns: &[&str], objects: impl IntoIterator<Item = Map<String, Value>>) -> String {
    header(columns) + &text(&objects.into_iter().map(|mut fields| cells(columns, &mut fields)).collect::<Vec<_>>())
}

/// Formats a curve, with its header.
#[must_use]
pub fn curve(samples: &[Sample]) -> String {
    let mut rows = vec![CURVE_COLUMNS.map(str::to_owned).to_vec()];
    rows.extend(samples.iter().map(|sample| {
        let Sample { t_ms, width_mm, speed_mm_s, force_n } = sample;
        vec![t_ms.to_string(), width_mm.to_string(), speed_mm_s.to_string(), force_n.to_string()]
    }));
    text(&rows)
}

fn row(columns: &[&str], body: &str) -> Vec<String> {
    let mut fields = match serde_json::from_str(body) {
        Ok(Value::Object(fields)) => fields,
        _ => Map::new(),
    };
    let Some((_other, columns)) = columns.split_last() else { return Vec::new() };
    let mut row = cells(columns, &mut fields);
    row.push(if fields.is_empty() { String::new() } else { Value::Object(fields).to_string() });
    row
}

/// Takes the columns' fields, as cells.
fn cells(columns: &[&str], fields: &mut Map<String, Value>) -> Vec<String> {
    columns.iter().map(|column| fields.remove(*column).map_or_else(String::new, cell)).collect()
}

/// Formats a cell: null is empty, and spaces separate the values of a list. Texts are made harmless; numbers stay as
/// they are, including negative ones.
fn cell(value: Value) -> String {
    match value {
        Value::String(_) | Value::Array(_) => harmless(plain(value)),
        other => plain(other),
    }
}

fn plain(value: Value) -> String {
    match value {
        Value::Null => String::new(),
        Value::String(text) => text,
        Value::Array(values) => values.into_iter().map(plain).collect::<Vec<_>>().join(" "),
        other => other.to_string(),
    }
}

/// Whether a spreadsheet would run a text as a formula, or would after the removal of its single quotes.
fn is_formula(text: &str) -> bool {
    text.trim_start_matches('\'').starts_with(FORMULA_STARTS)
}

/// Adds a single quote before a text that a spreadsheet would run as a formula, as OWASP advises against CSV injection.
/// Clients choose part ids, reasons, tags and names.
fn harmless(text: String) -> String {
    if is_formula(&text) { format!("'{text}") } else { text }
}

/// Returns a text as it was before it was made harmless.
#[must_use]
pub fn original(cell: &str) -> &str {
    cell.strip_prefix('\'').filter(|text| is_formula(text)).unwrap_or(cell)
}

fn text(rows: &[Vec<String>]) -> String {
    let mut writer = ::csv::Writer::from_writer(Vec::new());
    // Writing rows of equal length to memory does not fail.
    let _ = rows.iter().try_for_each(|row| writer.write_record(row));
    writer.into_inner().map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::super::row::Row;
    use super::super::tests::{admitted, done, grip, link, started};
    use super::*;
    use crate::model::Outcome;

    fn first_line(text: &str) -> Vec<String> {
        let mut reader = ::csv::Reader::from_reader(text.as_bytes());
        reader.headers().unwrap().iter().map(str::to_owned).collect()
    }

    #[test]
    fn every_field_has_a_column() {
        let bodies = [
            admitted(1, "left", 1, Some("P,\"1\"")),
            done(2, "left", 1, None, Outcome::NoPart),
            link(3, "g"),
            started(4),
        ]
        .map(|event| Row::event(super::super::chain::Tip::default(), &event).unwrap().body);
        let csv = header(EVENT_COLUMNS) + &lines(EVENT_COLUMNS, bodies.iter().map(|body| &**body));
        assert_eq!(first_line(&csv), EVENT_COLUMNS);
        let mut reader = ::csv::Reader::from_reader(csv.as_bytes());
        let rows: Vec<_> = reader.records().map(Result::unwrap).collect();
        assert_eq!(rows.len(), 4);
        let column = |name: &str| EVENT_COLUMNS.iter().position(|column| *column == name).unwrap();
        assert_eq!(&rows[0][column("part_id")], "P,\"1\"");
        assert_eq!(&rows[1][column("outcome")], "NO_PART");
        assert_eq!(&rows[2][column("link_cause")], "");
        assert!(rows.iter().all(|row| row[column("other")].is_empty()), "{csv}");

        let body = Row::grip(super::super::chain::Tip::default(), &grip(1, "left", 1, None)).unwrap().body;
        let csv = lines(GRIP_COLUMNS, [&*body]);
        assert!(csv.starts_with("1,") && csv.ends_with(",20,,gateway,4711,,,,,,,,,,,,7.6,\n"), "{csv}");
    }

    #[test]
    fn text_cell_is_never_a_formula() {
        for text in ["=1+1", "+1", "-1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", "＝1"] {
            for value in [Value::from(text), Value::from(vec![text])] {
                let body = serde_json::json!({"seq": -1, "part_id": value, "force_n": -2.5}).to_string();
                let csv = lines(&["part_id", "seq", "force_n", "other"], [&*body]);
                let mut reader = ::csv::ReaderBuilder::new().has_headers(false).from_reader(csv.as_bytes());
                let row = reader.records().next().unwrap().unwrap();
                assert_eq!((&row[0], &row[1], &row[2]), (&*format!("'{text}"), "-1", "-2.5"));
            }
        }
        assert_eq!(lines(&["part_id", "other"], [r#"{"part_id":"P=1-@"}"#]), "P=1-@,\n");
    }

    #[test]
    fn unknown_fields_go_into_the_last_column() {
        assert_eq!(
            lines(&["seq", "flags", "other"], [r#"{"seq":1,"flags":["A","B"],"new":"x"}"#]),
            "1,A B,\"{\"\"new\"\":\"\"x\"\"}\"\n"
        );
    }

    #[test]
    fn curve_has_a_header_and_a_line_per_sample() {
        let sample = Sample { t_ms: 10, width_mm: 20.5, speed_mm_s: -3.0, force_n: 0.25 };
        assert_eq!(curve(&[sample]), "t_ms,width_mm,speed_mm_s,force_n\n10,20.5,-3,0.25\n");
        assert_eq!(curve(&[]), "t_ms,width_mm,speed_mm_s,force_n\n");
    }
}
