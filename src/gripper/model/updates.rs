//! Rules for the automatic updates of a device.

use serde::Deserialize;

/// Moment at which the device sends its values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UpdateMode {
    /// Every period.
    #[default]
    Periodic,
    /// When a value has changed, at most once a period.
    Changes,
}

/// Automatic updates that a gateway requests from a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct UpdateRules {
    pub mode: UpdateMode,
    /// Shortest period in ms. A slow line makes the period longer.
    pub min_period_ms: u16,
    /// Number of devices that share the line.
    pub devices_on_line: u32,
}

impl UpdateRules {
    /// Shortest period in ms that a device accepts (`fw4-en 3.4.1`).
    pub const MIN_PERIOD_MS: u16 = 10;

    /// Longest configurable period in ms. Even at this period, a few missed updates show in time that a device is
    /// silent.
    pub const MAX_PERIOD_MS: u16 = 500;
}

impl Default for UpdateRules {
    fn default() -> Self {
        Self { mode: UpdateMode::default(), min_period_ms: Self::MIN_PERIOD_MS, devices_on_line: 1 }
    }
}
