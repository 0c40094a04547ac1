//! Changes of the gateway's own data, which are answered once they are durable.

use std::time::Duration;

use tokio::sync::oneshot;
use tokio::time::timeout;

use super::call::Call;
use crate::gripper::recorder::Recorder as _;
use crate::model::Code;
use crate::operations::problem::Problem;

/// Time limit for a change to become durable. A disk that hangs would otherwise hold requests forever.
const DURABLE_WITHIN: Duration = Duration::from_secs(2);

/// Refuses a change that would not become durable. `unchanged` says what was not changed.
pub(in crate::operations) fn check_journal<P>(call: &Call<P>, unchanged: &str) -> Result<(), Problem> {
    let failure = call.gateway.journal.health().borrow().failure.clone();
    match failure {
        Some(cause) => Err(Problem::new(Code::JournalDown, format!("journal unavailable ({cause}): {unchanged}"))),
        None => Ok(()),
    }
}

/// Waits until a change is durable.
pub(in crate::operations) async fn durable(change: oneshot::Receiver<()>) -> Result<(), Problem> {
    if let Ok(Ok(())) = timeout(DURABLE_WITHIN, change).await {
        return Ok(());
    }
    let detail = "journal unavailable: the change is in effect but not saved; it is lost if the gateway restarts before the \
                  journal recovers";
    Err(Problem::new(Code::JournalDown, detail))
}
