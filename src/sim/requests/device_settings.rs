//! Client settings (`fw4-en 3.3`). Only the device tag survives a restart.

use wsg::{Acceleration, DeviceTag, Force, SoftLimits};

use crate::config::DeviceConfig;

#[derive(Debug)]
pub(crate) struct DeviceSettings {
    pub acceleration_mm_s2: f64,
    pub force_limit_n: f64,
    pub soft_limits: Option<SoftLimits>,
    pub overdrive: bool,
    pub device_tag: Option<DeviceTag>,
}

impl DeviceSettings {
    pub fn new(config: &DeviceConfig) -> Self {
        Self {
            acceleration_mm_s2: config.acceleration_mm_s2,
            force_limit_n: config.force_limit_n,
            soft_limits: config.soft_limits,
            overdrive: false,
            device_tag: config.device_tag.clone(),
        }
    }

    pub fn restart(&mut self, config: &DeviceConfig) {
        *self = Self { device_tag: self.device_tag.take(), ..Self::new(config) };
    }

    pub fn set_acceleration(&mut self, acceleration: Acceleration, config: &DeviceConfig) {
        let limits = &config.limits;
        let least = limits.min_acceleration.mm_s2();
        let most = limits.max_acceleration.mm_s2();
        self.acceleration_mm_s2 = f64::from(acceleration.mm_s2().max(least).min(most));
    }

    /// Clamps at the nominal force (`fw4-en 3.3.3`), or at the overdrive force in Overdrive Mode (3.3.8).
    pub fn set_force_limit(&mut self, force: Force, config: &DeviceConfig) {
        let limits = &config.limits;
        let most = if self.overdrive { limits.overdrive_force } else { limits.nominal_force };
        self.force_limit_n = f64::from(force.n().max(limits.min_force.n()).min(most.n()));
    }

    pub fn set_overdrive(&mut self, on: bool, config: &DeviceConfig) {
        self.overdrive = on;
        if !on {
            self.force_limit_n = self.force_limit_n.min(config.nominal_force_n());
        }
    }
}
