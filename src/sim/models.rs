//! Gripper models: names, types and physical limits.
//!
//! The limits are plausible for each size but not copied from a data sheet. They differ, so that clients have to query
//! them (`fw4-en 3.5.4`), and one model has no overdrive (`fw4-en 3.3.8`).

use wsg::{Acceleration, DeviceType, Force, Speed, SystemLimits, Width};

/// Generation of the firmware, which determines the manual.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Generation {
    /// Firmware 2: no ERROR state, no temperature, no finger interface.
    Fw2,
    /// Firmware 4.
    Fw4,
}

/// A gripper model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Model {
    /// The smallest model, without Overdrive Mode.
    Wsg25,
    Wsg32,
    /// The common model, and the only one with a type code in fw2.
    Wsg50,
    /// The largest model.
    Wsg70,
}

impl Model {
    pub const ALL: [Self; 4] = [Self::Wsg25, Self::Wsg32, Self::Wsg50, Self::Wsg70];

    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|model| model.name() == name)
    }

    /// Name in addresses and configurations.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Wsg25 => "wsg25",
            Self::Wsg32 => "wsg32",
            Self::Wsg50 => "wsg50",
            Self::Wsg70 => "wsg70",
        }
    }

    /// Type in the reply to 50h. fw2 lists only the WSG 50 (fw2 3.5.1).
    #[must_use]
    pub const fn device_type(self, generation: Generation) -> DeviceType {
        match (self, generation) {
            (Self::Wsg50, _) => DeviceType::Wsg50,
            (_, Generation::Fw2) => DeviceType::Unknown,
            (Self::Wsg25, Generation::Fw4) => DeviceType::Wsg25,
            (Self::Wsg32, Generation::Fw4) => DeviceType::Wsg32,
            (Self::Wsg70, Generation::Fw4) => DeviceType::Wsg70,
        }
    }

    #[must_use]
    pub const fn has_overdrive(self) -> bool {
        !matches!(self, Self::Wsg25)
    }

    /// Limits in the reply to 53h.
    #[must_use]
    pub fn limits(self) -> SystemLimits {
        // Stroke; speeds; accelerations; minimum, nominal and overdrive force.
        let [stroke, min_speed, max_speed, min_acceleration, max_acceleration, min_force, nominal, overdrive] =
            match self {
                Self::Wsg25 => [64.0, 5.0, 300.0, 100.0, 3000.0, 3.0, 25.0, 25.0],
                Self::Wsg32 => [68.0, 5.0, 400.0, 100.0, 5000.0, 5.0, 50.0, 65.0],
                Self::Wsg50 => [110.0, 5.0, 420.0, 100.0, 5000.0, 5.0, 80.0, 120.0],
                Self::Wsg70 => [210.0, 5.0, 320.0, 50.0, 3000.0, 10.0, 140.0, 200.0],
            };
        SystemLimits {
            stroke: Width::new(stroke).unwrap_or(Width::ZERO),
            min_speed: speed(min_speed),
            max_speed: speed(max_speed),
            min_acceleration: acceleration(min_acceleration),
            max_acceleration: acceleration(max_acceleration),
            min_force: force(min_force),
            nominal_force: force(nominal),
            overdrive_force: force(overdrive),
        }
    }
}

// A quantity refuses only numbers that are not finite, and the models' limits are all finite.

fn speed(mm_s: f32) -> Speed {
    Speed::new(mm_s).unwrap_or(Speed::ZERO)
}

fn acceleration(mm_s2: f32) -> Acceleration {
    Acceleration::new(mm_s2).unwrap_or(Acceleration::ZERO)
}

fn force(n: f32) -> Force {
    Force::new(n).unwrap_or(Force::ZERO)
}
