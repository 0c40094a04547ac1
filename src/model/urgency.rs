//! Urgency of requests.

/// Urgency of a request: which requests it can wait behind, and which slots it takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Urgency {
    /// FAST STOP: goes before all other requests, and needs no slot.
    FastStop,
    /// Operations that only stop: go before motions and reads.
    Stop,
    /// Operations that keep or end a lease: wait for no motion.
    Lease,
    /// All other operations.
    None,
}
