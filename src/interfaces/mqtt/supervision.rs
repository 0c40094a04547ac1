//! Keeps one connection to the broker open: after a failure it is opened again, after a pause.

use std::future::Future;
use std::panic::AssertUnwindSafe;
use std::sync::Arc;
use std::time::Duration;

use futures_util::FutureExt as _;
use tokio::time::sleep;
use tokio_util::sync::CancellationToken;

use super::connection::{BrokerConnection, ConnectionPurpose};
use super::failure::MqttFailure;
use super::mqtt_settings::MqttSettings;
use super::status::MqttStatus;

/// Time for the work to end, whatever the broker takes.
const ENDED_WITHIN: Duration = Duration::from_secs(3);

/// Work of one connection.
pub(super) trait Serve: Send {
    fn purpose(&self) -> ConnectionPurpose;

    /// Uses a connection until it fails, or until the work ends.
    fn serve(&mut self, connection: BrokerConnection) -> impl Future<Output = Result<(), MqttFailure>> + Send;
}

/// Serves one connection after another, until the work ends.
pub(super) async fn keep_serving(
    work: &mut impl Serve,
    settings: &MqttSettings,
    status: &Arc<MqttStatus>,
    ending: &CancellationToken,
) {
    let purpose = work.purpose();
    status.metrics.serves(purpose);
    loop {
        let attempt = AssertUnwindSafe(attempt(work, settings, ending)).catch_unwind();
        let Err(failure) = attempt.await.unwrap_or(Err(MqttFailure::Panicked)) else { break };
        let pause = status.failed(purpose, &failure);
        tokio::select! {
            () = sleep(pause) => {}
            () = ending.cancelled() => break,
        }
    }
    status.metrics.ends(purpose);
}

async fn attempt(
    work: &mut impl Serve,
    settings: &MqttSettings,
    ending: &CancellationToken,
) -> Result<(), MqttFailure> {
    let connection = tokio::select! {
        connection = BrokerConnection::open(settings, work.purpose()) => connection?,
        () = ending.cancelled() => return Ok(()),
    };
    let too_late = async {
        ending.cancelled().await;
        sleep(ENDED_WITHIN).await;
    };
    tokio::select! {
        result = work.serve(connection) => result,
        () = too_late => Ok(()),
    }
}
