//! The farewell of a socket: the last FAST STOPs and Stops of its client, and the closing handshake.

use std::time::Duration;

use futures_util::future::FutureExt as _;
use futures_util::stream::StreamExt as _;
use tokio::time::timeout;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::protocol::CloseFrame;
use tokio_tungstenite::tungstenite::protocol::frame::Frame;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;

use super::rpc::{self, Incoming, RpcMethod};
use super::socket::Socket;
use super::socket_end::SocketEnd;
use crate::events::encoded;
use crate::model::{LossCause, Urgency};

/// Time limit of the closing handshake.
const FAREWELL_WITHIN: Duration = Duration::from_secs(1);

/// Consecutive reads without a message that end the search for FAST STOPs and Stops. The longest valid message needs
/// fewer. Longer ones are still read during the closing handshake.
const MAX_MISSES: u8 = 40;

/// Maximum number of messages that are searched for FAST STOPs and Stops after the end of their socket.
const MAX_LAST_MESSAGES: usize = 256;

/// Maximum number of FAST STOPs, and of Stops, that are begun after the end of their socket.
const MAX_LAST_STOPS: usize = 256;

/// Numbers of FAST STOPs and Stops that were found after the end of their socket.
#[derive(Default)]
struct Begun {
    fast_stops: usize,
    stops: usize,
}

impl Socket {
    /// Serves the client until its end.
    pub(super) async fn run(mut self: Box<Self>) {
        let end = self.read().await;
        tracing::debug!(client = %self.client.subject, ?end, "WebSocket ended");
        // Leases that were granted a moment ago are lost, too.
        while let Some(Some(done)) = self.calls.next().now_or_never() {
            self.take_done(done);
        }
        let mut begun = Begun::default();
        if end != SocketEnd::Closing {
            self.take_last_stops(&mut begun).await;
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
            let mut is_writing = true;
            let mut is_reading = true;
            // Reads meanwhile, in case the client sends a FAST STOP but reads nothing.
            while is_writing || is_reading {
                tokio::select! {
                    biased;
                    written = &mut self.writer, if is_writing => {
                        is_writing = false;
                        // A vanished client does not read the farewell.
                        is_reading &= matches!(written, Ok(Ok(())));
                    }
                    message = self.incoming.next(), if is_reading => match message {
                        Some(Ok(message)) => self.begin_stops_in(&message, &mut begun),
                        _ => is_reading = false,
                    },
                }
            }
        };
        let _ = timeout(within, farewell).await;
    }

    /// Begins the FAST STOPs and Stops among the messages that have arrived. They end without the socket.
    async fn take_last_stops(&mut self, begun: &mut Begun) {
        let mut messages = 0;
        let mut misses = 0;
        while messages < MAX_LAST_MESSAGES && misses < MAX_MISSES {
            match self.incoming.next().now_or_never() {
                Some(Some(Ok(message))) => {
                    (messages, misses) = (messages + 1, 0);
                    self.begin_stops_in(&message, begun);
                }
                // The stream gives others a turn now and then, although bytes have arrived.
                None => misses += 1,
                Some(_) => return,
            }
            tokio::task::yield_now().await;
        }
    }

    /// Begins the FAST STOPs and Stops in a message, and nothing else.
    fn begin_stops_in(&mut self, message: &Message, begun: &mut Begun) {
        self.incoming.get_mut().taken();
        let (Message::Text(_) | Message::Binary(_)) = message else { return };
        let payload = message.clone().into_data();
        let calls = match rpc::parse(&String::from_utf8_lossy(&payload)) {
            Incoming::One(call) => vec![call],
            Incoming::Batch(calls) => calls,
        };
        for call in calls.into_iter().flatten() {
            let RpcMethod::Operation(method) = &call.method else { continue };
            let begun = match method.urgency() {
                Urgency::FastStop => &mut begun.fast_stops,
                Urgency::Stop => &mut begun.stops,
                Urgency::Lease | Urgency::None => continue,
            };
            *begun += 1;
            if *begun <= MAX_LAST_STOPS {
                // The first poll of the call begins it.
                let _ = self.answered(Ok(call)).now_or_never();
            }
        }
    }
}
