//! Machine-readable causes of problems.

use serde::{Deserialize, Serialize};
use strum::{EnumMessage, IntoStaticStr, VariantArray};
use utoipa::ToSchema;

macro_rules! codes {
    ($($(#[$doc:meta])+ $name:ident $number:literal $status:literal;)+) => {
        /// Machine-readable cause of a problem. The codes never change.
        #[derive(
            Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema, IntoStaticStr, EnumMessage, VariantArray,
        )]
        #[serde(rename_all = "snake_case")]
        #[strum(serialize_all = "snake_case")]
        pub enum Code { $($(#[$doc])+ $name),+ }

        impl Code {
            /// Number of the code, for clients that do not compare texts. Numbers never change.
            #[must_use]
            pub const fn number(self) -> u16 {
                match self { $(Self::$name => $number),+ }
            }

            /// HTTP status of a response with this code.
            #[must_use]
            pub const fn http_status(self) -> u16 {
                match self { $(Self::$name => $status),+ }
            }
        }
    };
}

// Name, number and HTTP status. A new code gets the next free number.
codes! {
    /// The request cannot be parsed, or a field has the wrong form.
    Malformed 1 400;
    /// The `Host` header is neither an address nor `localhost` nor a configured name.
    ForeignHost 2 403;
    /// The request comes from a web page of another origin.
    ForeignOrigin 3 403;
    /// The path, gripper or command does not exist.
    NotFound 4 404;
    /// The path does not support this method.
    MethodNotAllowed 5 405;
    /// The body did not arrive in time.
    RequestTimeout 6 408;
    /// The body is too large.
    TooLarge 7 413;
    /// A FAST STOP is latched; acknowledge it once its cause is gone.
    FastStop 8 409;
    /// The fingers are not referenced; home the gripper first.
    NotReferenced 9 409;
    /// A command or an acknowledgement is running, or the fingers move; `detail` says whether to wait or to stop.
    AlreadyRunning 10 409;
    /// The device refuses a grip, because its last grip went in the opposite direction; release first.
    ReleaseFirst 11 409;
    /// Another client holds the lease.
    LeaseHeld 12 409;
    /// The lease token is not the token of the current lease.
    StaleLease 13 409;
    /// The acknowledgement names a FAST STOP that is not the newest.
    StaleFastStop 14 409;
    /// The device has not confirmed the FAST STOP yet.
    FastStopUnconfirmed 15 409;
    /// The request id was used for another request.
    RequestIdReused 16 409;
    /// Another gateway on the Zenoh network has the same name.
    NameTaken 17 409;
    /// A value is beyond its limits.
    OutOfRange 18 422;
    /// The device refused the request, ended its motion with a status that has no code of its own, or refused to take
    /// back settings that it had lost.
    DeviceRefused 19 422;
    /// Too many requests are waiting, a client has used too many request ids, or the device tag was written too often;
    /// try again later.
    Overloaded 20 429;
    /// Internal error of the gateway.
    Internal 21 500;
    /// The device sent an invalid reply.
    DeviceProtocol 22 502;
    /// The link to the device does not work, or the gateway is disconnecting from the gripper.
    LinkDown 23 503;
    /// The journal cannot be written or read.
    JournalDown 24 503;
    /// The device did not answer in time.
    DeviceTimeout 25 504;
    /// The gateway that owns the gripper is gone; nothing was sent to it.
    GatewayGone 26 503;
    /// The gateway that owns the gripper did not answer; the result is unknown.
    GatewayTimeout 27 504;
    /// The request needs a valid credential.
    Unauthorized 28 401;
    /// The client's role or grippers do not allow the request.
    Forbidden 29 403;
    /// The new configuration cannot be used, so nothing has changed.
    InvalidConfiguration 30 409;
    /// The recipe does not have the version that the request expects.
    PreconditionFailed 31 412;
    /// The number belongs to another recipe.
    NumberTaken 32 409;
    /// The journal was restored, so a request with this id may have been executed before.
    UnknownPast 33 409;
    /// The gripper holds a part for a client that was lost.
    Reserved 34 409;
    /// The body is compressed.
    UnsupportedEncoding 35 415;
    /// No servo session of this client is open; `detail` says why the last one ended.
    NoServo 36 409;
    /// The target is older than the newest one, or too old.
    StaleTarget 37 409;
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
            (33, "unknown_past"),
            (34, "reserved"),
            (35, "unsupported_encoding"),
            (36, "no_servo"),
            (37, "stale_target"),
        ];
        for pinned in pinned {
            assert!(numbers.contains(&pinned), "{pinned:?}");
        }
        let guide = include_str!("../../deploy/guide/problems.md");
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
