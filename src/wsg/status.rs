//! Status codes (`fw4-en` Appendix A).

use std::fmt;

/// Status at the start of every reply. A code that the manuals do not list keeps its number.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Status(u16);

macro_rules! statuses {
    ($($code:literal $name:ident $meaning:literal)*) => {
        impl Status {
            $(
                #[doc = $meaning]
                pub const $name: Self = Self($code);
            )*

            /// All codes that the manuals list, in order.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// Symbol in `fw4-en` Appendix A, or `None` for an unlisted code.
            #[must_use]
            pub fn name(self) -> Option<&'static str> {
                match self.0 { $($code => Some(stringify!($name)),)* _ => None }
            }

            /// Short description of the status.
            #[must_use]
            pub fn meaning(self) -> &'static str {
                match self.0 { $($code => $meaning,)* _ => "status code not listed in the manuals" }
            }
        }
    };
}

statuses! {
    0 E_SUCCESS "no error, the operation was successful"
    1 E_NOT_AVAILABLE "function or data is not available"
    2 E_NO_SENSOR "no measurement converter is connected"
    3 E_NOT_INITIALIZED "the device was not initialised"
    4 E_ALREADY_RUNNING "a motion is already running"
    5 E_FEATURE_NOT_SUPPORTED "the feature is not available"
    6 E_INCONSISTENT_DATA "parameters are inconsistent"
    7 E_TIMEOUT "time-out"
    8 E_READ_ERROR "error while reading data"
    9 E_WRITE_ERROR "error while writing data"
    10 E_INSUFFICIENT_RESOURCES "no more memory available"
    11 E_CHECKSUM_ERROR "checksum error"
    12 E_NO_PARAM_EXPECTED "a parameter was given, but none expected"
    13 E_NOT_ENOUGH_PARAMS "not enough parameters"
    14 E_CMD_UNKNOWN "unknown command"
    15 E_CMD_FORMAT_ERROR "command format error"
    16 E_ACCESS_DENIED "access denied"
    17 E_ALREADY_OPEN "the interface is already open"
    18 E_CMD_FAILED "error while executing the command"
    19 E_CMD_ABORTED "the command was aborted"
    20 E_INVALID_HANDLE "invalid handle"
    21 E_NOT_FOUND "device or file not found"
    22 E_NOT_OPEN "device or file not open"
    23 E_IO_ERROR "input or output error"
    24 E_INVALID_PARAMETER "wrong parameter"
    25 E_INDEX_OUT_OF_BOUNDS "index out of bounds"
    26 E_CMD_PENDING "the command was accepted, and is not completed yet"
    27 E_OVERRUN "data overrun"
    28 E_RANGE_ERROR "range error"
    29 E_AXIS_BLOCKED "axis blocked"
    30 E_FILE_EXISTS "the file already exists"
}

impl Status {
    /// Wraps any code, listed or not.
    #[must_use]
    pub const fn from_code(code: u16) -> Self {
        Self(code)
    }

    /// Numeric code on the wire.
    #[must_use]
    pub const fn code(self) -> u16 {
        self.0
    }

    /// Whether the status can only refuse a request. After `E_CMD_PENDING`, it belongs to a duplicate of the request.
    #[must_use]
    pub fn only_refuses(self) -> bool {
        matches!(
            self,
            Self::E_NOT_INITIALIZED
                | Self::E_ALREADY_RUNNING
                | Self::E_CMD_UNKNOWN
                | Self::E_CMD_FORMAT_ERROR
                | Self::E_ACCESS_DENIED
                | Self::E_INVALID_PARAMETER
        )
    }

    /// Whether the status can only be a motion's result. As a first reply, it belongs to an earlier request.
    #[must_use]
    pub fn only_ends_a_motion(self) -> bool {
        matches!(
            self,
            Self::E_SUCCESS | Self::E_CMD_ABORTED | Self::E_CMD_FAILED | Self::E_AXIS_BLOCKED | Self::E_TIMEOUT
        )
    }
}

impl fmt::Display for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.name() {
            Some(name) => f.write_str(name),
            None => write!(f, "E_{}", self.0),
        }
    }
}

impl fmt::Debug for Status {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}({})", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_31_codes_are_known_by_name() {
        assert_eq!(Status::ALL.len(), 31);
        for (code, status) in Status::ALL.iter().enumerate() {
            assert_eq!(usize::from(status.code()), code);
            assert!(status.name().is_some());
        }
        assert_eq!(Status::E_CMD_PENDING.code(), 0x1A);
    }

    #[test]
    fn unlisted_code_keeps_its_number() {
        let status = Status::from_code(4711);
        assert_eq!((status.code(), status.name()), (4711, None));
        assert_eq!(status.to_string(), "E_4711");
    }
}
