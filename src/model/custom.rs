//! Meaning of custom command ids, as configured by the gripper's owner.

use std::collections::BTreeSet;
use std::time::Duration;

use settings::{FileSection, SettingValue, between, parsed, settings, whole};
use wsg::id;

settings! {
    /// Custom command ids with a special meaning. All other ids that the manuals don't define count as motions only if the
    /// fingers move after them. Submitted as commands, they are ordinary motions with their own records.
    #[derive(Eq)]
    pub struct CustomIds {
        /// Scripts on the gripper that only read. They need no lease, and also work during a FAST STOP.
        pub read: BTreeSet<u8> = "read_ids", script_ids("command ids that the manual does not define", "[0xB0]"), Reload;
        /// Scripts that control the fingers many times per second: see [Scripts](drivers.md#scripts-on-the-gripper).
        // Lease and latch apply as for other motions. They start without a pause, and their end does not wait for fresh
        // values. The journal counts them instead of listing each one.
        pub stream: BTreeSet<u8> = "stream_ids", script_ids("the same, except those in `read_ids`", "[0xB1]"), Reload;
        /// Silence after which a stream of `stream_ids` ends while the fingers move: the gateway then sends a Stop. 0: it sends
        /// none. See [Steering](drivers.md#steering).
        pub stream_timeout: Duration = "stream_timeout_ms",
            whole(500, between(0..=10_000, ""), Duration::from_millis), Reload;
        check CustomIds::check;
    }
}

/// Ids of scripts on the gripper. The effect of the manual's ids is known, so they cannot be declared.
fn script_ids(range: &str, example: &str) -> SettingValue<BTreeSet<u8>> {
    parsed(BTreeSet::new(), "[]", range, check_scripts).shown("`[]`", example)
}

fn check_scripts(ids: BTreeSet<u8>) -> Result<BTreeSet<u8>, String> {
    match ids.iter().find_map(|&id| Some((id, id::name(id)?))) {
        None => Ok(ids),
        Some((id, name)) => {
            Err(format!("contains {id} ({id:02X}h), which is {name} in the manual: list only ids of scripts"))
        }
    }
}

impl CustomIds {
    fn check(&self, section: &mut FileSection<'_>) {
        if let Some(both) = self.stream.intersection(&self.read).next() {
            let detail = format_args!("{both} is in read_ids and stream_ids: keep it in one of them");
            section.fail("stream_ids", detail);
        }
    }
}
