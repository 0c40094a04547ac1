//! The runtimes that serve clients, separate so that no kind of traffic delays a FAST STOP.

use tokio::runtime::Handle;

/// The runtime of each kind of work for clients. The devices have a separate runtime, which is not listed here.
#[derive(Debug, Clone)]
pub struct Runtimes {
    /// Accepts HTTP connections, inspects their first bytes, and serves those that begin with a FAST STOP.
    pub accept: Handle,
    /// Serves all other HTTP requests.
    pub requests: Handle,
    /// Reads WebSockets, whose next request can be a FAST STOP.
    pub sockets: Handle,
    /// Writes updates to observers. Its thread yields to all others.
    pub observers: Handle,
    /// Publishes to Zenoh, whose calls can block on a client that reads nothing.
    pub publications: Handle,
}

impl Runtimes {
    /// Returns the caller's runtime for all kinds of work.
    #[cfg(test)]
    #[must_use]
    pub fn current() -> Self {
        let [accept, requests, sockets, observers, publications] = std::array::from_fn(|_| Handle::current());
        Self { accept, requests, sockets, observers, publications }
    }
}
