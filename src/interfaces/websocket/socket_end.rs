//! Why a socket ended.

use tokio_tungstenite::tungstenite::Error as WsError;
use tokio_tungstenite::tungstenite::error::ProtocolError;
use tokio_tungstenite::tungstenite::protocol::frame::coding::CloseCode;

/// Why a socket ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SocketEnd {
    /// The gateway shuts down.
    Closing,
    /// The client closed the socket or vanished.
    Closed,
    /// Writing failed because the connection has ended.
    Unwritable,
    /// The client stopped answering pings.
    Lost,
    Evicted,
    /// The client violated the protocol or its limits.
    Violation(CloseCode, &'static str),
}

/// End of a socket whose client sent a message that is too long.
pub const TOO_LONG: SocketEnd = SocketEnd::Violation(CloseCode::Size, "message exceeds 64 KiB");

/// Returns the end that an error means.
pub fn end_of(error: &WsError) -> SocketEnd {
    match error {
        WsError::Capacity(_) => TOO_LONG,
        WsError::Utf8(_) => SocketEnd::Violation(CloseCode::Invalid, "text message is not valid UTF-8"),
        WsError::Protocol(ProtocolError::ResetWithoutClosingHandshake) => SocketEnd::Closed,
        WsError::Protocol(_) => SocketEnd::Violation(CloseCode::Protocol, "invalid WebSocket frame (RFC 6455)"),
        _ => SocketEnd::Closed,
    }
}
