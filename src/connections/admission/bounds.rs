//! Classes of connections and their bounds.

/// Activity of a connection, which decides its claim to a slot. Later classes take precedence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Class {
    /// A new connection, or one whose request is incomplete.
    Incoming,
    /// A connection between two requests, or whose response is being sent.
    Idle,
    /// A complete request is being answered.
    Answering,
    /// A FAST STOP is in progress. It completes even if its connection ends.
    Urgent,
    /// A request waits for the end of a command (`wait_ms`).
    Waiting,
    /// A WebSocket, or a stream of server-sent events.
    Streaming,
    /// The client holds a lease that ends with its connection.
    Pinned,
}

pub(super) const CLASSES: usize = 7;

/// Response to one more connection in a class that is full.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum WhenFull {
    /// The oldest connection of the peer with the most connections gives way.
    Evict,
    /// As `Evict`, if that peer has at least two connections more than the newcomer's peer; else the newcomer is
    /// refused.
    Share,
    /// The newcomer is refused. A peer that has three quarters of the class is refused even before the class is full.
    Refuse,
}

impl Class {
    pub(super) fn when_full(self) -> WhenFull {
        match self {
            Self::Incoming | Self::Idle | Self::Urgent => WhenFull::Evict,
            Self::Waiting | Self::Streaming => WhenFull::Share,
            Self::Answering | Self::Pinned => WhenFull::Refuse,
        }
    }
}

/// Maximum numbers of connections and bytes of a listener's clients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// Maximum number of connections of each class.
    pub(super) classes: [usize; CLASSES],
    /// Maximum number of evicted connections that are still ending.
    pub(super) leaving: usize,
    /// Connections that are inspected while too many others are leaving.
    pub(super) reserved: usize,
    /// Connections that were evicted before their first byte, or found no room, and get a moment to send a FAST STOP.
    pub(super) displaced: usize,
    /// Bytes held for all clients together.
    pub held_bytes: usize,
}

/// Bytes held for all clients together: 64 KiB, the largest valid message, for each of a thousand clients.
const HELD_BYTES: usize = 64 << 20;

/// Incoming connections: enough that a flood of 10,000 connects a second leaves each of them 90 ms to send its request.
const INCOMING: usize = 896;
/// Keep-alive connections: a PLC or a browser has a few. Soon after the end of a motion, all long polls for it are idle,
/// too: those that waited, and those that were answered early and counted as incoming until they asked again.
const IDLE: usize = INCOMING + WAITING + 128;
/// Requests being answered, each within milliseconds unless a device or a disk is slow.
const ANSWERING: usize = 256;
/// FAST STOPs in progress: each takes 250 ms at most.
const URGENT: usize = 128;
/// Long polls: each gripper has one motion, and few clients wait for it.
const WAITING: usize = 256;
/// WebSockets and event streams: a thousand observers.
const STREAMING: usize = 1024;
/// Evicted connections that still deliver a response.
const LEAVING: usize = 128;
/// Connections that are inspected while too many others are leaving. Only those that begin with a FAST STOP are then
/// admitted.
const RESERVED: usize = 64;
/// Connections that were evicted before their first byte, or found no room, and may still bring a FAST STOP. The newest
/// wins: enough that a flood of 10,000 connects a second leaves each of them 12 ms to send it. A third are those that have
/// given way and not ended yet.
const DISPLACED: usize = 192;

/// Lease holders. A gripper has one; the others have lost theirs within the last second.
const PINNED: usize = 16;

/// Descriptors of a stream: a WebSocket's reader and writer have one each.
const STREAMING_DESCRIPTORS: usize = 2;

impl Bounds {
    /// Returns the maximum number of pinned connections: a quarter of the streams, since most pinned ones are streams.
    pub(super) fn pinned(&self) -> usize {
        (self.of_class(Class::Streaming) / 4).clamp(1, PINNED)
    }

    /// Maximum number of descriptors that a listener's connections use, including those that are still ending.
    pub const MAX_DESCRIPTORS: usize = INCOMING
        + IDLE
        + ANSWERING
        + URGENT
        + WAITING
        + STREAMING * STREAMING_DESCRIPTORS
        + LEAVING
        + RESERVED
        + DISPLACED;

    /// Minimum number of descriptors: a slot of each class and for evicted connections, and a second one for new and for
    /// keep-alive connections, so that a FAST STOP and a cyclic program do not displace each other.
    pub const MIN_DESCRIPTORS: usize = 11;

    /// Distributes this many descriptors among the classes, at least [`Bounds::MIN_DESCRIPTORS`] and at most
    /// [`Bounds::MAX_DESCRIPTORS`].
    #[must_use]
    pub fn of(descriptors: usize) -> Self {
        let descriptors = descriptors.clamp(Self::MIN_DESCRIPTORS, Self::MAX_DESCRIPTORS);
        let given = descriptors - Self::MIN_DESCRIPTORS;
        let mut classes = [usize::MAX; CLASSES];
        for (class, least, most) in [
            (Class::Incoming, 2, INCOMING),
            (Class::Idle, 2, IDLE),
            (Class::Answering, 1, ANSWERING),
            (Class::Urgent, 1, URGENT),
            (Class::Waiting, 1, WAITING),
            (Class::Streaming, 1, STREAMING),
        ] {
            classes[class as usize] = share(given, least, most);
        }
        let leaving = share(given, 1, LEAVING);
        let displaced = share(given, 1, DISPLACED);
        // Rounded up: the other shares are rounded down, which leaves a descriptor for it.
        let reserved = (RESERVED * given).div_ceil(MAX_GIVEN);
        // New and keep-alive connections share the remainder.
        let bounded: usize = classes.iter().filter(|most| **most < usize::MAX).sum();
        let of_streams = classes[Class::Streaming as usize] * (STREAMING_DESCRIPTORS - 1);
        let rest = descriptors.saturating_sub(bounded + of_streams + leaving + reserved + displaced);
        classes[Class::Incoming as usize] += rest.div_ceil(2);
        classes[Class::Idle as usize] += rest / 2;
        Self { classes, leaving, reserved, displaced, held_bytes: HELD_BYTES }
    }

    /// Maximum number of descriptors of a listener whose clients are all alike: for 512 clients, since a proxy or a faulty
    /// program can open some hundreds, besides those that have just connected or are ending.
    pub const MAX_ALIKE: usize = 1024;

    /// Minimum number of descriptors of such a listener.
    pub const MIN_ALIKE: usize = 4;

    /// Returns the bounds of a listener whose clients are all alike. Half of the descriptors are for clients that have
    /// sent something, a quarter for silent ones, an eighth for evicted ones, and an eighth for connections that are only
    /// inspected, because too many others are leaving.
    #[must_use]
    pub fn alike(descriptors: usize) -> Self {
        let descriptors = descriptors.clamp(Self::MIN_ALIKE, Self::MAX_ALIKE);
        let mut classes = [usize::MAX; CLASSES];
        classes[Class::Incoming as usize] = (descriptors / 4).max(1);
        classes[Class::Idle as usize] = (descriptors / 2).max(1);
        let leaving = (descriptors / 8).max(1);
        let inspected = descriptors / 16;
        Self { classes, leaving, reserved: inspected, displaced: inspected, held_bytes: HELD_BYTES }
    }

    /// Returns bounds with one slot of each class, and none for connections that were evicted before their first byte.
    #[cfg(test)]
    #[must_use]
    pub fn narrow() -> Self {
        let mut classes = [1; CLASSES];
        classes[Class::Pinned as usize] = usize::MAX;
        Self { classes, leaving: 1, reserved: 1, displaced: 0, held_bytes: HELD_BYTES }
    }

    #[cfg(test)]
    #[must_use]
    pub fn with(mut self, class: Class, most: usize) -> Self {
        self.classes[class as usize] = most;
        self
    }

    #[must_use]
    pub fn of_class(&self, class: Class) -> usize {
        self.classes[class as usize]
    }
}

/// Maximum number of descriptors beyond [`Bounds::MIN_DESCRIPTORS`].
const MAX_GIVEN: usize = Bounds::MAX_DESCRIPTORS - Bounds::MIN_DESCRIPTORS;

/// Returns a number between `least` and `most`, in proportion to the descriptors that are given beyond the minimum.
fn share(given: usize, least: usize, most: usize) -> usize {
    least + (most - least) * given / MAX_GIVEN
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_use_all_descriptors() {
        for descriptors in Bounds::MIN_DESCRIPTORS..=Bounds::MAX_DESCRIPTORS {
            let bounds = Bounds::of(descriptors);
            let classes = bounds.classes.iter().filter(|most| **most < usize::MAX).sum::<usize>();
            let used =
                classes + bounds.of_class(Class::Streaming) + bounds.leaving + bounds.reserved + bounds.displaced;
            assert_eq!(used, descriptors, "{bounds:?}");
            assert!(bounds.classes.iter().all(|most| *most > 0) && bounds.displaced > 0, "{bounds:?}");
            assert!(bounds.of_class(Class::Idle) > 1 && bounds.of_class(Class::Incoming) > 1, "{bounds:?}");
        }
        assert_eq!(Bounds::of(usize::MAX).of_class(Class::Streaming), STREAMING);
    }
}
