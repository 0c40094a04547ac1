//! Settings of the device: the values that clients have set, and its limits.

mod device_tag;
mod overdrive;
pub(super) mod unconfirmed;

use std::collections::BTreeSet;

use super::super::Now;
use super::super::info::has_temperature;
use super::super::limits::Limits;
use super::super::observed::Observed;
use super::super::setup::{Setting, Setup, Wanted, WantedSoftLimits};
use super::recording::Recording;
use device_tag::TagWrites;
use model::error::Conflict;
use model::{Client, Detail, SettingChange, SettingsEvent};
use overdrive::Overdrive;
use wsg::{Command, Data, Finger, SystemInfo, SystemState};

#[derive(Debug, Default)]
pub(super) struct Settings {
    /// Serial number of the device that `wanted` was set on.
    pub known_serial: Option<u32>,
    pub wanted: Wanted,
    /// Settings of clients that could not be restored. Motion is blocked until they are set again.
    lost: BTreeSet<Setting>,
    system: Option<SystemInfo>,
    limits: Limits,
    pub overdrive: Overdrive,
    pub tag_writes: TagWrites,
}

impl Settings {
    /// Checks that the device has all settings of clients.
    pub(super) fn check(&self) -> Result<(), Conflict> {
        if self.lost.is_empty() {
            return Ok(());
        }
        let lost: Vec<_> = self.lost.iter().map(ToString::to_string).collect();
        Err(Conflict::SettingsLost { settings: lost.join(", ") })
    }

    pub(super) fn limits(&self, observed: &Observed) -> Limits {
        Limits { overdrive: observed.has(SystemState::OVERDRIVE_MODE), ..self.limits }
    }

    pub(super) fn stroke_mm(&self) -> Option<f32> {
        self.limits.system.map(|system| system.stroke.mm())
    }

    pub(super) fn has_temperature(&self) -> bool {
        self.system.as_ref().is_some_and(has_temperature)
    }

    /// Notes a value that was read back, to restore it after a restart of the device.
    pub(super) fn note(&mut self, data: &Data) {
        match data {
            Data::Acceleration(acceleration) => {
                self.wanted.acceleration = Some(*acceleration);
                self.lost.remove(&Setting::Acceleration);
            }
            Data::ForceLimit(force) => {
                self.wanted.force_limit = Some(*force);
                self.lost.remove(&Setting::ForceLimit);
            }
            Data::SoftLimits(limits) => {
                self.wanted.soft_limits = WantedSoftLimits::Set(*limits);
                self.lost.remove(&Setting::SoftLimits);
                self.limits.soft = Some(*limits);
            }
            _ => {}
        }
    }

    /// Notes that the soft limits were read back as cleared.
    pub(super) fn note_no_soft_limits(&mut self) {
        self.wanted.soft_limits = WantedSoftLimits::Cleared;
        self.lost.remove(&Setting::SoftLimits);
        self.limits.soft = None;
    }

    /// Takes the results of a setup. Returns whether the serial number or a setting differs from before.
    pub(super) fn learn(&mut self, setup: &mut Setup) -> bool {
        let wanted_before = std::mem::replace(&mut self.wanted, setup.wanted());
        self.lost = std::mem::take(&mut setup.lost);
        self.system = setup.system;
        self.limits.system = setup.limits;
        self.limits.soft = setup.soft_limits;
        let serial = setup.system.map(|system| system.serial_number);
        let serial_before = std::mem::replace(&mut self.known_serial, serial);
        serial_before != serial || wanted_before != self.wanted
    }
}

impl Recording {
    pub(super) fn setting(&mut self, now: Now, client: &Client, setting: SettingChange) {
        let event = self.event(now, Detail::Settings(SettingsEvent { restored: false, setting })).by(client);
        self.record(event);
    }

    /// Records a value that was read back after a setter.
    pub(super) fn set(&mut self, now: Now, client: &Client, data: &Data) {
        if let Some(setting) = change_of(data) {
            self.setting(now, client, setting);
        }
    }

    /// Records a value that the device changed by itself.
    pub(super) fn changed_by_device(&mut self, now: Now, data: &Data) {
        if let Some(setting) = change_of(data) {
            let event = self.event(now, Detail::Settings(SettingsEvent { restored: false, setting }));
            self.record(event);
        }
    }

    /// Records a change that can't be read back.
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

    /// Records settings that were restored on a device that had lost them.
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
        Data::DeviceTag(tag) => SettingChange::DeviceTag { tag: tag.text() },
        _ => return None,
    })
}
