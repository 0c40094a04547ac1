//! Problems (RFC 9457): every refusal and failure in one form, with a stable code.

use std::sync::Arc;

use http::StatusCode;
use serde::Serialize;
use serde_json::{Number, Value};
use utoipa::ToSchema;

use crate::access::Unauthorized;
use crate::gripper::{Conflict, DeviceRefusal, Failure, Invalid, Rejection};
use crate::journal::ReadError;
use crate::model::{Code, CommandId, FastStopId};
use crate::wsg::Status;

/// Longest wrong value that an answer repeats, in bytes: the answer has to fit a small client's buffer.
const MAX_VALUE_BYTES: usize = 64;

/// Longest description and longest field in an answer, in bytes. Errors can contain texts of the client.
const MAX_DETAIL_BYTES: usize = 2048;
const MAX_FIELD_BYTES: usize = 128;

/// A problem (RFC 9457). Boxed, since it is the rare case of every handler's result.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(transparent)]
pub struct Problem(Box<Members>);

/// Description of a refused or failed request (RFC 9457).
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Problem, example = json!({
    "type": "about:blank", "title": "Unprocessable Entity", "status": 422, "code": "out_of_range",
    "code_number": 18, "detail": "width_mm is 300; it must be from 0 to 110 (the device's limits)",
    "field": "width_mm", "value": 300.0, "min": 0.0, "max": 110.0
}))]
pub struct Members {
    /// Always `about:blank`: `code` identifies the problem.
    #[serde(rename = "type")]
    kind: &'static str,
    /// HTTP status in words.
    title: &'static str,
    /// HTTP status.
    #[schema(minimum = 400, maximum = 599)]
    status: u16,
    /// Machine-readable cause.
    code: Code,
    /// The same cause as a number, which never changes.
    #[schema(minimum = 1, maximum = 65535)]
    code_number: u16,
    /// Description for people, with the remedy if there is one.
    detail: String,
    /// Name of the wrong field, if a field is wrong.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    field: Option<String>,
    /// Value of that field, if it is short.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    value: Option<Value>,
    /// Lowest allowed value, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = -1e300, maximum = 1e300)]
    min: Option<Number>,
    /// Highest allowed value, or largest allowed size in bytes, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<f64>, nullable = false, minimum = -1e300, maximum = 1e300)]
    max: Option<Number>,
    /// Status symbol with which the device refused the request, if it did.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    device_status: Option<String>,
    /// The same status as a number.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false, minimum = 0, maximum = 65535)]
    device_status_code: Option<u16>,
    /// Id of the latched FAST STOP, which an acknowledgement has to name; only if one is latched.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    fast_stop_id: Option<FastStopId>,
    /// Id of the running command that prevents the request, if one does.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    command_id: Option<CommandId>,
    /// Same as `command_id`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<uuid::Uuid>, nullable = false, deprecated)]
    command: Option<CommandId>,
    /// Holder of the lease, if the lease prevents the request.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    holder: Option<Arc<str>>,
    /// Time in ms until that lease expires without use; only with `lease_held`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false, minimum = 0)]
    expires_in_ms: Option<u64>,
    /// Whether the journal already has a record of the problem, e.g. as a command's end.
    #[serde(skip)]
    #[schema(ignore)]
    is_recorded: bool,
}

impl Members {
    /// Name of the wrong field, if a field is wrong.
    pub fn field(&self) -> Option<&str> {
        self.field.as_deref()
    }

    pub fn status(&self) -> StatusCode {
        StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR)
    }
}

/// Whether a problem can repeat the value.
fn is_short(value: &Value) -> bool {
    !value.is_array() && !value.is_object() && !value.is_null() && value.to_string().len() <= MAX_VALUE_BYTES
}

/// Cuts a text between two characters.
fn cut(mut text: String, max: usize) -> String {
    text.truncate(text.floor_char_boundary(max));
    text
}

impl Problem {
    pub fn new(code: Code, detail: impl Into<String>) -> Self {
        let status = StatusCode::from_u16(code.http_status()).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        Self(Box::new(Members {
            kind: "about:blank",
            title: status.canonical_reason().unwrap_or_default(),
            status: status.as_u16(),
            code,
            code_number: code.number(),
            detail: cut(detail.into(), MAX_DETAIL_BYTES),
            field: None,
            value: None,
            min: None,
            max: None,
            device_status: None,
            device_status_code: None,
            fast_stop_id: None,
            command_id: None,
            command: None,
            holder: None,
            expires_in_ms: None,
            is_recorded: false,
        }))
    }

    /// Reports a field of the wrong form.
    pub fn malformed(field: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::new(Code::Malformed, detail).field(field)
    }

    /// Reports a number beyond its limits.
    pub fn out_of_range(field: &str, value: f64, min: f64, max: f64) -> Self {
        Self::new(Code::OutOfRange, format!("{field} is {value}; it must be from {min} to {max}"))
            .field(field)
            .value(Number::from_f64(value).map(Value::Number))
            .limits(Number::from_f64(min), Number::from_f64(max))
    }

    /// Reports a text that is too long for its field.
    pub fn too_long(field: &str, bytes: usize, max: usize) -> Self {
        Self::new(Code::OutOfRange, format!("{field} has {bytes} bytes; at most {max} are allowed"))
            .field(field)
            .limits(None, Some(max.into()))
    }

    /// Reports a missing thing. `what` completes the sentence "no …".
    pub fn not_found(what: impl std::fmt::Display) -> Self {
        Self::new(Code::NotFound, format!("no {what}"))
    }

    /// Names the wrong field.
    pub fn field(mut self, field: impl Into<String>) -> Self {
        self.0.field = Some(cut(field.into(), MAX_FIELD_BYTES));
        self
    }

    /// Repeats the wrong value, if it is short.
    pub fn value(mut self, value: Option<Value>) -> Self {
        self.0.value = value.filter(is_short);
        self
    }

    /// Adds the allowed range.
    pub fn limits(mut self, min: Option<Number>, max: Option<Number>) -> Self {
        (self.0.min, self.0.max) = (min, max);
        self
    }

    /// Marks the problem as recorded in the journal.
    pub fn recorded(mut self) -> Self {
        self.mark_recorded();
        self
    }

    pub fn mark_recorded(&mut self) {
        self.0.is_recorded = true;
    }

    /// Whether the journal has a record of the problem.
    #[must_use]
    pub fn is_recorded(&self) -> bool {
        self.0.is_recorded
    }

    #[must_use]
    pub fn code(&self) -> Code {
        self.0.code
    }

    /// The code as clients see it.
    #[must_use]
    pub fn code_word(&self) -> String {
        self.0.code.word().to_owned()
    }

    #[must_use]
    pub fn detail(&self) -> &str {
        &self.0.detail
    }

    /// Reports a panic, which ends one request but not the gateway.
    pub fn internal() -> Self {
        Self::new(Code::Internal, "internal error; see the gateway's log")
    }

    #[must_use]
    pub fn status(&self) -> StatusCode {
        self.0.status()
    }

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

    /// Adds the ids and holders that the conflict names.
    fn conflict(self, conflict: Conflict) -> Self {
        match conflict {
            Conflict::FastStop { id }
            | Conflict::FastStopPersists { id, flags: _ }
            | Conflict::FastStopUnconfirmed { id } => self.fast_stop(Some(id)),
            Conflict::Acknowledging { id } => self.fast_stop(id),
            Conflict::StaleFastStop { given: _, current } => self.fast_stop(current),
            Conflict::AlreadyRunning { id } => self.command(id),
            Conflict::LeaseHeld { holder, expires_in_ms }
            | Conflict::LeaseTokenMissing { holder, expires_in_ms, .. } => {
                self.lease(Some(holder), Some(expires_in_ms))
            }
            Conflict::LeaseBound { holder, ttl_ms } => self.lease(Some(holder), Some(ttl_ms)),
            Conflict::Reserved { holder } | Conflict::LeaseRequested { holder, place: _ } => {
                self.lease(Some(holder), None)
            }
            Conflict::StaleLease { epoch: _, holder } => self.lease(holder, None),
            Conflict::NotReferenced
            | Conflict::FingersMove
            | Conflict::SettingsLost { .. }
            | Conflict::RequestIdReused
            | Conflict::UnknownPast
            | Conflict::Steering { .. }
            | Conflict::NoServo { .. } => self,
            Conflict::StaleTarget { .. } => self.field("at"),
        }
    }

    fn command(mut self, id: CommandId) -> Self {
        (self.0.command_id, self.0.command) = (Some(id), Some(id));
        self
    }
}

impl From<Unauthorized> for Problem {
    fn from(unknown: Unauthorized) -> Self {
        Self::new(Code::Unauthorized, unknown.to_string())
    }
}

impl From<Rejection> for Problem {
    fn from(rejection: Rejection) -> Self {
        let problem = Self::new(rejection.code(), rejection.to_string());
        match rejection {
            Rejection::Invalid(Invalid::OutOfRange { field, value, min, max, limit: _ }) => {
                problem.field(field).value(decimal(value).map(Value::Number)).limits(decimal(min), decimal(max))
            }
            Rejection::Invalid(Invalid::Malformed { field, detail: _ }) => problem.field(field),
            Rejection::Conflict(conflict) => problem.conflict(conflict),
            Rejection::Device(DeviceRefusal { status, fast_stop, .. }) => problem.device(status).fast_stop(fast_stop),
            Rejection::Failure(_) => problem,
        }
    }
}

impl From<Failure> for Problem {
    fn from(failure: Failure) -> Self {
        Rejection::from(failure).into()
    }
}

impl From<ReadError> for Problem {
    fn from(error: ReadError) -> Self {
        Self::new(Code::JournalDown, error.to_string())
    }
}

/// Converts an `f32` by its shortest decimal digits: 96.3, rather than its exact value as a double, 96.30000305175781.
fn decimal(value: f32) -> Option<Number> {
    value.to_string().parse().ok().and_then(Number::from_f64)
}

#[cfg(test)]
mod tests;
