//! Limits of streamed targets: a client that continues after a gap must not make the fingers jump.
//!
//! A target beyond them is refused, and never changed: a client has to know where the fingers go.

use super::super::Now;
use super::Actor;
use model::error::{Failure, Invalid, Rejection};
use model::{Action, Motion, ScriptTarget, Submission};

impl Actor {
    /// The target of a request, if the limits of streams concern its script.
    pub(super) fn limited_target(&self, action: &Action) -> Option<ScriptTarget> {
        let rules = &self.config.rules.servo;
        match action {
            Action::Motion(Motion::Custom(custom)) if rules.limits_stream_of(custom.id()) => {
                rules.target_in(custom.payload())
            }
            _ => None,
        }
    }

    /// Checks the target of a streamed request.
    pub(super) fn check_stream_target(&self, now: Now, submission: &Submission) -> Result<(), Rejection> {
        let rules = &self.config.rules.servo;
        let Action::Motion(Motion::Custom(custom)) = &submission.action else { return Ok(()) };
        if !rules.limits_stream_of(custom.id()) {
            return Ok(());
        }
        let Some(target) = self.limited_target(&submission.action) else {
            let detail =
                "it has no width and speed where servo_adapter expects them, so the limits of streams can't be \
                          checked: correct the request or servo_adapter"
                    .to_owned();
            return Err(Invalid::Malformed { field: "payload", detail }.into());
        };
        let max_mm_s = f32::from(rules.stream_max_speed_mm_s);
        if max_mm_s > 0.0 {
            check_range("speed_mm_s", target.speed_mm_s, (0.0, max_mm_s), "stream_max_speed_mm_s")?;
        }
        let step_mm = f32::from(rules.stream_max_step_mm);
        if step_mm > 0.0 {
            let newest = self.streaming.target_mm(now.instant, submission.lease.as_ref());
            let Some(from) = newest.or_else(|| self.observed.values.width_mm(now.instant)) else {
                let cause = "a target is limited to steps from it (stream_max_step_mm)".to_owned();
                return Err(Failure::ValueUnknown { command: "GetWidth", cause }.into());
            };
            check_range("width_mm", target.width_mm, (from - step_mm, from + step_mm), "stream_max_step_mm")?;
        }
        Ok(())
    }
}

/// Checks a number of a client. A NaN is in no range.
fn check_range(field: &'static str, value: f32, (min, max): (f32, f32), limit: &'static str) -> Result<(), Invalid> {
    if (min..=max).contains(&value) { Ok(()) } else { Err(Invalid::OutOfRange { field, value, min, max, limit }) }
}
