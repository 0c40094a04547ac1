//! Limits of values, checked before a frame is sent. Values beyond the device's limits are refused, though the device
//! itself would clamp them, and so are targets that the soft limits forbid. Fingers outside the soft limits may move
//! towards them. Until the device has reported its limits, the limits of the whole gripper family apply.

use model::error::Invalid;
use model::{Motion, ServoAim, ServoTarget, ServoTerms};
use wsg::{Acceleration, Command, Force, NotFinite, SoftLimits, Speed, SystemLimits, Width};

/// Width beyond any gripper of the family; the speed, acceleration and force below likewise.
pub const WIDEST_MM: f32 = 1000.0;
pub const FASTEST_MM_S: f32 = 10_000.0;
pub const HARDEST_MM_S2: f32 = 1_000_000.0;
pub const STRONGEST_N: f32 = 10_000.0;

const ANY_DEVICE: &str = "the limits of any gripper; this device has not reported its own yet";
const DEVICE: &str = "the device's limits";
const SOFT: &str = "the soft limits: change or clear them first";
const NOMINAL: &str = "the nominal force: enable overdrive to exceed it";

/// Known limits of the device.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Limits {
    pub system: Option<SystemLimits>,
    pub soft: Option<SoftLimits>,
    pub overdrive: bool,
}

impl Limits {
    /// Checks a motion that begins at `width`, if that is known.
    pub(super) fn check_motion(&self, motion: &Motion, width: Option<f32>) -> Result<(), Invalid> {
        match *motion {
            Motion::Home(_) | Motion::Custom(_) => Ok(()),
            Motion::Move { flags, width: offset, speed } if flags.relative => {
                self.check_offset(offset, width)?;
                self.check_speed(speed.mm_s())
            }
            Motion::Move { width: target, speed, .. } | Motion::Release { width: target, speed } => {
                self.check_target(target, width)?;
                self.check_speed(speed.mm_s())
            }
            Motion::Grip { width: target, speed, force, .. } => {
                self.check_target(target, width)?;
                self.check_speed(speed.mm_s())?;
                force.map_or(Ok(()), |force| self.check_force(force))
            }
        }
    }

    /// Checks the terms of a servo session.
    pub(super) fn check_servo(&self, terms: &ServoTerms) -> Result<(), Invalid> {
        in_range("max_speed_mm_s", terms.max_speed.mm_s(), self.speeds())?;
        terms.force.map_or(Ok(()), |force| self.check_force(force))
    }

    /// Checks a target of a servo session, for fingers at `width`, if that is known.
    pub(super) fn check_servo_target(&self, target: &ServoTarget, width: Option<f32>) -> Result<(), Invalid> {
        if let Some(speed) = target.speed {
            self.check_speed(speed.mm_s())?;
        }
        match &target.aim {
            ServoAim::Width(aim) => self.check_target(*aim, width),
            ServoAim::Widths(aims, _) => aims.iter().try_for_each(|aim| self.check_target(*aim, width)),
        }
    }

    /// Checks a setter's values.
    pub(super) fn check_setting(&self, command: &Command) -> Result<(), Invalid> {
        match command {
            Command::SetAcceleration(acceleration) => {
                in_range("acceleration_mm_s2", acceleration.mm_s2(), self.accelerations())
            }
            Command::SetForceLimit(force) => self.check_force(*force),
            Command::SetSoftLimits(limits) => {
                in_range("minus_mm", limits.minus().mm(), self.widths())?;
                in_range("plus_mm", limits.plus().mm(), self.widths())
            }
            _ => Ok(()),
        }
    }

    /// Clamps a motion to the physical limits, as a device does (`fw4-en 3.2.2`). A target that the soft limits
    /// forbid stays forbidden.
    pub(super) fn clamp_motion(&self, motion: Motion, width: Option<f32>) -> Motion {
        match motion {
            Motion::Home(_) | Motion::Custom(_) => motion,
            Motion::Move { flags, width: offset, speed } if flags.relative => {
                let (_, widest, _) = self.widths();
                let from = width.unwrap_or_default().clamp(0.0, widest.max(0.0));
                let width = clamped(offset, offset.mm(), (-from, widest - from), Width::new);
                Motion::Move { flags, width, speed: self.clamp_speed(speed) }
            }
            Motion::Move { flags, width, speed } => {
                Motion::Move { flags, width: self.clamp_width(width), speed: self.clamp_speed(speed) }
            }
            Motion::Grip { width, speed, force, part_id, recipe, is_reference } => {
                let width = self.clamp_width(width);
                let speed = self.clamp_speed(speed);
                Motion::Grip { width, speed, force, part_id, recipe, is_reference }
            }
            Motion::Release { width, speed } => {
                Motion::Release { width: self.clamp_width(width), speed: self.clamp_speed(speed) }
            }
        }
    }

    fn clamp_width(&self, width: Width) -> Width {
        let (_, widest, _) = self.widths();
        clamped(width, width.mm(), (0.0, widest), Width::new)
    }

    fn clamp_speed(&self, speed: Speed) -> Speed {
        clamped(speed, speed.mm_s(), bounds(self.speeds()), Speed::new)
    }

    /// Clamps a setting to the limits, as a device does (`fw4-en 3.3`).
    pub(super) fn clamp_setting(&self, command: Command) -> Command {
        match command {
            Command::SetAcceleration(given) => {
                Command::SetAcceleration(clamped(given, given.mm_s2(), bounds(self.accelerations()), Acceleration::new))
            }
            Command::SetForceLimit(given) => {
                Command::SetForceLimit(clamped(given, given.n(), bounds(self.forces()), Force::new))
            }
            Command::SetSoftLimits(given) => {
                let minus = self.clamp_width(given.minus());
                let plus = self.clamp_width(given.plus());
                Command::SetSoftLimits(SoftLimits::new(minus, plus).unwrap_or(given))
            }
            command => command,
        }
    }

    fn widths(&self) -> Range {
        self.system.map_or((0.0, WIDEST_MM, ANY_DEVICE), |system| (0.0, system.stroke.mm(), DEVICE))
    }

    /// Widths at which a motion from `width` may end, and the source of these limits. Outside the soft limits, fingers
    /// may move towards them (see [`SoftLimits::allow_from`]).
    fn targets(&self, width: Option<f32>) -> Range {
        let (min, max, limit) = self.widths();
        let Some(soft) = self.soft else { return (min, max, limit) };
        let minus = width.map_or(soft.minus().mm(), |width| soft.minus().mm().min(width));
        let plus = width.map_or(soft.plus().mm(), |width| soft.plus().mm().max(width));
        (minus.max(min), plus.min(max), SOFT)
    }

    fn check_target(&self, target: Width, width: Option<f32>) -> Result<(), Invalid> {
        in_range("width_mm", target.mm(), self.targets(width))
    }

    fn check_offset(&self, offset: Width, width: Option<f32>) -> Result<(), Invalid> {
        let (_, widest, limit) = self.widths();
        let Some(width) = width else {
            return in_range("width_mm", offset.mm(), (-widest, widest, limit));
        };
        let (min, max, limit) = self.targets(Some(width));
        // At an end stop the measured width can be slightly beyond the stroke.
        let width = width.clamp(0.0, widest.max(0.0));
        in_range("width_mm", offset.mm(), (min - width, max - width, limit))
    }

    fn check_speed(&self, speed_mm_s: f32) -> Result<(), Invalid> {
        in_range("speed_mm_s", speed_mm_s, self.speeds())
    }

    fn check_force(&self, force: Force) -> Result<(), Invalid> {
        in_range("force_n", force.n(), self.forces())
    }

    fn accelerations(&self) -> Range {
        self.system.map_or((0.0, HARDEST_MM_S2, ANY_DEVICE), |system| {
            (system.min_acceleration.mm_s2(), system.max_acceleration.mm_s2(), DEVICE)
        })
    }

    fn speeds(&self) -> Range {
        self.system.map_or((0.0, FASTEST_MM_S, ANY_DEVICE), |system| {
            (system.min_speed.mm_s(), system.max_speed.mm_s(), DEVICE)
        })
    }

    fn forces(&self) -> Range {
        match self.system {
            None => (0.0, STRONGEST_N, ANY_DEVICE),
            Some(system) if self.overdrive && system.overdrive_force > system.nominal_force => {
                (system.min_force.n(), system.overdrive_force.n(), DEVICE)
            }
            Some(system) => (system.min_force.n(), system.nominal_force.n(), NOMINAL),
        }
    }
}

/// Lowest and highest allowed value, and the source of these limits.
type Range = (f32, f32, &'static str);

fn bounds((min, max, _): Range) -> (f32, f32) {
    (min, max)
}

/// The nearest value within the bounds.
fn clamped<T>(given: T, value: f32, (min, max): (f32, f32), new: impl FnOnce(f32) -> Result<T, NotFinite>) -> T {
    if (min..=max).contains(&value) { given } else { new(value.max(min).min(max)).unwrap_or(given) }
}

fn in_range(field: &'static str, value: f32, (min, max, limit): Range) -> Result<(), Invalid> {
    if value >= min && value <= max { Ok(()) } else { Err(Invalid::OutOfRange { field, value, min, max, limit }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wsg::MoveFlags;

    fn width(mm: f32) -> Width {
        Width::new(mm).unwrap()
    }

    fn speed(mm_s: f32) -> Speed {
        Speed::new(mm_s).unwrap()
    }

    fn limits() -> Limits {
        let force = |n| Force::new(n).unwrap();
        let acceleration = |mm_s2| Acceleration::new(mm_s2).unwrap();
        let system = SystemLimits {
            stroke: width(110.0),
            min_speed: speed(5.0),
            max_speed: speed(420.0),
            min_acceleration: acceleration(100.0),
            max_acceleration: acceleration(5000.0),
            min_force: force(5.0),
            nominal_force: force(80.0),
            overdrive_force: force(120.0),
        };
        Limits { system: Some(system), soft: None, overdrive: false }
    }

    fn field(result: &Result<(), Invalid>) -> Option<(&'static str, f32, f32)> {
        match *result {
            Err(Invalid::OutOfRange { field, min, max, .. }) => Some((field, min, max)),
            _ => None,
        }
    }

    fn grip(mm: f32, mm_s: f32, force: Option<f32>) -> Motion {
        let force = force.map(|n| Force::new(n).unwrap());
        Motion::Grip { width: width(mm), speed: speed(mm_s), force, part_id: None, recipe: None, is_reference: false }
    }

    /// A relative motion.
    fn by(mm: f32) -> Motion {
        let flags = MoveFlags { relative: true, stop_on_block: true };
        Motion::Move { flags, width: width(mm), speed: speed(50.0) }
    }

    #[test]
    fn errors_name_the_field_and_its_limits() {
        let limits = limits();
        assert_eq!(field(&limits.check_motion(&grip(5000.0, 50.0, None), None)), Some(("width_mm", 0.0, 110.0)));
        assert_eq!(field(&limits.check_motion(&grip(-0.1, 50.0, None), None)), Some(("width_mm", 0.0, 110.0)));
        assert_eq!(field(&limits.check_motion(&grip(20.0, 4.9, None), None)), Some(("speed_mm_s", 5.0, 420.0)));
        assert_eq!(field(&limits.check_motion(&grip(20.0, 50.0, Some(81.0)), None)), Some(("force_n", 5.0, 80.0)));
        assert_eq!(limits.check_motion(&grip(110.0, 420.0, Some(80.0)), None), Ok(()));
        let overdrive = Limits { overdrive: true, ..limits };
        assert_eq!(overdrive.check_motion(&grip(20.0, 50.0, Some(120.0)), None), Ok(()));
    }

    #[test]
    fn relative_moves_are_checked_at_their_end() {
        let limits = limits();
        assert_eq!(field(&limits.check_motion(&by(-31.0), Some(30.0))), Some(("width_mm", -30.0, 80.0)));
        assert_eq!(limits.check_motion(&by(-30.0), Some(30.0)), Ok(()));
    }

    #[test]
    fn targets_outside_soft_limits_are_refused() {
        let soft = SoftLimits::new(width(10.0), width(60.0));
        let limits = Limits { soft, ..limits() };
        assert_eq!(field(&limits.check_motion(&grip(9.0, 50.0, None), None)), Some(("width_mm", 10.0, 60.0)));
        assert_eq!(field(&limits.check_motion(&grip(9.0, 50.0, None), Some(30.0))), Some(("width_mm", 10.0, 60.0)));
        assert_eq!(
            limits.check_motion(&Motion::Home(wsg::HomingDirection::Default), None),
            Ok(()),
            "homing ignores them"
        );
    }

    #[test]
    fn fingers_outside_soft_limits_may_move_towards_them() {
        let soft = SoftLimits::new(width(20.0), width(50.0));
        let limits = Limits { soft, ..limits() };
        assert_eq!(limits.check_motion(&grip(60.0, 50.0, None), Some(70.0)), Ok(()));
        assert_eq!(limits.check_motion(&by(-10.0), Some(70.0)), Ok(()));
        assert_eq!(field(&limits.check_motion(&grip(71.0, 50.0, None), Some(70.0))), Some(("width_mm", 20.0, 70.0)));
        assert_eq!(field(&limits.check_motion(&by(1.0), Some(70.0))), Some(("width_mm", -50.0, 0.0)));
        assert_eq!(field(&limits.check_motion(&grip(9.0, 50.0, None), Some(10.0))), Some(("width_mm", 10.0, 50.0)));
    }

    #[test]
    fn unknown_device_limits_fall_back_to_the_family() {
        let unknown = Limits::default();
        assert_eq!(field(&unknown.check_motion(&grip(1001.0, 50.0, None), None)), Some(("width_mm", 0.0, 1000.0)));
        assert_eq!(unknown.check_motion(&grip(200.0, 50.0, None), None), Ok(()));
    }

    #[test]
    fn settings_are_checked_too() {
        let limits = limits();
        let set = Command::SetAcceleration(Acceleration::new(6000.0).unwrap());
        assert_eq!(field(&limits.check_setting(&set)), Some(("acceleration_mm_s2", 100.0, 5000.0)));
        let soft = Command::SetSoftLimits(SoftLimits::new(width(5.0), width(111.0)).unwrap());
        assert_eq!(field(&limits.check_setting(&soft)), Some(("plus_mm", 0.0, 110.0)));
    }
}
