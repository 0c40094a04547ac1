//! The Zenoh keys of gateways and grippers.

use crate::model::Name;

/// Prefix of all keys, with the version of their contents.
pub const ROOT: &str = "wsg/v1";

/// Key at which a put stops the grippers of all gateways.
pub const FAST_STOP_OF_ALL: &str = "wsg/v1/fast-stop";

/// Maximum length of a client's name in a selector, in bytes: a gateway's name, a slash, and the longest subject of a
/// client that is known by its address (`http:` and an IPv6 address), rounded up.
pub const MAX_CLIENT_BYTES: usize = 80;

/// Maximum length of a client's subject, in bytes: the name of a Zenoh client after `zenoh:`. Without another name, the
/// client has this one as a lease holder.
pub const MAX_SUBJECT_BYTES: usize = "zenoh:".len() + MAX_CLIENT_BYTES;

/// Part of the keys of commands.
pub const COMMAND: &str = "command";

/// The keys of one gateway.
#[derive(Debug, Clone)]
pub struct ZenohKeys {
    gateway: Name,
}

impl ZenohKeys {
    #[must_use]
    pub fn of(gateway: &Name) -> Self {
        Self { gateway: gateway.clone() }
    }

    /// Returns a key of the gateway itself: `fast-stop`, `fleet`, `event`, `alive`, `instance/…`, `dashboard/…`,
    /// `client/…`, `command/…`.
    #[must_use]
    pub fn own(&self, what: &str) -> String {
        format!("{ROOT}/{}/{what}", self.gateway)
    }

    /// Returns the key of a command of a gripper, or of the gateway itself.
    #[must_use]
    pub fn command(&self, gripper: Option<&Name>, method: &str) -> String {
        let what = format!("{COMMAND}/{method}");
        gripper.map_or_else(|| self.own(&what), |gripper| self.gripper(gripper, &what))
    }

    /// Returns a key of one gripper: `state`, `telemetry`, `event`, `info`, `alive`, `command/…`.
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

/// The gateway that a key names.
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

/// Percent-encodes a parameter's value for a selector.
#[must_use]
pub fn encoded(value: &str) -> String {
    url::form_urlencoded::byte_serialize(value.as_bytes()).collect()
}

/// Decodes a parameter's value from a selector. Characters that need no encoding can come unencoded.
#[must_use]
pub fn decoded(value: &str) -> String {
    let (key, rest) = url::form_urlencoded::parse(value.as_bytes()).next().unwrap_or_default();
    if value.contains('=') { format!("{key}={rest}") } else { key.into_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameter_is_decoded_with_and_without_encoding() {
        for value in ["robot-1", "near/http:127.0.0.1", "a;b=c|d&e+f%20 g", "\u{f6}", ""] {
            assert_eq!(decoded(&encoded(value)), value);
        }
        assert_eq!((decoded("near/http:::1"), decoded("a=b")), ("near/http:::1".to_owned(), "a=b".to_owned()));
    }

    #[test]
    fn key_names_its_gateway_and_gripper() {
        let keys = ZenohKeys::of(&"cell-7".parse().unwrap());
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
