//! Information about a gripper's device, served by every interface as one flat body.

use std::sync::Arc;

use serde::Serialize;
use utoipa::ToSchema;

use model::{CustomIds, Link, Name};
use wsg::{DeviceTag, Force, SystemInfo, SystemLimits};

/// A gripper and its device.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(example = json!({
    "gripper": "left", "link": "connected", "link_cause": null, "url": "tcp://192.168.1.20:1000",
    "transport": "tcp", "stops_on_gateway_loss": true, "device_type": "WSG 50", "device_type_code": 1,
    "hardware_revision": 6, "firmware": "4.0.2", "serial_number": 4711, "device_tag": "cell 7", "stroke_mm": 110.0,
    "min_speed_mm_s": 5.0, "max_speed_mm_s": 420.0, "min_acceleration_mm_s2": 100.0,
    "max_acceleration_mm_s2": 5000.0, "min_force_n": 5.0, "nominal_force_n": 80.0, "overdrive_force_n": 120.0,
    "capabilities": ["temperature", "fingers", "overdrive"]
}))]
pub struct Info {
    /// Name of the gripper.
    pub gripper: Name,
    /// Connection state of the device link.
    pub link: Link,
    /// Reason that the link is not connected; null while it is.
    #[schema(required)]
    pub link_cause: Option<String>,
    /// URL of the device.
    pub url: String,
    /// Transport: `tcp`, `udp`, `serial`, `can` or `sim`.
    pub transport: &'static str,
    /// Whether a moving gripper stops by itself if the gateway dies. It does on TCP, unless `fast_stop_on_disconnect` is
    /// off in the configuration.
    pub stops_on_gateway_loss: bool,
    /// Model of the device; null until the first connection, as are all following values.
    #[schema(required)]
    pub device_type: Option<String>,
    /// Number of the model.
    #[schema(required, minimum = 0, maximum = 255)]
    pub device_type_code: Option<u8>,
    /// Hardware revision.
    #[schema(required, minimum = 0, maximum = 255)]
    pub hardware_revision: Option<u8>,
    /// Firmware version.
    #[schema(required)]
    pub firmware: Option<String>,
    /// Serial number.
    #[schema(required, format = Int64, minimum = 0, maximum = 4_294_967_295_i64)]
    pub serial_number: Option<u32>,
    /// Device tag; null if none is set.
    #[schema(required, max_length = 64)]
    pub device_tag: Option<String>,
    /// Stroke in mm: opening widths range from 0 to this value.
    #[schema(required, minimum = 0, maximum = 1000)]
    pub stroke_mm: Option<f32>,
    /// Lowest speed in mm/s.
    #[schema(required, minimum = 0, maximum = 10000)]
    pub min_speed_mm_s: Option<f32>,
    /// Highest speed in mm/s.
    #[schema(required, minimum = 0, maximum = 10000)]
    pub max_speed_mm_s: Option<f32>,
    /// Lowest acceleration in mm/s².
    #[schema(required, minimum = 0, maximum = 1_000_000)]
    pub min_acceleration_mm_s2: Option<f32>,
    /// Highest acceleration in mm/s².
    #[schema(required, minimum = 0, maximum = 1_000_000)]
    pub max_acceleration_mm_s2: Option<f32>,
    /// Lowest gripping force in N.
    #[schema(required, minimum = 0, maximum = 10000)]
    pub min_force_n: Option<f32>,
    /// Highest gripping force in N without Overdrive Mode.
    #[schema(required, minimum = 0, maximum = 10000)]
    pub nominal_force_n: Option<f32>,
    /// Highest gripping force in N with Overdrive Mode.
    #[schema(required, minimum = 0, maximum = 10000)]
    pub overdrive_force_n: Option<f32>,
    /// Additional features of this model and firmware: `temperature`, `fingers`, `overdrive`.
    pub capabilities: Vec<&'static str>,
    /// Meaning of the ids of the gripper's scripts.
    #[serde(skip)]
    pub(super) custom_ids: Arc<CustomIds>,
    /// Period of the device's updates.
    #[serde(skip)]
    pub update_period_ms: u16,
}

/// First major firmware version with the finger interface and Get Temperature (`fw4-en 3.4.7`, `3.6`).
const FIRST_FW4: u8 = 4;

impl Info {
    /// Information about a device that has not been reached yet.
    #[must_use]
    pub fn unknown(gripper: Name, url: String, transport: &'static str, stops_on_gateway_loss: bool) -> Self {
        Self {
            gripper,
            link: Link::Connecting,
            link_cause: None,
            url,
            transport,
            stops_on_gateway_loss,
            device_type: None,
            device_type_code: None,
            hardware_revision: None,
            firmware: None,
            serial_number: None,
            device_tag: None,
            stroke_mm: None,
            min_speed_mm_s: None,
            max_speed_mm_s: None,
            min_acceleration_mm_s2: None,
            max_acceleration_mm_s2: None,
            min_force_n: None,
            nominal_force_n: None,
            overdrive_force_n: None,
            capabilities: Vec::new(),
            custom_ids: Arc::default(),
            update_period_ms: 0,
        }
    }

    /// Whether the firmware is known to take no device tags other than ASCII (`fw4-en 3.5.2`).
    #[must_use]
    pub fn demands_ascii_tags(&self) -> bool {
        let major = self.firmware.as_deref().and_then(|firmware| firmware.split('.').next()?.parse::<u8>().ok());
        major.is_some_and(|major| major >= FIRST_FW4)
    }

    /// Takes the information that the device reported during setup.
    pub(super) fn learn(&mut self, system: &SystemInfo, limits: &SystemLimits, tag: Option<&DeviceTag>) {
        self.device_type = Some(system.device_type.to_string());
        self.device_type_code = Some(system.device_type.code());
        self.hardware_revision = Some(system.hardware_revision);
        self.firmware = Some(system.firmware.to_string());
        self.serial_number = Some(system.serial_number);
        self.device_tag = tag.map(DeviceTag::text);
        self.stroke_mm = Some(limits.stroke.mm());
        self.min_speed_mm_s = Some(limits.min_speed.mm_s());
        self.max_speed_mm_s = Some(limits.max_speed.mm_s());
        self.min_acceleration_mm_s2 = Some(limits.min_acceleration.mm_s2());
        self.max_acceleration_mm_s2 = Some(limits.max_acceleration.mm_s2());
        self.min_force_n = Some(limits.min_force.n());
        self.nominal_force_n = Some(limits.nominal_force.n());
        self.overdrive_force_n = Some(limits.overdrive_force.n());
        self.capabilities.clear();
        if has_temperature(system) {
            self.capabilities.extend(["temperature", "fingers"]);
        }
        if limits.overdrive_force > limits.nominal_force && limits.overdrive_force > Force::ZERO {
            self.capabilities.push("overdrive");
        }
    }
}

/// Whether the firmware has Get Temperature (46h) and the finger interface.
pub(super) fn has_temperature(system: &SystemInfo) -> bool {
    system.firmware.major() >= FIRST_FW4
}
