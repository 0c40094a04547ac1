//! The topics of a gateway, all of which begin with its prefix.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use crate::model::Name;

/// Level that separates requests from other topics.
pub(super) const COMMAND: &str = "command";

/// Level of FAST STOPs.
pub(super) const FAST_STOP: &str = "fast-stop";

/// Level below which answers can be published within the prefix.
const RESPONSE: &str = "response";

/// Longest prefix, in bytes.
const MAX_PREFIX_BYTES: usize = 256;

/// Longest topic of an answer, in bytes.
const MAX_RESPONSE_BYTES: usize = 512;

/// Topics of one gateway.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topics {
    prefix: Arc<str>,
}

/// The operation that a topic names, and the gripper, if there is one.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct RequestTopic<'a> {
    pub(super) gripper: Option<&'a str>,
    pub(super) name: &'a str,
}

/// Reason why a prefix is not valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the prefix {0}: write levels such as enterprise/site/area/line/cell")]
pub struct InvalidPrefix(&'static str);

impl FromStr for Topics {
    type Err = InvalidPrefix;

    fn from_str(prefix: &str) -> Result<Self, InvalidPrefix> {
        if prefix.len() > MAX_PREFIX_BYTES {
            return Err(InvalidPrefix("has more than 256 bytes"));
        }
        if prefix.contains(['+', '#']) || prefix.chars().any(char::is_control) {
            return Err(InvalidPrefix("contains +, # or a control character"));
        }
        if prefix.starts_with('$') {
            return Err(InvalidPrefix("begins with $, which brokers keep for themselves"));
        }
        if prefix.split('/').any(str::is_empty) {
            return Err(InvalidPrefix("has an empty level"));
        }
        Ok(Self { prefix: prefix.into() })
    }
}

impl fmt::Display for Topics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.prefix)
    }
}

impl Topics {
    /// Topic of the gateway itself.
    pub(super) fn own(&self, what: &str) -> String {
        format!("{}/{what}", self.prefix)
    }

    /// Topic of a gripper.
    pub(super) fn gripper(&self, gripper: &Name, what: &str) -> String {
        format!("{}/{gripper}/{what}", self.prefix)
    }

    /// Topic of a gripper, or of the gateway itself.
    pub(super) fn of(&self, gripper: Option<&Name>, what: &str) -> String {
        gripper.map_or_else(|| self.own(what), |gripper| self.gripper(gripper, what))
    }

    /// Topic filters of all requests.
    pub(super) fn requests(&self) -> [String; 2] {
        [self.own(&format!("{COMMAND}/+")), self.own(&format!("+/{COMMAND}/+"))]
    }

    /// Topic filters of all FAST STOPs.
    pub(super) fn fast_stops(&self) -> [String; 2] {
        [self.own(FAST_STOP), self.own(&format!("+/{FAST_STOP}"))]
    }

    /// Splits the topic of a request or of a FAST STOP.
    pub(super) fn request<'a>(&self, topic: &'a str) -> Option<RequestTopic<'a>> {
        let rest = topic.strip_prefix(&*self.prefix)?.strip_prefix('/')?;
        let levels: Vec<&str> = rest.split('/').collect();
        match levels[..] {
            [COMMAND, name] | [name @ FAST_STOP] => Some(RequestTopic { gripper: None, name }),
            [gripper, COMMAND, name] | [gripper, name @ FAST_STOP] => {
                Some(RequestTopic { gripper: Some(gripper), name })
            }
            _ => None,
        }
    }

    /// Whether an answer may be published to this topic. Within the prefix only topics of answers are allowed, since
    /// subscribers trust the others, and the gateway itself obeys some of them.
    pub(super) fn allows_response(&self, topic: &str) -> bool {
        let is_topic = !topic.is_empty() && topic.len() <= MAX_RESPONSE_BYTES && !topic.contains(['+', '#', '\0']);
        let within = topic.strip_prefix(&*self.prefix).and_then(|rest| rest.strip_prefix('/'));
        is_topic && !topic.starts_with('$') && within.is_none_or(|rest| rest.split('/').next() == Some(RESPONSE))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topics() -> Topics {
        "plant/line-4/cell".parse().unwrap()
    }

    #[test]
    fn request_names_an_operation_and_perhaps_a_gripper() {
        for (topic, expected) in [
            ("plant/line-4/cell/command/grippers", Some((None, "grippers"))),
            ("plant/line-4/cell/left/command/grip", Some((Some("left"), "grip"))),
            ("plant/line-4/cell/fast-stop", Some((None, "fast-stop"))),
            ("plant/line-4/cell/left/fast-stop", Some((Some("left"), "fast-stop"))),
            ("plant/line-4/cell/left/state", None),
            ("plant/line-4/cellar/fast-stop", None),
            ("other/left/command/grip", None),
        ] {
            let expected = expected.map(|(gripper, name)| RequestTopic { gripper, name });
            assert_eq!(topics().request(topic), expected, "{topic}");
        }
    }

    #[test]
    fn answers_go_to_no_topic_that_others_trust() {
        for allowed in ["mes/answers", "plant/line-4/cell/response/mes", "plant/line-4"] {
            assert!(topics().allows_response(allowed), "{allowed}");
        }
        let own =
            ["plant/line-4/cell/left/state", "plant/line-4/cell/left/command/grip", "plant/line-4/cell/fast-stop"];
        for refused in own.into_iter().chain(["", "a/+", "a/#", "$SYS/a"]) {
            assert!(!topics().allows_response(refused), "{refused}");
        }
    }

    #[test]
    fn wrong_prefix_is_refused() {
        for wrong in ["", "/a", "a/", "a//b", "a/+", "#", "$SYS", "a\nb", &"x".repeat(257)] {
            assert!(wrong.parse::<Topics>().is_err(), "{wrong:?}");
        }
    }
}
