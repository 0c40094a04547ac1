//! Problems (RFC 9457): everything that is refused or fails, in one form, with a code that programs can rely on.

use std::sync::Arc;

use http::StatusCode;
use serde::Serialize;
use serde_json::{Number, Value};
use utoipa::ToSchema;

use crate::gripper::model::{CommandId, FastStopId};
use crate::gripper::{Conflict, DeviceRefusal, Failure, Invalid, Rejection};
use crate::journal::ReadError;
use crate::wsg::Status;

/// The most bytes of a wrong value that are repeated to its sender: an answer has to fit a small client's buffer.
const MAX_VALUE_BYTES: usize = 64;

macro_rules! codes {
    ($($(#[$doc:meta])* $name:ident $status:ident;)*) => {
        /// What is wrong, for programs: these words never change.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum Code { $($(#[$doc])* $name),* }

        impl Code {
            const fn status(self) -> StatusCode {
                match self { $(Self::$name => StatusCode::$status),* }
            }

            /// The code as clients see it.
            fn word(self) -> String {
                serde_json::to_value(self).ok().and_then(|code| Some(code.as_str()?.to_owned())).unwrap_or_default()
            }
        }
    };
}

codes! {
    /// The request can't be understood.
    Malformed BAD_REQUEST;
    /// The Host header names neither an address, nor localhost, nor a configured name.
    ForeignHost FORBIDDEN;
    /// A web page of another origin asks.
    ForeignOrigin FORBIDDEN;
    /// There is no such path, gripper or command.
    NotFound NOT_FOUND;
    /// The path is there, and does not take this method.
    MethodNotAllowed METHOD_NOT_ALLOWED;
    /// The body did not arrive in time.
    RequestTimeout REQUEST_TIMEOUT;
    /// The body is too large.
    TooLarge PAYLOAD_TOO_LARGE;
    /// A FAST STOP holds.
    FastStop CONFLICT;
    /// The fingers are not referenced.
    NotReferenced CONFLICT;
    /// A command is running.
    AlreadyRunning CONFLICT;
    /// Somebody else holds the lease, or the gripper is reserved.
    LeaseHeld CONFLICT;
    /// The lease token isn't that of the lease.
    StaleLease CONFLICT;
    /// The acknowledge names a FAST STOP that isn't the newest.
    StaleFastStop CONFLICT;
    /// The device has not confirmed the FAST STOP yet.
    FastStopUnconfirmed CONFLICT;
    /// The request id was used for another request.
    RequestIdReused CONFLICT;
    /// Another gateway on the Zenoh network has the same name.
    NameTaken CONFLICT;
    /// A value is beyond its limits.
    OutOfRange UNPROCESSABLE_ENTITY;
    /// The device refused, with a status that has no code of its own here.
    DeviceRefused UNPROCESSABLE_ENTITY;
    /// Too many requests wait for this gripper.
    Overloaded TOO_MANY_REQUESTS;
    /// A mistake of the gateway's own.
    Internal INTERNAL_SERVER_ERROR;
    /// The device's answer can't be one.
    DeviceProtocol BAD_GATEWAY;
    /// There is no working link to the device.
    LinkDown SERVICE_UNAVAILABLE;
    /// Nothing can be written down in the journal.
    JournalDown SERVICE_UNAVAILABLE;
    /// The device did not answer in time.
    DeviceTimeout GATEWAY_TIMEOUT;
    /// The gateway that owns the gripper is gone: nothing was sent to it.
    GatewayGone SERVICE_UNAVAILABLE;
    /// The gateway that owns the gripper did not answer: whether it was done isn't known.
    GatewayTimeout GATEWAY_TIMEOUT;
}

/// A problem, as RFC 9457 has it. Boxed: it is the rare case of every handler's result.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Problem(Box<Members>);

/// What was refused, and why (RFC 9457).
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Problem, example = json!({
    "type": "about:blank", "title": "Unprocessable Entity", "status": 422, "code": "out_of_range",
    "detail": "width_mm is 300, and must be from 0 to 110 (the device's stroke)",
    "field": "width_mm", "value": 300.0, "min": 0.0, "max": 110.0
}))]
pub struct Members {
    /// Always `about:blank`: the code says what it is.
    #[serde(rename = "type")]
    kind: &'static str,
    /// The HTTP status in words.
    title: &'static str,
    /// The HTTP status.
    #[schema(minimum = 400, maximum = 599)]
    status: u16,
    /// What is wrong, for programs.
    code: Code,
    /// What is wrong, for people, and what can be done.
    detail: String,
    /// The field that is wrong; only where one is.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    field: Option<String>,
    /// What it was; only where it is short.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    value: Option<Value>,
    /// The lowest allowed value; only where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = -1e300, maximum = 1e300)]
    min: Option<Number>,
    /// The highest allowed value, or the most bytes; only where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = -1e300, maximum = 1e300)]
    max: Option<Number>,
    /// The device's status, by its symbol; only where it refused.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    device_status: Option<String>,
    /// The same, by its number.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false, minimum = 0, maximum = 65535)]
    device_status_code: Option<u16>,
    /// The FAST STOP that an acknowledge has to name; only where one holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<uuid::Uuid>, nullable = false)]
    fast_stop_id: Option<FastStopId>,
    /// The running command's id; only where one is in the way.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<uuid::Uuid>, nullable = false)]
    command: Option<CommandId>,
    /// Who holds the lease; only where that is in the way.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<String>, nullable = false)]
    holder: Option<Arc<str>>,
    /// How long its lease lives without use; only where somebody holds it.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false, minimum = 0, maximum = 9_007_199_254_740_991_i64)]
    expires_in_ms: Option<u64>,
    /// Whether the journal has it already, as a command's end.
    #[serde(skip)]
    #[schema(ignore)]
    is_recorded: bool,
}

impl Members {
    /// The HTTP status.
    pub fn status(&self) -> StatusCode {
        self.code.status()
    }
}

impl Problem {
    /// With this code, and these words for people.
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        let status = code.status();
        Self(Box::new(Members {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or_default(),
            status: status.as_u16(),
            code,
            detail: detail.into(),
            field: None,
            value: None,
            min: None,
            max: None,
            device_status: None,
            device_status_code: None,
            fast_stop_id: None,
            command: None,
            holder: None,
            expires_in_ms: None,
            is_recorded: false,
        }))
    }

    /// A field of the wrong form.
    pub fn malformed(field: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::new(Code::Malformed, detail).field(field)
    }

    /// A number beyond its limits.
    pub fn out_of_range(field: &str, value: f64, min: f64, max: f64) -> Self {
        Self::new(Code::OutOfRange, format!("{field} is {value}, and must be from {min} to {max}"))
            .field(field)
            .value(Number::from_f64(value).map(Value::Number))
            .limits(Number::from_f64(min), Number::from_f64(max))
    }

    /// Text that is longer than a field takes.
    pub fn too_long(field: &str, bytes: usize, max: usize) -> Self {
        Self::new(Code::OutOfRange, format!("{field} has {bytes} bytes, and may have {max} at most"))
            .field(field)
            .limits(None, Some(max.into()))
    }

    /// There is no such thing.
    pub fn not_found(what: impl std::fmt::Display) -> Self {
        Self::new(Code::NotFound, format!("there is no {what}"))
    }

    /// Names the field that is wrong.
    pub fn field(mut self, field: impl Into<String>) -> Self {
        self.0.field = Some(field.into());
        self
    }

    /// Repeats what it was, where it is short.
    pub fn value(mut self, value: Option<Value>) -> Self {
        let short = |value: &Value| {
            !value.is_array() && !value.is_object() && !value.is_null() && value.to_string().len() <= MAX_VALUE_BYTES
        };
        self.0.value = value.filter(short);
        self
    }

    /// Says between what it must be.
    pub fn limits(mut self, min: Option<Number>, max: Option<Number>) -> Self {
        (self.0.min, self.0.max) = (min, max);
        self
    }

    /// Marks the problem as recorded in the journal.
    pub fn recorded(mut self) -> Self {
        self.mark_recorded();
        self
    }

    /// The same, in place.
    pub fn mark_recorded(&mut self) {
        self.0.is_recorded = true;
    }

    /// Whether the journal has a record of the problem.
    #[must_use]
    pub fn is_recorded(&self) -> bool {
        self.0.is_recorded
    }

    /// The code for programs.
    #[must_use]
    pub fn code(&self) -> Code {
        self.0.code
    }

    /// The code as clients see it.
    #[must_use]
    pub fn code_word(&self) -> String {
        self.0.code.word()
    }

    /// The description for people.
    #[must_use]
    pub fn detail(&self) -> &str {
        &self.0.detail
    }

    /// A panic: an error of the gateway's own, which ends one request and not the gateway.
    pub fn internal() -> Self {
        Self::new(Code::Internal, "the gateway made a mistake: its log says more")
    }

    /// The HTTP status.
    #[must_use]
    pub fn status(&self) -> StatusCode {
        self.0.status()
    }

    /// What is sent.
    pub fn members(&self) -> &Members {
        &self.0
    }

    fn device(mut self, status: Status) -> Self {
        self.0.device_status = Some(status.to_string());
        self.0.device_status_code = Some(status.code());
        self
    }

    fn fast_stop(mut self, id: Option<FastStopId>) -> Self {
        self.0.fast_stop_id = id;
        self
    }

    fn lease(mut self, holder: Option<Arc<str>>, expires_in_ms: Option<u64>) -> Self {
        (self.0.holder, self.0.expires_in_ms) = (holder, expires_in_ms);
        self
    }

    fn command(mut self, id: CommandId) -> Self {
        self.0.command = Some(id);
        self
    }
}

impl From<Rejection> for Problem {
    fn from(rejection: Rejection) -> Self {
        match rejection {
            Rejection::Invalid(invalid) => invalid.into(),
            Rejection::Conflict(conflict) => conflict.into(),
            Rejection::Device(refusal) => refusal.into(),
            Rejection::Failure(failure) => failure.into(),
        }
    }
}

impl From<Invalid> for Problem {
    fn from(invalid: Invalid) -> Self {
        let detail = invalid.to_string();
        match invalid {
            Invalid::OutOfRange { field, value, min, max, limit: _ } => Self::new(Code::OutOfRange, detail)
                .field(field)
                .value(decimal(value).map(Value::Number))
                .limits(decimal(min), decimal(max)),
            Invalid::Malformed { field, detail: _ } => Self::malformed(field, detail),
        }
    }
}

impl From<Conflict> for Problem {
    fn from(conflict: Conflict) -> Self {
        let detail = conflict.to_string();
        match conflict {
            Conflict::FastStop { id } | Conflict::FastStopPersists { id, flags: _ } => {
                Self::new(Code::FastStop, detail).fast_stop(Some(id))
            }
            Conflict::StaleFastStop { given: _, current } => Self::new(Code::StaleFastStop, detail).fast_stop(current),
            Conflict::Acknowledging { id } => Self::new(Code::AlreadyRunning, detail).fast_stop(Some(id)),
            Conflict::FastStopUnconfirmed { id } => Self::new(Code::FastStopUnconfirmed, detail).fast_stop(Some(id)),
            Conflict::NotReferenced => Self::new(Code::NotReferenced, detail),
            Conflict::AlreadyRunning { id } => Self::new(Code::AlreadyRunning, detail).command(id),
            Conflict::SettingsLost { .. } => Self::new(Code::DeviceRefused, detail),
            Conflict::LeaseHeld { holder, expires_in_ms } => {
                Self::new(Code::LeaseHeld, detail).lease(Some(holder), expires_in_ms)
            }
            Conflict::StaleLease { epoch: _, holder } => Self::new(Code::StaleLease, detail).lease(holder, None),
            Conflict::RequestIdReused => Self::new(Code::RequestIdReused, detail),
        }
    }
}

impl From<DeviceRefusal> for Problem {
    fn from(refusal: DeviceRefusal) -> Self {
        let detail = refusal.to_string();
        let code = match refusal.status {
            Status::E_ACCESS_DENIED if refusal.fast_stop.is_some() => Code::FastStop,
            Status::E_NOT_INITIALIZED => Code::NotReferenced,
            Status::E_ALREADY_RUNNING => Code::AlreadyRunning,
            Status::E_RANGE_ERROR => Code::OutOfRange,
            _ => Code::DeviceRefused,
        };
        Self::new(code, detail).device(refusal.status).fast_stop(refusal.fast_stop)
    }
}

impl From<ReadError> for Problem {
    fn from(error: ReadError) -> Self {
        Self::new(Code::JournalDown, error.to_string())
    }
}

impl From<Failure> for Problem {
    fn from(failure: Failure) -> Self {
        let code = match failure {
            Failure::LinkDown { .. } | Failure::Draining => Code::LinkDown,
            Failure::DeviceTimeout { .. } => Code::DeviceTimeout,
            Failure::DeviceProtocol { .. } => Code::DeviceProtocol,
            Failure::JournalDown { .. } => Code::JournalDown,
            Failure::Overloaded { .. } | Failure::RequestIds { .. } | Failure::FlashWear { .. } => Code::Overloaded,
            Failure::LineTime { .. } => Code::AlreadyRunning,
        };
        Self::new(code, failure.to_string())
    }
}

/// A single by its shortest decimal digits: 96.3, where its exact value as a double is 96.30000305175781.
fn decimal(value: f32) -> Option<Number> {
    value.to_string().parse().ok().and_then(Number::from_f64)
}

#[cfg(test)]
mod tests;
