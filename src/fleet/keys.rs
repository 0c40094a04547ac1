//! The keys under which gateways are found.

use crate::gripper::model::Name;

/// Where they all begin, with the version of what stands there.
pub const ROOT: &str = "wsg/v1";

/// A put there stops the grippers of all gateways.
pub const FAST_STOP_OF_ALL: &str = "wsg/v1/fast-stop";

/// Those of one gateway.
#[derive(Debug, Clone)]
pub struct Keys {
    gateway: Name,
}

impl Keys {
    /// Of the gateway of this name.
    #[must_use]
    pub fn of(gateway: &Name) -> Self {
        Self { gateway: gateway.clone() }
    }

    /// What is its own: `fast-stop`, `fleet`, `event`, `alive`, `instance/…`, `client/…`.
    #[must_use]
    pub fn own(&self, what: &str) -> String {
        format!("{ROOT}/{}/{what}", self.gateway)
    }

    /// What is one gripper's: `state`, `telemetry`, `event`, `info`, `alive`, `command/…`.
    #[must_use]
    pub fn gripper(&self, gripper: &Name, what: &str) -> String {
        format!("{ROOT}/{}/{gripper}/{what}", self.gateway)
    }
}

/// The last part of a key.
#[must_use]
pub fn last_part(key: &str) -> &str {
    key.rsplit('/').next().unwrap_or_default()
}

/// The gateway that a key of its own names.
#[must_use]
pub fn of_gateway(key: &str) -> Option<Name> {
    let (gateway, _) = key.strip_prefix(ROOT)?.strip_prefix('/')?.split_once('/')?;
    gateway.parse().ok()
}

/// The gateway and the gripper that a key names.
#[must_use]
pub fn of_gripper(key: &str) -> Option<(Name, Name)> {
    let (gateway, rest) = key.strip_prefix(ROOT)?.strip_prefix('/')?.split_once('/')?;
    let (gripper, _) = rest.split_once('/')?;
    Some((gateway.parse().ok()?, gripper.parse().ok()?))
}

/// A parameter's value as a selector has it: percent-encoded.
#[must_use]
pub fn encoded(value: &str) -> String {
    url::form_urlencoded::byte_serialize(value.as_bytes()).collect()
}

/// The same, decoded. What needs no encoding may come without.
#[must_use]
pub fn decoded(value: &str) -> String {
    let (key, rest) = url::form_urlencoded::parse(value.as_bytes()).next().unwrap_or_default();
    if value.contains('=') { format!("{key}={rest}") } else { key.into_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_travels_encoded_and_may_come_without() {
        for value in ["robot-1", "near/http:127.0.0.1", "a;b=c|d&e+f%20 g", "\u{f6}", ""] {
            assert_eq!(decoded(&encoded(value)), value);
        }
        assert_eq!((decoded("near/http:::1"), decoded("a=b")), ("near/http:::1".to_owned(), "a=b".to_owned()));
    }

    #[test]
    fn a_key_names_what_it_was_made_of() {
        let keys = Keys::of(&"cell-7".parse().unwrap());
        let (left, cell) = ("left".parse().unwrap(), "cell-7".parse().unwrap());
        assert_eq!(keys.gripper(&left, "command/grip"), "wsg/v1/cell-7/left/command/grip");
        assert_eq!(of_gripper(&keys.gripper(&left, "state")), Some((cell, left)));
        assert_eq!(of_gateway(&keys.own("alive")).unwrap().as_str(), "cell-7");
        assert_eq!(last_part("wsg/v1/*/*/command/fast-stop"), "fast-stop");
        for wrong in ["", "wsg/v1", "wsg/v1/cell-7", "wsg/v2/cell-7/left/state", "wsg/v1/Cell/left/state"] {
            assert_eq!(of_gripper(wrong), None, "{wrong}");
        }
    }
}
