//! The TOML file.

use std::collections::BTreeSet;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use toml::Spanned;

use super::journal::bounded;
use super::{
    ConfigError, ConfigPlace, Content, DEFAULT_MOTION_PAUSE, GripperConfig, GripperContent, LONGEST_MOTION_PAUSE,
    WsgPort, modbus, owned, parse_device,
};
use crate::gripper::model::lease::{MAX_TTL, MIN_TTL};
use crate::gripper::model::{CustomIds, LeaseRules, UpdateRules};

/// A parsed file, with its text for finding line numbers.
#[derive(Debug)]
pub struct File {
    path: PathBuf,
    text: String,
    pub(super) content: Content,
}

impl File {
    /// # Errors
    /// [`ConfigError`] if the file cannot be read or its content is invalid.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let failed = |error: io::Error| {
            let detail = match error.kind() {
                io::ErrorKind::NotFound => "does not exist: check the path".to_owned(),
                _ => format!("{error}: check that this is a text file that the gateway's user can read"),
            };
            ConfigError::at(&ConfigPlace::WholeFile(owned(path)), detail)
        };
        Self::parse(path, std::fs::read_to_string(path).map_err(failed)?)
    }

    /// Parses a file's text.
    ///
    /// # Errors
    /// [`ConfigError`] if the content is invalid.
    pub fn parse(path: &Path, text: String) -> Result<Self, ConfigError> {
        let content = toml::from_str(&text).map_err(|error: toml::de::Error| {
            let line = line_of(&text, error.span().map_or(0, |span| span.start));
            ConfigError::at(&ConfigPlace::File { path: owned(path), line }, error.message())
        })?;
        Ok(Self { path: owned(path), text, content })
    }

    /// Resolves a path in the file relative to the file's directory.
    pub(super) fn beside(&self, path: &Path) -> PathBuf {
        self.path.parent().map_or_else(|| path.to_owned(), |directory| directory.join(path))
    }

    /// Place of the byte at `offset`.
    pub(super) fn place(&self, offset: usize) -> ConfigPlace {
        ConfigPlace::File { path: self.path.clone(), line: line_of(&self.text, offset) }
    }

    pub(super) fn grippers(&self) -> Result<Vec<GripperConfig>, ConfigError> {
        let parse = |(name, gripper): (&toml::Spanned<String>, &super::GripperContent)| {
            let place = self.place(gripper.url.span().start);
            Ok(GripperConfig {
                name: name.get_ref().parse().map_err(|error| ConfigError::at(&self.place(name.span().start), error))?,
                device: parse_device(gripper.url.get_ref(), &place)?,
                fast_stop_on_disconnect: gripper.fast_stop_on_disconnect.unwrap_or(true),
                custom_ids: self.custom_ids(gripper)?,
                updates: self.update_rules(gripper)?,
                motion_pause: self.motion_pause(gripper)?,
                lease: self.lease_rules(gripper)?,
                wsg_port: WsgPort::of_file(self, gripper)?,
                modbus_unit: modbus::unit(self, gripper)?,
                place,
            })
        };
        self.content.grippers.iter().map(parse).collect()
    }
}

impl File {
    fn update_rules(&self, gripper: &GripperContent) -> Result<UpdateRules, ConfigError> {
        let allowed = UpdateRules::MIN_PERIOD_MS.into()..=UpdateRules::MAX_PERIOD_MS.into();
        let remedy = "leave it out for the shortest period that the line allows";
        let period_ms = bounded(Some(self), "update_period_ms", gripper.update_period_ms.as_ref(), allowed, remedy)?;
        let min_period_ms = period_ms.map_or(UpdateRules::MIN_PERIOD_MS, |period_ms| period_ms as u16);
        Ok(UpdateRules { mode: gripper.updates, min_period_ms, ..UpdateRules::default() })
    }

    fn custom_ids(&self, gripper: &GripperContent) -> Result<CustomIds, ConfigError> {
        let read = self.script_ids("read_ids", gripper.read_ids.as_ref())?;
        let stream = self.script_ids("stream_ids", gripper.stream_ids.as_ref())?;
        if let (Some(both), Some(place)) = (stream.intersection(&read).next(), &gripper.stream_ids) {
            let detail = format!("{both} is in read_ids and stream_ids: keep it in one of them");
            return Err(ConfigError::at(&self.place(place.span().start), detail));
        }
        Ok(CustomIds { read, stream })
    }

    fn motion_pause(&self, gripper: &GripperContent) -> Result<Duration, ConfigError> {
        let Some(ms) = &gripper.motion_pause_ms else { return Ok(DEFAULT_MOTION_PAUSE) };
        let pause = Duration::from_millis(*ms.get_ref());
        if pause > LONGEST_MOTION_PAUSE {
            let detail = format!("motion_pause_ms is {}; it must be from 0 to 1000", ms.get_ref());
            return Err(ConfigError::at(&self.place(ms.span().start), detail));
        }
        Ok(pause)
    }

    /// Parses ids of scripts on the gripper. The effect of the manual's ids is known, so they cannot be declared.
    fn script_ids(&self, field: &str, ids: Option<&Spanned<BTreeSet<u8>>>) -> Result<BTreeSet<u8>, ConfigError> {
        let Some(ids) = ids else { return Ok(BTreeSet::new()) };
        if let Some((id, name)) = ids.get_ref().iter().find_map(|&id| Some((id, CustomIds::name_in_manual(id)?))) {
            let detail =
                format!("{field} contains {id} ({id:02X}h), which is {name} in the manual: list only ids of scripts");
            return Err(ConfigError::at(&self.place(ids.span().start), detail));
        }
        Ok(ids.get_ref().clone())
    }

    fn lease_rules(&self, gripper: &GripperContent) -> Result<LeaseRules, ConfigError> {
        let default = LeaseRules::default();
        let max_ttl = match &gripper.lease_max_ttl_ms {
            None => default.max_ttl,
            Some(ms) => {
                let ttl = Duration::from_millis(*ms.get_ref());
                if !(MIN_TTL..=MAX_TTL).contains(&ttl) {
                    let (min, max) = (MIN_TTL.as_millis(), MAX_TTL.as_millis());
                    let detail = format!("lease_max_ttl_ms is {}; it must be from {min} to {max}", ms.get_ref());
                    return Err(ConfigError::at(&self.place(ms.span().start), detail));
                }
                ttl
            }
        };
        Ok(LeaseRules {
            on_loss_moving: self.one_or_more(
                "on_loss_moving",
                gripper.on_loss_moving.as_ref(),
                default.on_loss_moving,
            )?,
            on_loss_holding: self.one_or_more(
                "on_loss_holding",
                gripper.on_loss_holding.as_ref(),
                default.on_loss_holding,
            )?,
            max_ttl,
        })
    }

    fn one_or_more<T: Clone>(
        &self,
        key: &str,
        given: Option<&Spanned<Vec<T>>>,
        default: Vec<T>,
    ) -> Result<Vec<T>, ConfigError> {
        match given {
            None => Ok(default),
            Some(words) if words.get_ref().is_empty() => {
                let detail = format!("{key} is empty: list what clients can choose, the default first");
                Err(ConfigError::at(&self.place(words.span().start), detail))
            }
            Some(words) => Ok(words.get_ref().clone()),
        }
    }
}

fn line_of(text: &str, offset: usize) -> usize {
    1 + text.bytes().take(offset).filter(|&byte| byte == b'\n').count()
}
