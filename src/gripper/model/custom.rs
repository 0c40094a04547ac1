//! Meaning of custom command ids, as configured by the gripper's owner.

use std::collections::BTreeSet;

use crate::wsg::id;

/// Custom command ids with a special meaning. All other ids that the manuals don't define count as motions only if the
/// fingers move after them. Submitted as commands, they are ordinary motions with their own records.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CustomIds {
    /// Ids that only read. Every client can use them, even in FAST STOP or while another client holds the lease.
    pub read: BTreeSet<u8>,
    /// Ids that move the fingers many times a second. Lease and latch apply as for other motions. They start
    /// without a pause, and their end does not wait for fresh values. The journal counts them instead of listing each
    /// one.
    pub stream: BTreeSet<u8>,
}

impl CustomIds {
    /// Name of an id that the manual defines. Such an id can't be declared custom.
    #[must_use]
    pub fn name_in_manual(id: u8) -> Option<&'static str> {
        id::name(id)
    }
}
