//! The names that JSON has for them, for logs and metrics.

use std::fmt;

use super::{FastStopCause, Kind, Outcome};

impl Kind {
    /// As JSON has it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Home => "home",
            Self::Move => "move",
            Self::Grip => "grip",
            Self::Release => "release",
            Self::Stop => "stop",
            Self::Custom => "custom",
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Outcome {
    /// As JSON has it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Success => "SUCCESS",
            Self::PartHeld => "PART_HELD",
            Self::NoPart => "NO_PART",
            Self::Blocked => "BLOCKED",
            Self::Aborted => "ABORTED",
            Self::Range => "RANGE",
            Self::Timeout => "TIMEOUT",
            Self::Failed => "FAILED",
            Self::Refused => "REFUSED",
            Self::Unknown => "UNKNOWN",
        }
    }
}

impl FastStopCause {
    /// As JSON has it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Requested => "requested",
            Self::ClientLost => "client_lost",
            Self::UnannouncedDisconnect => "unannounced_disconnect",
            Self::TemperatureFault => "temperature_fault",
            Self::PowerFault => "power_fault",
            Self::CurrentFault => "current_fault",
            Self::FingerFault => "finger_fault",
            Self::SoftLimit => "soft_limit",
            Self::Unknown => "unknown",
        }
    }
}

#[cfg(test)]
pub(crate) mod all {
    use super::{FastStopCause, Kind, Outcome};

    pub const KINDS: [Kind; 6] = [Kind::Home, Kind::Move, Kind::Grip, Kind::Release, Kind::Stop, Kind::Custom];
    pub const OUTCOMES: [Outcome; 10] = [
        Outcome::Success,
        Outcome::PartHeld,
        Outcome::NoPart,
        Outcome::Blocked,
        Outcome::Aborted,
        Outcome::Range,
        Outcome::Timeout,
        Outcome::Failed,
        Outcome::Refused,
        Outcome::Unknown,
    ];
    pub const CAUSES: [FastStopCause; 9] = [
        FastStopCause::Requested,
        FastStopCause::ClientLost,
        FastStopCause::UnannouncedDisconnect,
        FastStopCause::TemperatureFault,
        FastStopCause::PowerFault,
        FastStopCause::CurrentFault,
        FastStopCause::FingerFault,
        FastStopCause::SoftLimit,
        FastStopCause::Unknown,
    ];
}

#[cfg(test)]
mod tests {
    use super::all::{CAUSES, KINDS, OUTCOMES};

    #[test]
    fn the_names_are_those_of_the_json() {
        for kind in KINDS {
            assert_eq!(serde_json::json!(kind), kind.name());
        }
        for outcome in OUTCOMES {
            assert_eq!(serde_json::json!(outcome), outcome.name());
        }
        for cause in CAUSES {
            assert_eq!(serde_json::json!(cause), cause.name());
        }
    }
}
