//! The runtimes that clients are served on, apart from each other so that no kind of traffic delays a FAST STOP.

use tokio::runtime::Handle;

/// The runtime of each kind of work for clients. The devices have a runtime of their own, which is not among them.
#[derive(Debug, Clone)]
pub struct Runtimes {
    /// Accepts HTTP connections, looks at their first bytes, and serves those that begin with a FAST STOP.
    pub accept: Handle,
    /// Serves all other HTTP requests.
    pub requests: Handle,
    /// Reads WebSockets, whose next request may be a FAST STOP.
    pub sockets: Handle,
    /// Writes updates to observers. Its thread yields to all others.
    pub observers: Handle,
}

impl Runtimes {
    /// All on the runtime of the caller.
    #[cfg(test)]
    #[must_use]
    pub fn current() -> Self {
        let [accept, requests, sockets, observers] = std::array::from_fn(|_| Handle::current());
        Self { accept, requests, sockets, observers }
    }
}
