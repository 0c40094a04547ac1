//! The table of operations.

use std::fmt;

use super::calls::operation::Operation;
use super::gripper::{
    commands, connection, device, device_settings, fast_stop, finger_set, fingers, grippers, lease, motion, raw, servo,
};
use super::parameters::nearest::did_you_mean;
use super::parameters::values::shortened;
use super::problem::Problem;
use super::recipes::{copy_recipes, teach};
use super::{alarms, clock, fleet, me, recipes, reload, statistics, webhooks};
use crate::model::Urgency;

/// The operations of all modules. If several share a name, the first whose path parameters are all given is chosen.
const MODULES: &[&[Operation]] = &[
    motion::OPERATIONS,
    servo::OPERATIONS,
    fast_stop::OPERATIONS,
    lease::OPERATIONS,
    commands::OPERATIONS,
    grippers::OPERATIONS,
    device_settings::OPERATIONS,
    device::OPERATIONS,
    fingers::OPERATIONS,
    finger_set::OPERATIONS,
    raw::OPERATIONS,
    connection::OPERATIONS,
    fleet::OPERATIONS,
    copy_recipes::OPERATIONS,
    alarms::OPERATIONS,
    recipes::OPERATIONS,
    teach::OPERATIONS,
    statistics::OPERATIONS,
    clock::OPERATIONS,
    me::OPERATIONS,
    reload::OPERATIONS,
    webhooks::OPERATIONS,
];

/// All operations.
pub fn all() -> impl Iterator<Item = &'static Operation> + Clone {
    MODULES.iter().copied().flatten()
}

/// The operations that a name stands for: one, or several with different paths, such as the FAST STOP of one gripper
/// and of all. These have the same urgency, and the same properties apart from their paths.
#[derive(Clone, Copy)]
pub struct Method(&'static Operation);

impl Method {
    /// The method with this name.
    ///
    /// # Errors
    /// `not_found` with the nearest name.
    pub fn named(name: &str) -> Result<Self, Problem> {
        all().find(|operation| operation.name == name).map(Self).ok_or_else(|| {
            let suggestion = did_you_mean(name, all().map(|operation| operation.name));
            Problem::not_found(format!("method {:?}{suggestion}", shortened(name)))
        })
    }

    /// The method's operations: the first whose path parameters are all given is meant.
    pub fn operations(self) -> impl Iterator<Item = &'static Operation> {
        all().filter(move |operation| operation.name == self.name())
    }

    /// One of its operations, for the properties that they share.
    pub fn shared(self) -> &'static Operation {
        self.0
    }

    pub fn name(self) -> &'static str {
        self.0.name
    }

    pub fn urgency(self) -> Urgency {
        self.0.urgency
    }

    pub fn is_fast_stop(self) -> bool {
        self.urgency() == Urgency::FastStop
    }
}

impl From<&'static Operation> for Method {
    fn from(operation: &'static Operation) -> Self {
        Self(operation)
    }
}

impl PartialEq for Method {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl fmt::Debug for Method {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::super::calls::operation::journal_command;
    use super::*;

    #[test]
    fn operations_with_one_name_differ_only_in_their_paths() {
        let shared = |one: &Operation| {
            (one.urgency, one.ignores_mistakes, one.starts_command, one.waits, one.changes_something())
        };
        for operation in all() {
            assert_eq!(
                shared(Method::named(operation.name).unwrap().shared()),
                shared(operation),
                "{}",
                operation.name
            );
        }
    }

    #[test]
    fn subject_is_last_fixed_part() {
        assert_eq!(device_settings::SET_ACCELERATION.journal_command(), "acceleration");
        assert_eq!(journal_command("/grippers/{g}/custom/{id}"), "custom");
        assert_eq!(commands::CANCEL.journal_command(), "cancel");
    }

    #[test]
    fn stops_and_lease_renewals_are_urgent() {
        let urgent: Vec<_> = all().filter(|operation| operation.urgency != Urgency::None).map(|one| one.name).collect();
        let expected = [
            "stop",
            "servo.stop",
            "fast-stop",
            "fast-stop",
            "lease.renew",
            "lease.release",
            "cancel",
            "fleet.fast-stop",
        ];
        assert_eq!(urgent, expected);
    }
}
