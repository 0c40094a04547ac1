//! Ids of commands, FAST STOPs and alarms.

use std::borrow::Cow;
use std::fmt;

use jiff::Timestamp;
use rand::rngs::SmallRng;
use rand::{RngExt, SeedableRng};
use serde::{Deserialize, Serialize};
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::{KnownFormat, ObjectBuilder, Schema, SchemaFormat, Type};
use utoipa::{PartialSchema, ToSchema};
use uuid::Uuid;

macro_rules! identifiers {
    ($($(#[$doc:meta])* $name:ident)*) => {$(
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
        pub struct $name(Uuid);

        impl PartialSchema for $name {
            fn schema() -> RefOr<Schema> {
                let format = SchemaFormat::KnownFormat(KnownFormat::Uuid);
                ObjectBuilder::new().schema_type(Type::String).format(Some(format)).build().into()
            }
        }

        impl ToSchema for $name {
            fn name() -> Cow<'static, str> {
                "UuidField".into()
            }
        }

        impl $name {
            /// Generates an id. Its time comes from the wall clock, which can jump, so ids give no order.
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
    /// Id of a command, a version 7 UUID.
    #[derive(PartialOrd, Ord)]
    CommandId
    /// Id of a FAST STOP, a version 7 UUID. The epoch, not the id, gives the order of FAST STOPs.
    FastStopId
    /// Id of an occurrence of an alarm, a version 7 UUID.
    #[derive(PartialOrd, Ord)]
    AlarmId
}

/// Generator of ids from a seed and a given time: the same seed and times give the same ids.
#[derive(Debug)]
pub struct IdSource(SmallRng);

impl IdSource {
    /// `seed` should be random, except in tests.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        Self(SmallRng::seed_from_u64(seed))
    }

    /// Seed for the nonces of one link, so that they differ from those of other links.
    pub fn nonce(&mut self) -> u64 {
        self.0.random()
    }

    pub fn command_id(&mut self, at: Timestamp) -> CommandId {
        CommandId(self.uuid(at))
    }

    pub fn fast_stop_id(&mut self, at: Timestamp) -> FastStopId {
        FastStopId(self.uuid(at))
    }

    fn uuid(&mut self, at: Timestamp) -> Uuid {
        let millis = u64::try_from(at.as_millisecond()).unwrap_or_default();
        uuid::Builder::from_unix_timestamp_millis(millis, &self.0.random()).into_uuid()
    }
}
