//! Waits for commands, bounded per connection.

use std::sync::Arc;
use std::time::Duration;

use axum::http::Extensions;
use futures_util::future::{BoxFuture, FutureExt as _};

use crate::connections::admission::{Class, ConnectionPermit};
use crate::connections::pace::RequestPace;
use crate::gripper::Ticket;
use crate::model::CommandReport;
use crate::operations::WaitLimiter;

/// Delay of a connection's next request after its wait was cut short.
const CUT_SHORT_DELAY: Duration = Duration::from_secs(1);

/// The bound that a connection sets on waits. A wait is cut short if more requests wait than the gateway allows, or if
/// this client has more than its share of them. The response is then the same as after `wait_ms`.
#[derive(Debug)]
pub struct ConnectionWaits {
    permit: Arc<ConnectionPermit>,
    pace: Option<Arc<RequestPace>>,
}

impl ConnectionWaits {
    pub fn of(extensions: &Extensions) -> Option<Arc<dyn WaitLimiter>> {
        let permit: Arc<ConnectionPermit> = extensions.get().cloned()?;
        Some(Arc::new(Self { permit, pace: extensions.get().cloned() }))
    }

    async fn wait(&self, ticket: &mut Ticket, limit: Duration) -> CommandReport {
        if let Some(claim) = self.permit.claim(Class::Waiting) {
            tokio::select! {
                biased;
                command = ticket.wait(limit) => return command,
                () = claim.yielded() => {}
            }
        }
        self.permit.demote();
        // A client that repeats its request at once would starve others.
        if let Some(pace) = &self.pace {
            pace.delay(CUT_SHORT_DELAY);
        }
        ticket.now()
    }
}

impl WaitLimiter for ConnectionWaits {
    fn until_ended<'a>(&'a self, ticket: &'a mut Ticket, limit: Duration) -> BoxFuture<'a, CommandReport> {
        self.wait(ticket, limit).boxed()
    }
}
