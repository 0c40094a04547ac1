//! The farewell of a socket: the last FAST STOPs of its client, and the closing handshake.

use std::time::Duration;

use futures_util::future::{BoxFuture, FutureExt as _, join_all};
use futures_util::stream::StreamExt as _;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::CloseFrame;
use tokio_tungstenite::tungstenite::protocol::frame::Frame;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;

use super::answered::Answered;
use super::end::SocketEnd;
use super::rpc::{self, Incoming};
use super::socket::Socket;
use crate::events::encoded;
use crate::gripper::model::LossCause;
use crate::operations::is_fast_stop;

/// Time limit of the closing handshake.
const FAREWELL_WITHIN: Duration = Duration::from_secs(1);

/// Reads without a message that end the search for FAST STOPs.
const MAX_MISSES: u8 = 4;

/// Maximum number of messages that are searched for a FAST STOP after the end of their socket.
const MAX_LAST_MESSAGES: usize = 256;

impl Socket {
    /// Serves the client until its end.
    pub(super) async fn run(mut self: Box<Self>) {
        let end = self.read().await;
        tracing::debug!(client = %self.client.subject, ?end, "WebSocket ended");
        if end != SocketEnd::Closing {
            self.take_last_fast_stops().await;
        }
        // On shutdown the gateway has already released its grippers.
        for (lease, _) in self.leases.values().filter(|_| end != SocketEnd::Closing) {
            lease.lose(LossCause::Disconnected).await;
        }
        let (code, reason) = match end {
            SocketEnd::Closing => (CloseCode::Away, "the gateway is shutting down"),
            SocketEnd::Lost => (CloseCode::Policy, "pings were not answered"),
            SocketEnd::Evicted => (CloseCode::Again, "evicted: too many connections, or too many unread bytes"),
            SocketEnd::Violation(code, reason) => (code, reason),
            SocketEnd::Closed => (CloseCode::Normal, ""),
            SocketEnd::Unwritable => return,
        };
        if end != SocketEnd::Closed {
            self.outbox.push(encoded(Frame::close(Some(CloseFrame { code, reason: reason.into() }))));
        }
        self.outbox.close();
        let within = match (&self.permit, end) {
            (Some(permit), SocketEnd::Evicted) => permit.linger(),
            _ => FAREWELL_WITHIN,
        };
        let farewell = async {
            // A vanished client does not read the farewell.
            if matches!((&mut self.writer).await, Ok(Ok(()))) {
                while let Some(Ok(message)) = self.incoming.next().await {
                    self.incoming.get_mut().taken();
                    join_all(self.fast_stops_in(&message)).await;
                }
            }
        };
        let _ = timeout(within, farewell).await;
    }

    /// Begins the FAST STOPs among the messages that have arrived. They end without the socket.
    async fn take_last_fast_stops(&mut self) {
        let mut misses = 0;
        for _ in 0..MAX_LAST_MESSAGES {
            match self.incoming.next().now_or_never() {
                Some(Some(Ok(message))) => drop(self.fast_stops_in(&message)),
                // The stream gives others a turn now and then, although bytes have arrived.
                None if misses < MAX_MISSES => misses += 1,
                Some(_) | None => return,
            }
            tokio::task::yield_now().await;
        }
    }

    /// Begins the FAST STOPs in a message, and nothing else.
    fn fast_stops_in(&self, message: &Message) -> Vec<BoxFuture<'static, Answered>> {
        let (Message::Text(_) | Message::Binary(_)) = message else { return Vec::new() };
        let payload = message.clone().into_data();
        let text = String::from_utf8_lossy(&payload);
        let calls = match rpc::parse(&text) {
            Incoming::One(call) => vec![call],
            Incoming::Batch(calls) => calls,
        };
        let fast_stops = calls.into_iter().flatten().filter(|call| is_fast_stop(&call.method));
        fast_stops.map(|call| self.answered(Ok(call))).collect()
    }
}
