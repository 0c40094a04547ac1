//! Settings of drift warnings.

use std::ops::RangeInclusive;

use serde::Deserialize;
use toml::Spanned;

use super::{ConfigError, File};
use crate::wear::{DEFAULT_DRIFT_LIMITS, DriftLimits};

/// The `drift` table of the file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DriftContent {
    warnings: Option<bool>,
    sigmas: Option<Spanned<f64>>,
    min_mm: Option<Spanned<f64>>,
}

/// Returns the drift limits; `None` if drift is not watched.
pub(super) fn limits(file: Option<&File>) -> Result<Option<DriftLimits>, ConfigError> {
    let Some((file, content)) = file.and_then(|file| Some((file, file.content.drift.as_ref()?))) else {
        return Ok(Some(DEFAULT_DRIFT_LIMITS));
    };
    let number = |key, given: &Option<Spanned<f64>>, allowed: RangeInclusive<f64>, default| match given {
        None => Ok(default),
        Some(given) if allowed.contains(given.get_ref()) => Ok(*given.get_ref()),
        Some(given) => {
            let (least, most) = allowed.into_inner();
            let detail = format!("{key} is {}; it must be from {least} to {most}", given.get_ref());
            Err(ConfigError::at(&file.place(given.span().start), detail))
        }
    };
    let limits = DriftLimits {
        sigmas: number("sigmas", &content.sigmas, 1.0..=100.0, DEFAULT_DRIFT_LIMITS.sigmas)?,
        min_mm: number("min_mm", &content.min_mm, 0.001..=100.0, DEFAULT_DRIFT_LIMITS.min_mm)?,
    };
    Ok(Some(limits).filter(|_| content.warnings != Some(false)))
}
