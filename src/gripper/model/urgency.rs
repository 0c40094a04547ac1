//! What a request may wait behind.

/// The urgency of a request: what it may wait behind, and whose slots it takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Urgency {
    /// Goes before everything, and needs no slot: FAST STOP.
    FastStop,
    /// Goes before what moves and reads: operations that only stop.
    Stop,
    /// Waits for no motion: operations that keep or end a lease.
    Lease,
    /// Everything else.
    None,
}
