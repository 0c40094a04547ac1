//! Machine-readable causes of problems.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

macro_rules! codes {
    ($($name:ident $number:literal $status:literal;)*) => {
        /// Machine-readable cause of a problem. The codes never change:
        ///
        /// - `malformed`: the request cannot be parsed, or a field has the wrong form.
        /// - `foreign_host`: the `Host` header is neither an address nor `localhost` nor a configured name.
        /// - `foreign_origin`: the request comes from a web page of another origin.
        /// - `not_found`: the path, gripper or command does not exist.
        /// - `method_not_allowed`: the path does not support this method.
        /// - `request_timeout`: the body did not arrive in time.
        /// - `too_large`: the body is too large.
        /// - `fast_stop`: a FAST STOP is latched; acknowledge it once its cause is gone.
        /// - `not_referenced`: the fingers are not referenced; home the gripper first.
        /// - `already_running`: a command or an acknowledgement is running, or the fingers move; wait for its end or
        ///   stop it.
        /// - `release_first`: the device refuses a grip, because its last grip went in the opposite direction; release
        ///   first.
        /// - `lease_held`: another client holds the lease, or the gripper is reserved.
        /// - `stale_lease`: the lease token is not the token of the current lease.
        /// - `stale_fast_stop`: the acknowledgement names a FAST STOP that is not the newest.
        /// - `fast_stop_unconfirmed`: the device has not confirmed the FAST STOP yet.
        /// - `request_id_reused`: the request id was used for another request.
        /// - `name_taken`: another gateway on the Zenoh network has the same name.
        /// - `out_of_range`: a value is beyond its limits.
        /// - `device_refused`: the device refused the request, ended its motion with a status that has no code of its
        ///   own, or refused to take back settings that it had lost.
        /// - `overloaded`: too many requests are waiting, a client has used too many request ids, or the device tag was
        ///   written too often; try again later.
        /// - `internal`: internal error of the gateway.
        /// - `device_protocol`: the device sent an invalid reply.
        /// - `link_down`: the link to the device does not work, or the gateway is disconnecting from the gripper.
        /// - `journal_down`: the journal cannot be written or read.
        /// - `device_timeout`: the device did not answer in time.
        /// - `gateway_gone`: the gateway that owns the gripper is gone; nothing was sent to it.
        /// - `gateway_timeout`: the gateway that owns the gripper did not answer; the result is unknown.
        /// - `unauthorized`: the request needs a valid credential.
        /// - `forbidden`: the client's role or grippers do not allow the request.
        /// - `invalid_configuration`: the new configuration cannot be used, so nothing has changed.
        /// - `precondition_failed`: the recipe does not have the version that the request expects.
        /// - `number_taken`: the number belongs to another recipe.
        #[derive(
            Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, strum::IntoStaticStr, strum::VariantArray,
        )]
        #[serde(rename_all = "snake_case")]
        #[strum(serialize_all = "snake_case")]
        pub enum Code { $($name),* }

        impl Code {
            /// Number of the code, for clients that do not compare texts. Numbers never change.
            #[must_use]
            pub const fn number(self) -> u16 {
                match self { $(Self::$name => $number),* }
            }

            /// HTTP status of a response with this code.
            #[must_use]
            pub const fn http_status(self) -> u16 {
                match self { $(Self::$name => $status),* }
            }
        }
    };
}

// Name, number and HTTP status. A new code gets the next free number.
codes! {
    Malformed 1 400;
    ForeignHost 2 403;
    ForeignOrigin 3 403;
    NotFound 4 404;
    MethodNotAllowed 5 405;
    RequestTimeout 6 408;
    TooLarge 7 413;
    FastStop 8 409;
    NotReferenced 9 409;
    AlreadyRunning 10 409;
    ReleaseFirst 11 409;
    LeaseHeld 12 409;
    StaleLease 13 409;
    StaleFastStop 14 409;
    FastStopUnconfirmed 15 409;
    RequestIdReused 16 409;
    NameTaken 17 409;
    OutOfRange 18 422;
    DeviceRefused 19 422;
    Overloaded 20 429;
    Internal 21 500;
    DeviceProtocol 22 502;
    LinkDown 23 503;
    JournalDown 24 503;
    DeviceTimeout 25 504;
    GatewayGone 26 503;
    GatewayTimeout 27 504;
    Unauthorized 28 401;
    Forbidden 29 403;
    InvalidConfiguration 30 409;
    PreconditionFailed 31 412;
    NumberTaken 32 409;
}

impl Code {
    /// The code as clients see it.
    #[must_use]
    pub fn word(self) -> &'static str {
        self.into()
    }
}

#[cfg(test)]
mod tests {
    use strum::VariantArray as _;

    use super::*;

    #[test]
    fn numbers_are_never_changed() {
        let numbers: Vec<_> = Code::VARIANTS.iter().map(|code| (code.number(), code.word())).collect();
        let pinned = [
            (1, "malformed"),
            (2, "foreign_host"),
            (3, "foreign_origin"),
            (4, "not_found"),
            (5, "method_not_allowed"),
            (6, "request_timeout"),
            (7, "too_large"),
            (8, "fast_stop"),
            (9, "not_referenced"),
            (10, "already_running"),
            (11, "release_first"),
            (12, "lease_held"),
            (13, "stale_lease"),
            (14, "stale_fast_stop"),
            (15, "fast_stop_unconfirmed"),
            (16, "request_id_reused"),
            (17, "name_taken"),
            (18, "out_of_range"),
            (19, "device_refused"),
            (20, "overloaded"),
            (21, "internal"),
            (22, "device_protocol"),
            (23, "link_down"),
            (24, "journal_down"),
            (25, "device_timeout"),
            (26, "gateway_gone"),
            (27, "gateway_timeout"),
            (28, "unauthorized"),
            (29, "forbidden"),
            (30, "invalid_configuration"),
            (31, "precondition_failed"),
            (32, "number_taken"),
        ];
        for pinned in pinned {
            assert!(numbers.contains(&pinned), "{pinned:?}");
        }
        let guide = include_str!("../../../deploy/guide/problems.md");
        for (number, word) in numbers {
            assert!(
                guide.contains(&format!("| [`{word}`](#{word}) | {number} |")),
                "problems.md lacks {number} {word}"
            );
        }
    }

    #[test]
    fn words_match_json_and_numbers_are_unique() {
        for code in Code::VARIANTS {
            assert_eq!(serde_json::json!(code), code.word());
            assert_eq!(Code::VARIANTS.iter().filter(|other| other.number() == code.number()).count(), 1, "{code:?}");
        }
    }
}
