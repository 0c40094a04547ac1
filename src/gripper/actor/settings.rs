//! What clients set: written down, and remembered across restarts of the gateway and of the device.

use serde::{Deserialize, Serialize};

use super::super::Now;
use super::super::model::{Client, Detail, MemoryKey, SettingChange, SettingsEvent};
use super::super::setup::{Setting, Wanted, WantedSoftLimits};
use super::Actor;
use super::recording::Recording;
use crate::wsg::{Acceleration, Command, Data, Finger, Force, SoftLimits, Width};

/// What clients set, as it is remembered.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Remembered {
    /// The device that it was set on.
    pub serial_number: Option<u32>,
    acceleration_mm_s2: Option<f32>,
    force_n: Option<f32>,
    soft_limits_cleared: bool,
    minus_mm: Option<f32>,
    plus_mm: Option<f32>,
}

impl Remembered {
    fn new(serial_number: Option<u32>, wanted: &Wanted) -> Self {
        let limits = match wanted.soft_limits {
            WantedSoftLimits::Set(limits) => Some(limits),
            _ => None,
        };
        Self {
            serial_number,
            acceleration_mm_s2: wanted.acceleration.map(Acceleration::mm_s2),
            force_n: wanted.force_limit.map(Force::n),
            soft_limits_cleared: wanted.soft_limits == WantedSoftLimits::Cleared,
            minus_mm: limits.map(|limits| limits.minus().mm()),
            plus_mm: limits.map(|limits| limits.plus().mm()),
        }
    }

    pub(super) fn wanted(&self) -> Wanted {
        let width = |mm: Option<f32>| mm.and_then(|mm| Width::new(mm).ok());
        let limits = width(self.minus_mm).zip(width(self.plus_mm));
        let soft_limits = match limits.and_then(|(minus, plus)| SoftLimits::new(minus, plus)) {
            Some(limits) => WantedSoftLimits::Set(limits),
            None if self.soft_limits_cleared => WantedSoftLimits::Cleared,
            None => WantedSoftLimits::AsTheyAre,
        };
        Wanted {
            acceleration: self.acceleration_mm_s2.and_then(|mm_s2| Acceleration::new(mm_s2).ok()),
            force_limit: self.force_n.and_then(|n| Force::new(n).ok()),
            soft_limits,
        }
    }
}

impl Actor {
    pub(super) fn remember_settings(&mut self) {
        let remembered = Remembered::new(self.known_serial, &self.wanted);
        self.recording.persist(MemoryKey::Settings, Some(&remembered));
    }
}

impl Recording {
    pub(super) fn setting(&mut self, now: Now, client: &Client, setting: SettingChange) {
        let event = self.event(now, Detail::Settings(SettingsEvent { restored: false, setting })).by(client);
        self.record(event);
    }

    /// Records a setter's value that was read back.
    pub(super) fn set(&mut self, now: Now, client: &Client, data: &Data) {
        if let Some(setting) = change_of(data) {
            self.setting(now, client, setting);
        }
    }

    /// Records what a command has changed on the device and nothing can read back.
    pub(super) fn change(&mut self, now: Now, client: &Client, command: &Command) {
        let setting = match command {
            Command::TareForceSensor => SettingChange::Tare,
            Command::GetStatistics { reset: true } => SettingChange::StatisticsReset,
            Command::FingerPower { finger, on } => {
                let finger = if *finger == Finger::One { 1 } else { 2 };
                SettingChange::FingerPower { finger, enabled: *on }
            }
            _ => return,
        };
        self.setting(now, client, setting);
    }

    /// Records settings that the device had forgotten, and has got again.
    pub(super) fn restored(&mut self, now: Now, restored: &[Setting], wanted: Wanted) {
        let Wanted { acceleration, force_limit, soft_limits } = wanted;
        for setting in restored {
            let data = match (setting, soft_limits) {
                (Setting::Acceleration, _) => acceleration.map(Data::Acceleration),
                (Setting::ForceLimit, _) => force_limit.map(Data::ForceLimit),
                (Setting::SoftLimits, WantedSoftLimits::Set(limits)) => Some(Data::SoftLimits(limits)),
                (Setting::SoftLimits, _) => None,
            };
            let setting = data.as_ref().and_then(change_of).unwrap_or(SettingChange::SoftLimitsCleared);
            let event = self.event(now, Detail::Settings(SettingsEvent { restored: true, setting }));
            self.record(event);
        }
    }
}

fn change_of(data: &Data) -> Option<SettingChange> {
    Some(match data {
        Data::Acceleration(acceleration) => SettingChange::Acceleration { acceleration_mm_s2: acceleration.mm_s2() },
        Data::ForceLimit(force) => SettingChange::ForceLimit { force_n: force.n() },
        Data::SoftLimits(limits) => {
            SettingChange::SoftLimits { minus_mm: limits.minus().mm(), plus_mm: limits.plus().mm() }
        }
        Data::DeviceTag(tag) => SettingChange::DeviceTag { tag: tag.as_str().to_owned() },
        _ => return None,
    })
}
