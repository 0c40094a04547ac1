//! Values of settings: how they are read, checked and described.

use std::ops::RangeInclusive;

use serde::de::DeserializeOwned;
use toml::Spanned;
use toml::de::{DeTable, DeValue, ValueDeserializer};

use super::{Applied, DeclaredKey, FileSection, SettingError, SettingsGroup};

/// Texts that describe a value: the default and the allowed values in Markdown, and the value in the example file in
/// TOML. The example file leaves out a key without an example.
#[derive(Debug, Clone)]
pub struct ValueTexts {
    pub default: String,
    pub range: String,
    pub example: String,
}

/// Reads and checks the value of a key.
type Reading<T> = Box<dyn Fn(&str, Spanned<DeValue<'_>>) -> Result<T, SettingError>>;

/// A value of a setting. The default stands for an absent value, unless that is an error.
pub struct SettingValue<T> {
    default: T,
    texts: ValueTexts,
    is_required: bool,
    read: Reading<T>,
}

impl<T> SettingValue<T> {
    /// A value whose default is written as `shown` in TOML.
    pub fn new(
        default: T,
        shown: &str,
        range: &str,
        read: impl Fn(&str, Spanned<DeValue<'_>>) -> Result<T, SettingError> + 'static,
    ) -> Self {
        let texts = ValueTexts { default: format!("`{shown}`"), range: range.to_owned(), example: shown.to_owned() };
        Self { default, texts, is_required: false, read: Box::new(read) }
    }

    /// Sets the texts of the default and of the example.
    #[must_use]
    pub fn shown(self, default: &str, example: &str) -> Self {
        let texts = ValueTexts { default: default.to_owned(), example: example.to_owned(), ..self.texts };
        Self { texts, ..self }
    }

    /// Takes the value of a key, and makes the key known.
    pub fn take(self, section: &mut FileSection<'_>, key: &'static str, doc: &'static str, applied: Applied) -> T {
        let value = section.table.remove(key);
        let offset = value.as_ref().map(|value| value.span().start);
        section.keys.push(DeclaredKey { key, doc, applied, texts: self.texts, offset });
        match value.map(|value| (self.read)(key, value)) {
            Some(Ok(value)) => return value,
            Some(Err(error)) => drop(section.error.get_or_insert(error)),
            None if self.is_required => section.fail(key, format_args!("missing field `{key}`")),
            None => {}
        }
        self.default
    }
}

/// Returns the error of the TOML parser, which is at `offset` unless it says otherwise.
fn toml_error(error: &toml::de::Error, offset: usize) -> SettingError {
    let offset = error.span().map_or(offset, |span| span.start);
    SettingError { offset, detail: error.message().to_owned() }
}

pub fn deserialize<T: DeserializeOwned>(value: Spanned<DeValue<'_>>) -> Result<T, SettingError> {
    let offset = value.span().start;
    T::deserialize(ValueDeserializer::from(value)).map_err(|error| toml_error(&error, offset))
}

/// Reads a file.
pub fn read_file<G: SettingsGroup>(text: &str) -> Result<G, SettingError> {
    G::read(0, DeTable::parse(text).map_err(|error| toml_error(&error, 0))?.into_inner())
}

/// A value that a function makes from another one. An error is at the value, and begins after the key.
pub fn parsed<R: DeserializeOwned, T>(
    default: T,
    shown: &str,
    range: &str,
    parse: impl Fn(R) -> Result<T, String> + 'static,
) -> SettingValue<T> {
    SettingValue::new(default, shown, range, move |key, value| {
        let offset = value.span().start;
        parse(deserialize(value)?).map_err(|detail| SettingError { offset, detail: format!("{key} {detail}") })
    })
}

/// A value of a type that `serde` can read. `shown` is the default in TOML.
pub fn plain<T: DeserializeOwned + 'static>(default: T, shown: &str, range: &str) -> SettingValue<T> {
    parsed(default, shown, range, Ok)
}

/// A value that is `None` if absent.
pub fn optional<T: DeserializeOwned>(range: &str, example: &str) -> SettingValue<Option<T>> {
    parsed(None, "", range, |given| Ok(Some(given))).shown("none", example)
}

/// A value that must not be absent. `blank` has its place in the defaults.
pub fn required<T: DeserializeOwned + 'static>(blank: T, range: &str, example: &str) -> SettingValue<T> {
    SettingValue { is_required: true, ..plain(blank, "", range).shown("required", example) }
}

/// `true` or `false`.
#[must_use]
pub fn flag(default: bool) -> SettingValue<bool> {
    plain(default, &default.to_string(), "`true`, `false`")
}

/// Allowed whole numbers, and the end of the message about any other.
pub struct WholeRange(RangeInclusive<u64>, String);

/// The whole numbers in a range. The remedy can be empty.
#[must_use]
pub fn between(range: RangeInclusive<u64>, remedy: &str) -> WholeRange {
    let rule = format!("it must be from {} to {}: {remedy}", range.start(), range.end());
    WholeRange(range, rule.trim_end_matches(": ").to_owned())
}

/// The whole numbers up to a greatest one.
#[must_use]
pub fn up_to(most: u64) -> WholeRange {
    WholeRange(0..=most, format!("at most {most} is allowed"))
}

/// A whole number, from which `convert` makes a value with a unit.
pub fn whole<T: 'static>(default: u64, WholeRange(range, rule): WholeRange, convert: fn(u64) -> T) -> SettingValue<T> {
    let text = format!("{} to {}", range.start(), range.end());
    parsed(convert(default), &default.to_string(), &text, move |number| {
        if range.contains(&number) { Ok(convert(number)) } else { Err(format!("is {number}; {rule}")) }
    })
}

/// A whole number that is `None` if absent.
pub fn optional_whole<T: 'static>(example: u64, range: WholeRange, convert: fn(u64) -> T) -> SettingValue<Option<T>> {
    let SettingValue { texts, read, .. } = whole(example, range, convert);
    SettingValue::new(None, &texts.example, &texts.range, move |key, value| read(key, value).map(Some))
        .shown("none", &texts.example)
}

/// A number with decimals.
#[must_use]
pub fn decimal(default: f64, range: RangeInclusive<f64>) -> SettingValue<f64> {
    let text = format!("{} to {}", range.start(), range.end());
    parsed(default, &format!("{default:?}"), &text.clone(), move |number| {
        if range.contains(&number) { Ok(number) } else { Err(format!("is {number}; it must be from {text}")) }
    })
}

/// A list of texts that a function checks. An error is at the text, and begins after the key.
pub fn list<T: 'static>(range: &str, example: &str, parse: fn(&str) -> Result<T, String>) -> SettingValue<Vec<T>> {
    let setting = SettingValue::new(Vec::new(), "[]", range, move |key, value| {
        let mut items = Vec::new();
        for text in deserialize::<Vec<Spanned<String>>>(value)? {
            let offset = text.span().start;
            let parsed = parse(text.get_ref());
            items.push(parsed.map_err(|detail| SettingError { offset, detail: format!("{key} {detail}") })?);
        }
        Ok(items)
    });
    setting.shown("`[]`", example)
}

/// A section that is `None` if absent.
pub fn section<G: SettingsGroup>() -> SettingValue<Option<G>> {
    SettingValue::new(None, "", "", |_, value| read_section(value).map(Some))
}

/// Sections that share a name, e.g. `[[clients]]`.
#[must_use]
pub fn sections<G: SettingsGroup>() -> SettingValue<Vec<G>> {
    SettingValue::new(Vec::new(), "", "", |key, value| match value.get_ref() {
        DeValue::Array(sections) => sections.iter().cloned().map(read_section).collect(),
        _ => Err(SettingError { offset: value.span().start, detail: format!("{key} is no list: write [[{key}]]") }),
    })
}

/// Sections with names of their own, e.g. `[grippers.left]`.
#[must_use]
pub fn named_sections<G: SettingsGroup>() -> SettingValue<Vec<(Spanned<String>, G)>> {
    SettingValue::new(Vec::new(), "", "", |_, value| {
        let mut sections = Vec::new();
        for (name, section) in table_of(value)?.1 {
            sections.push((Spanned::new(name.span(), name.into_inner().into_owned()), read_section(section)?));
        }
        Ok(sections)
    })
}

fn read_section<G: SettingsGroup>(value: Spanned<DeValue<'_>>) -> Result<G, SettingError> {
    let (offset, table) = table_of(value)?;
    G::read(offset, table)
}

fn table_of(value: Spanned<DeValue<'_>>) -> Result<(usize, DeTable<'_>), SettingError> {
    let offset = value.span().start;
    match value.into_inner() {
        DeValue::Table(table) => Ok((offset, table)),
        other => Err(SettingError { offset, detail: format!("{} in place of a section", other.type_str()) }),
    }
}
