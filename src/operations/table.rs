//! The table of operations.

use http::Method as Verb;

use super::operation::Operation;
use super::{
    alarms, clock, commands, connection, copy_recipes, device, fast_stop, finger_set, fingers, fleet, grippers, lease,
    me, motion, raw, recipes, reload, settings, statistics, teach, webhooks,
};
use crate::gripper::model::Urgency;

/// All operations. If several share a name, the first whose path parameters are all given is chosen.
pub const OPERATIONS: &[Operation] = &[
    motion::HOME,
    motion::MOVE,
    motion::GRIP,
    motion::RELEASE,
    motion::STOP,
    fast_stop::ONE,
    fast_stop::ALL,
    fast_stop::ACKNOWLEDGE,
    lease::GET,
    lease::TAKE,
    lease::RENEW,
    lease::RELEASE,
    lease::HAND_OVER,
    commands::LATEST,
    commands::GET,
    commands::CANCEL,
    grippers::LIST,
    grippers::INFO,
    grippers::STATE,
    grippers::STATUS,
    grippers::TREND,
    settings::GET_ACCELERATION,
    settings::SET_ACCELERATION,
    settings::GET_FORCE_LIMIT,
    settings::SET_FORCE_LIMIT,
    settings::GET_SOFT_LIMITS,
    settings::SET_SOFT_LIMITS,
    settings::CLEAR_SOFT_LIMITS,
    settings::GET_OVERDRIVE,
    settings::SET_OVERDRIVE,
    settings::GET_TAG,
    settings::SET_TAG,
    device::STATISTICS,
    device::RESET_STATISTICS,
    fingers::INFO,
    fingers::DATA,
    fingers::POWER,
    finger_set::GET,
    finger_set::SET,
    device::TARE,
    device::LOOP,
    raw::RAW,
    connection::DISCONNECT,
    connection::CONNECT,
    fleet::LIST,
    fleet::FAST_STOP,
    fleet::ACKNOWLEDGE,
    copy_recipes::COPY,
    alarms::LIST,
    alarms::ACKNOWLEDGE,
    recipes::LIST,
    recipes::SET_SEVERAL,
    recipes::GET,
    recipes::VERSIONS,
    recipes::SET,
    recipes::REMOVE,
    teach::TEACH,
    statistics::STATISTICS,
    clock::CLOCK,
    me::ME,
    reload::RELOAD,
    webhooks::LIST,
    webhooks::TEST,
];

/// Operations with this name.
pub fn named(name: &str) -> impl Iterator<Item = &'static Operation> {
    OPERATIONS.iter().filter(move |operation| operation.name == name)
}

/// The operation with this method and path template, which is relative to the API's path.
#[must_use]
pub fn find(verb: &Verb, path: &str) -> Option<&'static Operation> {
    OPERATIONS.iter().find(|operation| operation.verb == verb && operation.path == path)
}

/// Whether this is the name of a FAST STOP.
#[must_use]
pub fn is_fast_stop(name: &str) -> bool {
    urgency(name) == Urgency::FastStop
}

/// Urgency of the operations with this name.
#[must_use]
pub fn urgency(name: &str) -> Urgency {
    named(name).next().map_or(Urgency::None, |operation| operation.urgency)
}

#[cfg(test)]
mod tests {
    use super::super::operation::journal_command;
    use super::*;

    #[test]
    fn operations_with_one_name_have_one_urgency() {
        for operation in OPERATIONS {
            assert_eq!(urgency(operation.name), operation.urgency, "{}", operation.name);
        }
    }

    #[test]
    fn subject_is_last_fixed_part() {
        assert_eq!(settings::SET_ACCELERATION.journal_command(), "acceleration");
        assert_eq!(journal_command("/grippers/{g}/custom/{id}"), "custom");
        assert_eq!(commands::CANCEL.journal_command(), "cancel");
    }

    #[test]
    fn stops_and_lease_renewals_are_urgent() {
        let urgent: Vec<_> =
            OPERATIONS.iter().filter(|operation| operation.urgency != Urgency::None).map(|one| one.name).collect();
        let expected = ["stop", "fast-stop", "fast-stop", "lease.renew", "lease.release", "cancel", "fleet.fast-stop"];
        assert_eq!(urgent, expected);
    }
}
