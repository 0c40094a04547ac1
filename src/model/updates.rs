//! Rules for the automatic updates of a device.

use serde::Deserialize;

use settings::{SettingValue, between, plain, settings, whole};

/// Moment at which the device sends its values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UpdateMode {
    /// Every period.
    Periodic,
    /// When a value has changed, at most once a period.
    Changes,
}

settings! {
    /// Automatic updates that a gateway requests from a device.
    #[derive(Copy, Eq)]
    pub struct UpdateRules {
        /// Shortest period at which the gripper sends its values, in ms.
        pub min_period_ms: u16 = "update_period_ms", period(), Reload;
        /// Whether the gripper sends its values in every period, or when they change, to relieve a CAN bus.
        pub mode: UpdateMode = "updates",
            plain(UpdateMode::Periodic, "\"periodic\"", "`\"periodic\"`, `\"changes\"`"), Reload;
        // Number of devices that share the line.
        also devices_on_line: u32 = 1;
    }
}

/// From the shortest period that a device accepts (`fw4-en 3.4.1`) to one at which a few missed updates still show in
/// time that the device is silent.
fn period() -> SettingValue<u16> {
    let range = between(10..=500, "leave it out for the shortest period that the line allows");
    whole(10, range, |ms| ms as u16).shown("as short as the line allows", "10")
}
