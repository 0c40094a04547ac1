//! What the ids of the scripts on a gripper mean. Nobody but the gripper's owner knows.

use std::collections::BTreeSet;

use crate::wsg::id;

/// The ids that are no ordinary motions. All others that the manuals don't know count as motions: one at a time, each a
/// command with its records.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct CustomIds {
    /// They only read: whoever asks is answered, also while somebody else holds the lease, and in FAST STOP.
    pub read: BTreeSet<u8>,
    /// They move, many times a second: held to lease and latch as other motions are, but without the pause before them,
    /// without waiting for values of after them, and counted in the journal rather than written down one by one.
    pub stream: BTreeSet<u8>,
}

impl CustomIds {
    /// Name of an id that the manual knows. What such an id does is known, so it can't be declared custom.
    #[must_use]
    pub fn name_in_manual(id: u8) -> Option<&'static str> {
        id::name(id)
    }
}
