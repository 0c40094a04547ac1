//! What names a command and a FAST STOP.

use std::fmt;

use jiff::Timestamp;
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use serde::{Deserialize, Serialize};
use uuid::Uuid;

macro_rules! identifiers {
    ($($(#[$doc:meta])* $name:ident)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub struct $name(Uuid);

        impl $name {
            /// A new one. Its time is the wall clock's, which may jump: no order comes from it.
            #[must_use]
            pub fn generate() -> Self {
                Self(Uuid::now_v7())
            }
        }

        impl std::str::FromStr for $name {
            type Err = uuid::Error;

            fn from_str(text: &str) -> Result<Self, uuid::Error> {
                text.parse().map(Self)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)
            }
        }
    )*};
}

identifiers! {
    /// A command's id, a UUID of version 7.
    #[derive(PartialOrd, Ord)]
    CommandId
    /// A FAST STOP's id, a UUID of version 7. Which of two is later is told by their epochs.
    FastStopId
}

/// Makes ids without a clock or chance of its own, so that the same seed gives the same ids.
#[derive(Debug)]
pub struct IdSource(SmallRng);

impl IdSource {
    /// From a seed, which should be random but in tests.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(SmallRng::seed_from_u64(seed))
    }

    /// What makes the nonces of one link differ from those of another.
    pub fn nonce(&mut self) -> u64 {
        self.0.random()
    }

    /// A command's id, of this time.
    pub fn command_id(&mut self, at: Timestamp) -> CommandId {
        CommandId(self.uuid(at))
    }

    /// A FAST STOP's id, of this time.
    pub fn fast_stop_id(&mut self, at: Timestamp) -> FastStopId {
        FastStopId(self.uuid(at))
    }

    fn uuid(&mut self, at: Timestamp) -> Uuid {
        let millis = u64::try_from(at.as_millisecond()).unwrap_or_default();
        uuid::Builder::from_unix_timestamp_millis(millis, &self.0.random()).into_uuid()
    }
}
