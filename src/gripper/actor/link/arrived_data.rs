//! Counts of the data that arrived on a link whose device does not answer as a gripper: they show what is wrong.

use std::fmt;

use wsg::session::Session;

/// Counts of a link's bytes and frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Arrived {
    bytes: u64,
    frames: u64,
    checksum_errors: u64,
    /// The gateway's own frames that came back.
    echoes: u64,
    invalid_replies: u64,
}

impl Arrived {
    pub(in crate::actor) fn at(session: &Session) -> Self {
        let received = session.decoder_counters();
        let counters = session.counters();
        Self {
            bytes: received.bytes,
            frames: received.frames,
            checksum_errors: received.checksum_errors,
            echoes: counters.echoes,
            invalid_replies: counters.invalid_replies,
        }
    }
}

impl fmt::Display for Arrived {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bytes, frames, checksum_errors, echoes, invalid_replies } = *self;
        if bytes == 0 {
            f.write_str("nothing arrived")
        } else if echoes > 0 {
            write!(
                f,
                "the line returned {echoes} of the gateway's own frames (a local echo, or a plug that loops back)"
            )
        } else if frames == 0 && checksum_errors > 0 {
            write!(f, "frames with a wrong checksum: {checksum_errors} (a disturbed line, or another bit rate)")
        } else if frames == 0 {
            write!(f, "{bytes} bytes arrived that form no frame (noise, another bit rate, or another kind of device)")
        } else if invalid_replies > 0 {
            write!(f, "replies with another length or impossible values: {invalid_replies}")
        } else {
            write!(f, "no reply to this request arrived, but other valid frames: {frames}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cause_says_what_arrived() {
        let nothing = Arrived::default();
        let noise = Arrived { bytes: 40, ..nothing };
        let damaged = Arrived { checksum_errors: 3, ..noise };
        let echo = Arrived { echoes: 2, frames: 2, ..noise };
        let longer = Arrived { invalid_replies: 1, frames: 1, ..noise };
        for (arrived, expected) in [
            (nothing, "nothing arrived"),
            (noise, "40 bytes arrived that form no frame"),
            (damaged, "frames with a wrong checksum: 3 ("),
            (echo, "the line returned 2 of the gateway's own frames"),
            (longer, "replies with another length or impossible values: 1"),
            (Arrived { invalid_replies: 0, ..longer }, "no reply to this request arrived, but other valid frames: 1"),
        ] {
            assert!(arrived.to_string().starts_with(expected), "{arrived}");
        }
    }
}
