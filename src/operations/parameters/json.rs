//! JSON from clients: objects parsed into parameters, and values without duplicate keys.

use std::fmt;

use serde::de::value::MapDeserializer;
use serde::de::{Deserialize, DeserializeOwned, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde::forward_to_deserialize_any;
use serde_json::{Map, Value};

use crate::model::{Code, without_byte_order_mark};
use crate::operations::problem::Problem;

/// Largest accepted body, message or payload, in bytes. The largest that any request needs is a `raw` one of 8 KiB.
pub const MAX_BODY_BYTES: usize = 64 * 1024;

/// Maximum number of bytes that are read of an oversized body or message. Only a FAST STOP in a message counts. Bodies
/// are read and discarded, because an HTTP client that is still sending when the connection closes sees a reset instead
/// of the response with the reason.
pub const MAX_OVERSIZED_BYTES: usize = 2 * 1024 * 1024;

/// Parses the JSON object in `bytes` as described at [`object`], and its fields as described at [`of_object`].
///
/// # Errors
/// A problem that names the wrong field, if there is one.
pub fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    of_object(&object(bytes)?)
}

/// Parses a JSON object without duplicate keys. Empty input and `null` stand for an empty object: some clients, such as
/// generated Go clients, send `null` when they have no body. A byte order mark before the object is ignored, and so are
/// NUL bytes after it: some PLCs send a whole buffer.
///
/// # Errors
/// A problem that names the wrong field, if there is one.
pub fn object(bytes: &[u8]) -> Result<Map<String, Value>, Problem> {
    let bytes = trimmed(bytes);
    match bytes {
        [] | b"null" => return Ok(Map::new()),
        [b'{', ..] => {}
        _ => return Err(Problem::new(Code::Malformed, "the body must be a JSON object")),
    }
    let mut json = serde_json::Deserializer::from_slice(bytes);
    let parsed = serde_path_to_error::deserialize(&mut json).map_err(|error| problem(&error, |_| None))?;
    json.end().map_err(|error| Problem::new(Code::Malformed, format!("invalid JSON body: {error}")))?;
    match parsed {
        StrictJson(Value::Object(object)) => Ok(object),
        StrictJson(_) => Err(Problem::internal()),
    }
}

/// Largest text that [`text_member`] parses, in bytes. All FAST STOPs are served on one runtime, and a large text
/// takes time.
const MAX_SEARCHED_BYTES: usize = 4 * 1024;

/// Returns a string member of a JSON object, or `None` if `bytes` are not JSON or exceed 4 KiB.
#[must_use]
pub fn text_member(bytes: &[u8], key: &str) -> Option<String> {
    if bytes.len() > MAX_SEARCHED_BYTES {
        return None;
    }
    serde_json::from_slice::<Value>(trimmed(bytes)).ok()?.get(key)?.as_str().map(ToOwned::to_owned)
}

/// Returns `bytes` without a byte order mark and white space at the start, and without NUL bytes and white space at the
/// end. Bytes that are all NUL stay, since they are not JSON.
fn trimmed(bytes: &[u8]) -> &[u8] {
    let bytes = without_byte_order_mark(bytes);
    let end = bytes.iter().rposition(|byte| *byte != 0).map_or(bytes.len(), |last| last + 1);
    let bytes = &bytes[..end];
    let start = bytes.iter().position(|byte| !is_space(*byte)).unwrap_or(bytes.len());
    let end = bytes.iter().rposition(|byte| !is_space(*byte)).map_or(start, |last| last + 1);
    &bytes[start..end]
}

/// White space of JSON, which has no form feed (RFC 8259, 2), unlike `trim_ascii`.
fn is_space(byte: u8) -> bool {
    b" \t\r\n".contains(&byte)
}

/// Parses the fields of an object. An optional field that is `null` counts as absent, and a required one as missing.
///
/// # Errors
/// A problem that names the field.
pub fn of_object<T: DeserializeOwned>(object: &Map<String, Value>) -> Result<T, Problem> {
    serde_path_to_error::deserialize(GivenFields(object))
        .map_err(|error| problem(&error, |field| object.get(field).cloned()))
}

/// Deserializer of an object that leaves out the fields of a struct that are `null`. A field that the struct does not
/// have stays, so that it is refused by its name.
struct GivenFields<'de>(&'de Map<String, Value>);

impl<'de> Deserializer<'de> for GivenFields<'de> {
    type Error = serde_json::Error;

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        known: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Self::Error> {
        let fields = self.0.iter().map(|(name, value)| (name.as_str(), value));
        visitor
            .visit_map(MapDeserializer::new(fields.filter(|(name, value)| !value.is_null() || !known.contains(name))))
    }

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, Self::Error> {
        self.0.deserialize_any(visitor)
    }

    forward_to_deserialize_any! {
        bool i8 i16 i32 i64 u8 u16 u32 u64 f32 f64 char str string bytes byte_buf option unit unit_struct newtype_struct
        seq tuple tuple_struct map enum identifier ignored_any
    }
}

fn problem(
    error: &serde_path_to_error::Error<serde_json::Error>,
    value: impl FnOnce(&str) -> Option<Value>,
) -> Problem {
    let text = without_position(error.inner());
    // The path has a `?` if the JSON is cut short.
    let path =
        Some(error.path().to_string()).filter(|path| !matches!(path.as_str(), "." | "?") && !path.ends_with(".?"));
    let described = match path {
        // The value is not valid JSON.
        Some(path) if !error.inner().is_data() => Some((path.clone(), format!("invalid JSON at {path}: {text}"))),
        path => describe(&text, path.as_deref()),
    };
    match described {
        Some((field, detail)) => {
            let value = value(&field);
            Problem::malformed(field, detail).value(value)
        }
        None => Problem::new(Code::Malformed, format!("invalid JSON body: {text}")),
    }
}

/// Reports JSON that is not a valid message, with the same texts as [`parse`].
pub fn invalid(what: &str, error: &serde_json::Error) -> Problem {
    let text = without_position(error);
    match describe(&text, None) {
        Some((field, detail)) => Problem::malformed(field, detail),
        None => Problem::new(Code::Malformed, format!("invalid {what}: {text}")),
    }
}

/// The parser's text. If the JSON itself is valid, a field locates the error, so line and column are left out.
fn without_position(error: &serde_json::Error) -> String {
    let mut text = error.to_string();
    let position = format!(" at line {} column {}", error.line(), error.column());
    if error.is_data() && text.ends_with(&position) {
        text.truncate(text.len() - position.len());
    }
    text
}

/// Returns the field that an error is about, and a description. Only the parser's text has the name of a missing,
/// unknown or duplicate field; all other errors concern the field at `path`.
fn describe(text: &str, path: Option<&str>) -> Option<(String, String)> {
    if let Some((field, _)) = field_after("missing field `", text) {
        return Some((field.clone(), format!("{field} is missing")));
    }
    if let Some((field, _)) = field_after("duplicate field `", text) {
        return Some((field.clone(), format!("{field} is given more than once")));
    }
    if let Some((field, rest)) = field_after("unknown field `", text) {
        let known = rest.strip_prefix(", expected ").map(|known| known.trim_start_matches("one of ").replace('`', ""));
        let known = known.map_or_else(|| "no field is allowed here".to_owned(), |known| format!("known: {known}"));
        return Some((field.clone(), format!("unknown field {field}; {known}")));
    }
    let field: String = path?.chars().take(MAX_FIELD_CHARS).collect();
    let must_be = text.split_once("expected ").map(|(_, expected)| words(expected));
    let detail = must_be.map_or_else(|| format!("{field}: {text}"), |must_be| format!("{field} must be {must_be}"));
    Some((field, detail))
}

/// Returns the field that the parser's text names after `start`, and the rest of the text.
fn field_after<'a>(start: &str, text: &'a str) -> Option<(String, &'a str)> {
    let (field, rest) = text.strip_prefix(start)?.split_once('`')?;
    Some((field.chars().take(MAX_FIELD_CHARS).collect(), rest))
}

/// Name of an expected type, in JSON's terms instead of Rust's.
fn words(expected: &str) -> String {
    match expected {
        "f32" | "f64" => "a number".to_owned(),
        "i8" | "i16" | "i32" | "i64" | "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number".to_owned(),
        "a boolean" => "true or false".to_owned(),
        // An enumeration without values is a text.
        "a string" | "string" | "a borrowed string" | "string or map" => "a string".to_owned(),
        "a sequence" => "a list".to_owned(),
        "a map" => "an object".to_owned(),
        expected if expected.starts_with("struct ") => "an object".to_owned(),
        expected => expected.replace('`', ""),
    }
}

/// Characters of an unknown field's name that are repeated to its sender.
const MAX_FIELD_CHARS: usize = 32;

/// A JSON value without duplicate keys. If a key occurs twice, serde_json's own value keeps the last and other parsers
/// keep the first, so a check and the execution could see different values.
#[derive(Debug)]
pub struct StrictJson(pub Value);

impl<'de> Deserialize<'de> for StrictJson {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(StrictValue).map(Self)
    }
}

struct StrictValue;

impl<'de> Visitor<'de> for StrictValue {
    type Value = Value;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("JSON")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut elements: A) -> Result<Value, A::Error> {
        let mut array = Vec::new();
        while let Some(StrictJson(element)) = elements.next_element()? {
            array.push(element);
        }
        Ok(array.into())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Value, A::Error> {
        let mut object = Map::new();
        while let Some((key, StrictJson(value))) = entries.next_entry::<String, _>()? {
            if object.contains_key(&key) {
                return Err(A::Error::custom(format_args!("duplicate field `{key}`")));
            }
            object.insert(key, value);
        }
        Ok(object.into())
    }
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;
    use serde_json::{from_str, json};

    use super::*;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Move {
        width_mm: f64,
        #[serde(default)]
        relative: bool,
    }

    fn problem(body: &[u8]) -> Value {
        let problem = parse::<Move>(body).unwrap_err();
        serde_json::to_value(problem.members()).unwrap()
    }

    #[test]
    fn object_is_parsed() {
        assert_eq!(parse::<Move>(br#" {"width_mm": 96.0} "#).unwrap(), Move { width_mm: 96.0, relative: false });
        assert_eq!(
            parse::<Move>(br#"{"width_mm":96,"relative":true}"#).unwrap(),
            Move { width_mm: 96.0, relative: true }
        );
    }

    #[test]
    fn empty_body_is_an_empty_object() {
        #[derive(Deserialize)]
        struct Nothing {}
        for nothing in [&b""[..], b" \r\n", b"{}", b"null", b" null\r\n\0", b"\xEF\xBB\xBF", b"\xEF\xBB\xBF {}"] {
            let Nothing {} = parse(nothing).unwrap();
        }
        assert_eq!(problem(b"")["field"], "width_mm");
        assert_eq!(problem(b"null")["detail"], "width_mm is missing");
    }

    #[test]
    fn null_field_counts_as_absent() {
        let body = br#"{"width_mm": 96, "relative": null}"#;
        assert_eq!(parse::<Move>(body).unwrap(), Move { width_mm: 96.0, relative: false });
    }

    #[test]
    fn wrong_field_is_named() {
        let wrong_type = problem(br#"{"width_mm": "20"}"#);
        assert_eq!((&wrong_type["code"], &wrong_type["field"]), (&"malformed".into(), &"width_mm".into()));
        assert_eq!(wrong_type["value"], "20");
        assert_eq!(problem(br#"{"width_mm": 20, "relative": 1}"#)["field"], "relative");
        assert_eq!(problem(br#"{"relative": true}"#)["field"], "width_mm");
        assert_eq!(problem(br#"{"widht_mm": 20}"#)["field"], "widht_mm");
        assert_eq!(problem(br#"{"width_mm": 20, "width_mm": 30}"#)["field"], "width_mm");
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Nothing {}

    #[test]
    fn errors_are_told_in_a_clients_words() {
        #[derive(Debug, Deserialize)]
        #[serde(rename_all = "snake_case")]
        enum Side {
            Inner,
            Outer,
        }
        #[derive(Debug, Deserialize)]
        #[serde(deny_unknown_fields)]
        #[allow(dead_code, reason = "only parsed")]
        struct Body {
            width_mm: f64,
            relative: Option<bool>,
            lease: Option<String>,
            side: Option<Side>,
            name: Option<crate::operations::parameters::values::TextOrNumber>,
            count: Option<u8>,
        }
        for (body, detail) in [
            ("{}", "width_mm is missing"),
            (r#"{"width_mm": 1, "width_mm": 2}"#, "width_mm is given more than once"),
            (r#"{"width": 1}"#, "unknown field width; known: width_mm, relative, lease, side, name, count"),
            (r#"{"width_mm": NaN}"#, "invalid JSON at width_mm: expected value at line 1 column 14"),
            (r#"{"width_mm": "20"}"#, "width_mm must be a number"),
            (r#"{"width_mm": null}"#, "width_mm is missing"),
            (
                r#"{"width_mm": 1, "widht_mm": null}"#,
                "unknown field widht_mm; known: width_mm, relative, lease, side, name, count",
            ),
            (r#"{"width_mm": 1, "relative": 1}"#, "relative must be true or false"),
            (r#"{"width_mm": 1, "lease": 1}"#, "lease must be a string"),
            (r#"{"width_mm": 1, "side": "up"}"#, "side must be inner or outer"),
            (r#"{"width_mm": 1, "side": 7}"#, "side must be a string"),
            (r#"{"width_mm": 1, "side": [null]}"#, "side must be a string"),
            (r#"{"width_mm": 1, "name": {}}"#, "name must be a string or a whole number"),
            (r#"{"width_mm": 1, "count": 300}"#, "count must be a whole number"),
        ] {
            assert_eq!(parse::<Body>(body.as_bytes()).unwrap_err().detail(), detail, "{body}");
            if let Ok(object) = from_str::<Map<String, Value>>(body)
                && !detail.ends_with("once")
            {
                assert_eq!(of_object::<Body>(&object).unwrap_err().detail(), detail, "{body}");
            }
        }
        assert_eq!(parse::<Nothing>(br#"{"a": 1}"#).unwrap_err().detail(), "unknown field a; no field is allowed here");
    }

    #[test]
    fn truncated_json_names_no_field() {
        for body in [&br#"{"width_mm": 20"#[..], b"{", b"{\"width_mm\": 20,, \"relative\": true}"] {
            assert_eq!(problem(body)["field"], Value::Null, "{}", String::from_utf8_lossy(body));
        }
    }

    #[test]
    fn anything_but_an_object_is_malformed() {
        let bodies: [&[u8]; 12] = [
            b"\x0c",
            b"[20, true]",
            b"20",
            b"nullnull",
            b"null {}",
            b"\"x\"",
            b"{\"width_mm\": NaN}",
            b"{\"width_mm\": 1e999}",
            b"{\"width_mm\": 20} {}",
            b"{\"width_mm\": 20",
            b"{\"width_mm\": \"\xFF\"}",
            b"width_mm=20",
        ];
        for body in bodies {
            assert_eq!(problem(body)["code"], "malformed", "{}", String::from_utf8_lossy(body));
        }
    }

    #[test]
    fn long_value_is_not_repeated() {
        let body = format!("{{\"width_mm\": \"{}\"}}", "x".repeat(1000));
        let problem = problem(body.as_bytes());
        assert_eq!((problem["field"].as_str(), problem.get("value")), (Some("width_mm"), None));
    }

    #[test]
    fn strict_json_rejects_only_duplicate_keys() {
        let text = r#"{"a": [1, -2, 0.5, "b", null, true, {"a": {}}], "b": 18446744073709551615}"#;
        assert_eq!(from_str::<StrictJson>(text).unwrap().0, from_str::<Value>(text).unwrap());
        assert_eq!(from_str::<StrictJson>("7").unwrap().0, json!(7));
        for text in [r#"{"a": 1, "a": 1}"#, r#"[{"b": {"a": 1, "a": 2}}]"#] {
            assert!(from_str::<StrictJson>(text).unwrap_err().to_string().starts_with("duplicate field `a`"), "{text}");
        }
    }
}
