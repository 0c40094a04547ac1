//! Rules of a gripper that its owner configures.

use std::time::Duration;

use super::{CustomIds, LeaseRules, OnJournalFailure, ServoRules, UpdateRules};
use settings::{between, flag, plain, settings, up_to, whole};

settings! {
    /// Behaviour of a gripper.
    pub struct GripperRules {
        /// State of the setting "FAST STOP on TCP disconnect" on the gripper's web page. The gateway cannot read it.
        pub fast_stop_on_disconnect: bool = "fast_stop_on_disconnect", flag(true), Reload;
        /// Pause between the end of a motion and the next one.
        pub motion_pause: Duration = "motion_pause_ms", whole(50, between(0..=1000, ""), Duration::from_millis), Reload;
        group updates: UpdateRules;
        group custom_ids: CustomIds;
        group servo: ServoRules;
        group lease: LeaseRules;
        // Rules that the configuration has once for all grippers.
        also shared: SharedRules = SharedRules::default();
    }
}

settings! {
    /// Rules of all grippers.
    #[derive(Eq)]
    pub struct SharedRules {
        /// Time allowed for a running motion to finish when the gateway
        /// [shuts down](operation.md#shutdown-and-restart), in ms.
        pub drain: Duration = "drain_ms", whole(2000, up_to(60_000), Duration::from_millis), Reload;
        /// What happens to motions while the journal cannot be written.
        pub on_journal_failure: OnJournalFailure = "on_journal_failure",
            plain(OnJournalFailure::Refuse, "\"refuse\"", "`\"refuse\"`, `\"continue\"`"), Reload;
    }
}
