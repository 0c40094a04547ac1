//! A command as its clients see it.

use std::sync::Arc;

use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

use super::{Code, CommandId, FastStopId, Kind, Name, Outcome, Phase, RequestedValues, Submission};
use crate::error::Rejection;
use wsg::Status;

/// A command, running or ended.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Command, example = json!({
    "id": "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f", "gripper": "left", "number": 17, "kind": "grip", "phase": "done",
    "outcome": "PART_HELD", "outcome_code": 2, "status": "E_SUCCESS", "status_code": 0, "reached_goal": true, "stalled": true,
    "width_mm": 20.0, "force_n": 40.0, "started_at": "2026-11-21T09:00:00.000Z", "duration_ms": 412,
    "subject": "http:127.0.0.1", "client": "http:127.0.0.1", "replayed": false
}))]
pub struct CommandReport {
    /// Id of the command, a version 7 UUID.
    pub id: CommandId,
    /// Name of the gripper.
    pub gripper: Name,
    /// Number of the motion, which `last_command` in the gripper's status repeats. Null for a Stop, for a streamed
    /// command, and for an older command after a restart of the gateway.
    #[schema(required, format = Int64, minimum = 0, maximum = 4_294_967_295_i64)]
    pub number: Option<u32>,
    /// Kind of the command.
    pub kind: Kind,
    /// Whether the command has ended.
    pub phase: Phase,
    /// Result of the command; null while it runs.
    #[schema(required)]
    pub outcome: Option<Outcome>,
    /// Result of the command as a number:
    ///
    /// - 0: the command runs
    /// - 1 to 11: `SUCCESS`, `PART_HELD`, `NO_PART`, `BLOCKED`, `ABORTED`, `RANGE`, `TIMEOUT`, `FAILED`, `REFUSED`,
    ///   `UNKNOWN`, `WRONG_PART`
    #[schema(minimum = 0, maximum = 255)]
    pub outcome_code: u8,
    /// Symbol of the last status code from the device, such as `E_SUCCESS`; null if the device sent none.
    #[schema(required)]
    pub status: Option<String>,
    /// The same status code as a number.
    #[schema(required, minimum = 0, maximum = 65535)]
    pub status_code: Option<u16>,
    /// Whether the command reached its goal: the target width, or a held part. Null while unknown.
    #[schema(required)]
    pub reached_goal: Option<bool>,
    /// Whether contact stopped the fingers. Null while unknown.
    #[schema(required)]
    pub stalled: Option<bool>,
    /// Opening width at the end, in mm; null while running or if unknown.
    #[schema(required, minimum = -1000, maximum = 1000)]
    pub width_mm: Option<f32>,
    /// Gripping force at the end, in N; null while running or if unknown.
    #[schema(required, minimum = -10000, maximum = 10000)]
    pub force_n: Option<f32>,
    /// Opening width at which the fingers met the part, in mm; absent unless a part was gripped.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false, minimum = -1000, maximum = 1000)]
    pub contact_width_mm: Option<f32>,
    /// Force with the greatest magnitude up to the end of a grip, in N. The grip record's peak also covers the second
    /// after the end.
    #[serde(skip)]
    pub peak_force_n: Option<f32>,
    /// Time of admission.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub started_at: Timestamp,
    /// Time from admission to end, in ms; null while running.
    #[schema(required, minimum = 0)]
    pub duration_ms: Option<u64>,
    /// Subject of the client that requested the command.
    pub subject: Arc<str>,
    /// Same as `subject`.
    #[schema(deprecated)]
    pub client: Arc<str>,
    /// Whether this is the reply to a repeated request, whose command was admitted earlier.
    pub replayed: bool,
    /// Id of the FAST STOP that came while the command ran; otherwise absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub fast_stop_id: Option<FastStopId>,
    /// Reply of a custom command's script, as hex; absent for other commands and after a restart of the gateway.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false, max_length = 8192)]
    pub payload: Option<Arc<str>>,
    /// Code of the problem that ended the command as `BLOCKED`, `RANGE`, `TIMEOUT`, `FAILED`, `REFUSED` or `UNKNOWN`;
    /// otherwise absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub code: Option<Code>,
    /// Description of that problem and its remedy, for people.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub detail: Option<String>,
    /// Holder, id and values of the request, for the journal.
    #[serde(skip)]
    pub requested: RequestedValues,
    /// Reason for a refusal, which waiting clients get as a problem.
    #[serde(skip)]
    pub rejection: Option<Rejection>,
    /// Subject of the client that cancelled the command, for the journal.
    #[serde(skip)]
    pub cancelled_by: Option<Arc<str>>,
    /// Whether the admission is recorded in the journal, so that clients can learn of the command.
    #[serde(skip)]
    pub recorded: bool,
    /// Whether the device has accepted the command with E_CMD_PENDING.
    #[serde(skip)]
    pub accepted: bool,
}

impl CommandReport {
    #[must_use]
    pub fn admitted(id: CommandId, gripper: Name, submission: &Submission, at: Timestamp) -> Self {
        let requested = RequestedValues::of(&submission.action, submission.request_id.clone());
        let subject = submission.client.subject.clone();
        Self { requested, ..Self::running(id, gripper, submission.action.kind(), subject, at) }
    }

    /// Returns the report of a running command. All other fields are empty.
    #[must_use]
    pub fn running(id: CommandId, gripper: Name, kind: Kind, subject: Arc<str>, at: Timestamp) -> Self {
        Self {
            id,
            gripper,
            number: None,
            kind,
            phase: Phase::Running,
            outcome: None,
            outcome_code: 0,
            status: None,
            status_code: None,
            reached_goal: None,
            stalled: None,
            width_mm: None,
            force_n: None,
            contact_width_mm: None,
            peak_force_n: None,
            started_at: at,
            duration_ms: None,
            client: subject.clone(),
            subject,
            replayed: false,
            fast_stop_id: None,
            payload: None,
            code: None,
            detail: None,
            requested: RequestedValues::default(),
            rejection: None,
            cancelled_by: None,
            recorded: false,
            accepted: false,
        }
    }

    /// Sets the result of the command.
    pub fn set_outcome(&mut self, outcome: Outcome) {
        self.outcome = Some(outcome);
        self.outcome_code = outcome.code();
    }

    /// Adds the reason for an outcome.
    pub fn explain(&mut self, code: Code, reason: &impl ToString) {
        self.code = Some(code);
        self.detail = Some(reason.to_string());
    }

    pub fn set_status(&mut self, status: Status) {
        self.status = Some(status.to_string());
        self.status_code = Some(status.code());
    }
}
