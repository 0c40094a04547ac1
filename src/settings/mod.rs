//! Settings of the configuration file. A module declares its own with `settings!`: key, meaning, default, range, and
//! whether a reload can change it. The struct, its reading with all checks, the differences that a reload finds, the
//! tables of the guide and the example file are made from this declaration.

mod value;

use std::fmt::Display;

use toml::de::DeTable;

pub use value::deserialize;
pub use value::{
    SettingValue, ValueTexts, between, decimal, flag, list, named_sections, optional, optional_whole, parsed, plain,
    read_file, required, section, sections, up_to, whole,
};

/// A key of the configuration file.
#[derive(Debug, Clone)]
pub struct DeclaredKey {
    pub key: &'static str,
    /// Meaning in Markdown. Its first paragraph is the comment in the example file.
    pub doc: &'static str,
    pub applied: Applied,
    pub texts: ValueTexts,
    /// Place of the value in the file, in bytes.
    offset: Option<usize>,
}

/// How a running gateway takes a new value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Applied {
    Reload,
    Restart,
}

/// An error in the file: the place in bytes, and a description with the remedy.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SettingError {
    pub offset: usize,
    pub detail: String,
}

/// A section of the file. The default is empty.
#[derive(Debug, Default)]
pub struct FileSection<'a> {
    /// The keys that no setting has taken yet.
    table: DeTable<'a>,
    offset: usize,
    keys: Vec<DeclaredKey>,
    /// The first error.
    error: Option<SettingError>,
}

impl FileSection<'_> {
    /// Notes an error at the value of a key, unless there was one before.
    pub fn fail(&mut self, key: &str, detail: impl Display) {
        let place = self.keys.iter().find(|declared| declared.key == key).and_then(|declared| declared.offset);
        let offset = place.unwrap_or(self.offset);
        self.error.get_or_insert(SettingError { offset, detail: detail.to_string() });
    }
}

/// The settings of one module, which are keys of one section in the file.
pub trait SettingsGroup: Sized {
    /// Takes the keys from a section. An absent or wrong value leaves the default.
    fn take(section: &mut FileSection<'_>) -> Self;

    /// Returns the keys with different values.
    fn differences(&self, other: &Self) -> Vec<(&'static str, Applied)>;

    /// Returns all keys, in the order of the declaration.
    #[must_use]
    fn keys() -> Vec<DeclaredKey> {
        let mut section = FileSection::default();
        Self::take(&mut section);
        section.keys
    }

    /// Reads a section, or a whole file, that has no other keys.
    fn read(offset: usize, table: DeTable<'_>) -> Result<Self, SettingError> {
        let mut section = FileSection { table, offset, ..FileSection::default() };
        let settings = Self::take(&mut section);
        if let Some(unknown) = section.table.keys().min_by_key(|key| key.span().start) {
            let expected: Vec<_> = section.keys.iter().map(|key| format!("`{}`", key.key)).collect();
            let detail = format!("unknown field `{}`, expected one of {}", unknown.get_ref(), expected.join(", "));
            return Err(SettingError { offset: unknown.span().start, detail });
        }
        section.error.map_or(Ok(settings), Err)
    }
}

/// Declares a struct of settings, with its defaults.
///
/// A setting is `field: Type = "key", value, Reload` or `Restart`, with its meaning as doc comment; `value.rs` has the
/// values. Settings of other modules follow as `group field: Type`, fields that no key sets as
/// `also field: Type = value`, and at last a function that checks several settings together as `check function`.
#[macro_export]
macro_rules! settings {
    ($(#[$meta:meta])* $vis:vis struct $name:ident {
        $($(#[doc = $doc:literal])+ $field_vis:vis $field:ident: $type:ty = $key:literal, $value:expr, $applied:ident;)*
        $(group $group:ident: $group_type:ty;)*
        $(also $also:ident: $also_type:ty = $also_value:expr;)*
        $(check $check:path;)?
    }) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq)]
        $vis struct $name {
            $($(#[doc = $doc])+ $field_vis $field: $type,)*
            $(pub $group: $group_type,)*
            $(pub $also: $also_type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                $crate::SettingsGroup::take(&mut $crate::FileSection::default())
            }
        }

        impl $crate::SettingsGroup for $name {
            fn take(section: &mut $crate::FileSection<'_>) -> Self {
                use $crate::Applied;
                let settings = Self {
                    $($field: $value.take(section, $key, concat!($($doc, "\n"),+), Applied::$applied),)*
                    $($group: $crate::SettingsGroup::take(section),)*
                    $($also: $also_value,)*
                };
                $($check(&settings, section);)?
                settings
            }

            #[allow(clippy::float_cmp, reason = "any other value is a new one")]
            fn differences(&self, other: &Self) -> Vec<(&'static str, $crate::Applied)> {
                use $crate::Applied;
                let mut keys = Vec::new();
                $(if self.$field != other.$field {
                    keys.push(($key, Applied::$applied));
                })*
                $(keys.extend(self.$group.differences(&other.$group));)*
                keys
            }
        }
    };
}
