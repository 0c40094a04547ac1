//! Events of the gateway itself.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::super::CommandId;

/// An event of the gateway itself.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum GatewayEvent {
    /// The gateway has started.
    Started {
        /// Version of the gateway.
        version: &'static str,
        /// Name of the gateway.
        gateway: String,
    },
    /// The gateway's configuration.
    Configuration {
        /// Address of the HTTP server.
        listen: String,
        /// Grippers, each as `name=URL`.
        grippers: Vec<String>,
    },
    /// A new configuration is in use.
    Reloaded {
        /// The changes, in words.
        changes: Vec<String>,
    },
    /// The previous run of the gateway did not shut down cleanly.
    UncleanEnd {
        /// Ids of the commands that were running; each gets the outcome `UNKNOWN`.
        running: Vec<CommandId>,
    },
    /// The gateway has shut down cleanly.
    Ended,
    /// Records were lost because the disk did not accept them and the buffer was full.
    RecordsLost {
        /// Number of lost records.
        count: u64,
    },
    /// Old records were removed.
    Pruned {
        /// Sequence number of the newest removed event; 0 if none was removed yet.
        up_to_seq: i64,
        /// Hash of that event, as hex. The remaining events continue from it.
        hash: String,
        /// Sequence number of the newest removed grip record; 0 if none was removed yet.
        grips_up_to_seq: i64,
        /// Hash of that grip record, as hex.
        grips_hash: String,
    },
    /// Old records were removed, except these events, which have a share of the journal's file.
    Kept {
        /// The shares that have or had events.
        #[schema(max_items = 2)]
        shares: Vec<KeptShare>,
    },
    /// Newest records of both chains, for comparison with a copy of this event that the journal's file does not hold.
    Head {
        /// Sequence number of the newest event before this one.
        up_to_seq: i64,
        /// Hash of that event, as hex.
        hash: String,
        /// Sequence number of the newest grip record; 0 if there is none.
        grips_up_to_seq: i64,
        /// Hash of that grip record, as hex.
        grips_hash: String,
    },
    /// The gateway began to use another journal than in its last run: a restored copy, or a new file. Lease epochs
    /// continue above all earlier ones.
    Restored {
        /// What showed it.
        cause: String,
    },
}

/// Events that stay in the journal when others are removed for its size.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct KeptShare {
    /// Name of the share: `fast_stops` or `access`.
    pub share: String,
    /// Sequence number of the newest event that was removed from the share; 0 if none was.
    pub from_seq: i64,
    /// Link of that event, as hex. The first event of the share continues from it.
    pub from_hash: String,
    /// Sequence number of the newest event in the share.
    pub up_to_seq: i64,
    /// Link of that event, as hex: it covers all links of the share before it.
    pub hash: String,
}
