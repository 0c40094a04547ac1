//! Parameters of operations, for the OpenAPI document.

use utoipa::{IntoParams, IntoResponses};

use crate::gripper::model::CommandReport;
use crate::operations::statistics::MeasuredGrips;

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "only described here")]
pub struct GripperPath {
    /// The gripper's name.
    #[param(min_length = 1, max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "only described here")]
pub struct CommandPath {
    /// The command's id, as returned when the command was started.
    #[param(example = "019aa5c8-5a70-7c31-9f3f-4a3b7c1d2e4f")]
    command: uuid::Uuid,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "only described here")]
pub struct FingerPath {
    /// Number of the finger: 1 or 2.
    #[param(minimum = 1, maximum = 2, example = 1)]
    finger: u8,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "only described here")]
pub struct WebhookPath {
    /// The webhook's name.
    #[param(min_length = 1, max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "mes")]
    webhook: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Path)]
#[allow(dead_code, reason = "only described here")]
pub struct RecipePath {
    /// Id of the part: at most 48 bytes in UTF-8.
    #[param(min_length = 1, max_length = 48, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]+$", example = "A-1047")]
    part_id: String,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "only described here")]
pub struct ConditionHeaders {
    /// Version that the recipe must have, as in its `ETag`, or `*` for any; otherwise the request fails with 412.
    #[param(
        rename = "If-Match",
        nullable = false,
        min_length = 1,
        max_length = 64,
        pattern = "^(\\*|\"[0-9]{1,16}\")$"
    )]
    if_match: Option<String>,
    /// `*` if there must be no recipe yet; otherwise the request fails with 412.
    #[param(rename = "If-None-Match", nullable = false, min_length = 1, max_length = 64, pattern = "^\\*$")]
    if_none_match: Option<String>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only described here")]
pub struct LatestQuery {
    /// Request id that this client sent with the command within the last 10 minutes.
    #[param(max_length = 64, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]*$", example = "k3-17")]
    request_id: Option<String>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only described here")]
pub struct GripStatisticsQuery {
    /// Only grips of this part. At most 48 bytes.
    #[param(min_length = 1, max_length = 48, pattern = "^[^\\u0000-\\u001f\\u007f-\\u009f]+$", example = "A-1047")]
    part_id: Option<String>,
    /// Only grips of this gripper.
    #[param(max_length = 32, pattern = "^[a-z0-9][a-z0-9_-]{0,31}$", example = "left")]
    gripper: Option<String>,
    /// Only grips from this time on.
    #[param(value_type = Option<String>, format = DateTime, example = "2026-11-21T09:00:00Z")]
    from: Option<String>,
    /// Only grips before this time.
    #[param(value_type = Option<String>, format = DateTime, example = "2026-11-22T09:00:00Z")]
    to: Option<String>,
    /// Kind of the grips: `grip` (default), or `reference` for reference grips.
    kind: Option<MeasuredGrips>,
    /// Number of the part's newest grips; all by default. Needs `part_id`.
    #[param(minimum = 1, maximum = 1_000_000)]
    window: Option<u32>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only described here")]
pub struct WaitQuery {
    /// Maximum time to wait for the command to end, in ms. 0 returns at once; the default is 5000.
    #[param(minimum = 0, maximum = 60000, default = 5000, example = 5000)]
    wait_ms: Option<u64>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only described here")]
pub struct NoWaitQuery {
    /// Maximum time to wait for the command to end, in ms. The default is 0: the command is returned at once.
    #[param(minimum = 0, maximum = 60000, default = 0, example = 5000)]
    wait_ms: Option<u64>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "only described here")]
pub struct LeaseHeader {
    /// The lease token, if the client holds the lease. The lease does not expire while the request is open.
    #[param(rename = "Wsg-Lease", nullable = false, max_length = 64, pattern = "^([!-~]([ -~]*[!-~])?)?$")]
    wsg_lease: Option<String>,
}

#[derive(IntoParams)]
#[into_params(parameter_in = Header)]
#[allow(dead_code, reason = "only described here")]
pub struct KeyHeaders {
    /// Same as `request_id` in the body, for clients that send it as a header.
    #[param(rename = "Idempotency-Key", nullable = false, max_length = 64, pattern = "^([!-~]([ -~]*[!-~])?)?$")]
    idempotency_key: Option<String>,
    /// Same as `lease` in the body.
    #[param(rename = "Wsg-Lease", nullable = false, max_length = 64, pattern = "^([!-~]([ -~]*[!-~])?)?$")]
    wsg_lease: Option<String>,
}

/// The reply to an operation that starts a command.
#[derive(IntoResponses)]
#[allow(dead_code, reason = "only described here")]
pub enum CommandReply {
    /// The ended command, with its `outcome`
    #[response(status = 200)]
    Ended(CommandReport),
    /// The command, still running after `wait_ms`
    #[response(status = 202, headers(("Location" = String, description = "Path of the command")))]
    Running(CommandReport),
}
