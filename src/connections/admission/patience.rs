//! A moment for connections that have sent nothing yet, before further ones displace them.

use std::time::Duration;

use tokio::task::yield_now;
use tokio::time::{Instant, sleep, timeout};

use super::Admission;
use super::table::SILENT_FOR;

/// Interval of looking for first bytes.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// Rest after a wait, as a multiple of its time. A flood of silent connections thus keeps the listener waiting for a
/// fifth of the time at most.
const RESTS: u32 = 4;

/// Patience of a listener: further connections wait in the kernel, where their first bytes arrive meanwhile. Only a
/// gateway with few file descriptors has so few slots that this happens.
#[derive(Debug, Default)]
pub struct Patience {
    rests_until: Option<Instant>,
}

impl Patience {
    /// Waits at most 5 ms while one more connection would displace one that has had no time to send its first bytes.
    pub async fn wait(&mut self, admission: &Admission) {
        let begun = Instant::now();
        if self.rests_until.is_some_and(|until| begun < until) || !admission.would_displace() {
            return;
        }
        // Lets the connections' tasks read first bytes that have already arrived.
        yield_now().await;
        let displaces = async {
            while admission.would_displace() {
                sleep(LOOK_EVERY).await;
            }
        };
        let _ = timeout(SILENT_FOR, displaces).await;
        self.rests_until = Some(Instant::now() + RESTS * begun.elapsed());
    }
}
