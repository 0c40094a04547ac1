//! Connections of clients: accepted by one rule, admitted within bounds, encrypted, and served on the right runtime.
//!
//! All interfaces use this room. It knows clients by their addresses and certificates, and nothing of their requests.

pub(crate) mod accept;
pub(crate) mod admission;
pub(crate) mod client_stream;
pub mod foreign;
pub(crate) mod handshakes;
pub mod metrics;
pub mod networks;
pub(crate) mod pace;
pub mod peers;
pub(crate) mod quick_ack;
pub(crate) mod runtimes;
pub mod self_signed;
pub mod sockets;
pub mod tls;

pub use accept::listen;
pub use admission::Bounds;
pub use runtimes::Runtimes;
