//! One record, as it is stored and served.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::chain::{Chain, Tip};
use super::curve;
use crate::gripper::model::{CommandId, Event, GripRecord, Name, Outcome, PartId};

/// What an event is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A command was admitted, or has ended.
    Command,
    /// A FAST STOP was latched or confirmed.
    FastStop,
    /// A FAST STOP was acknowledged, or could not be.
    Acknowledge,
    /// A lease was taken, released or lost.
    Lease,
    /// The link has changed.
    Link,
    /// The device has said or lost something.
    Device,
    /// A setting was made.
    Settings,
    /// A request was refused.
    Refused,
    /// The gateway itself.
    Gateway,
}

/// An event that is durable, and what it can be told apart by.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Stored {
    /// Its place in the order of events, from 1.
    pub seq: i64,
    /// What it is about.
    pub kind: EventKind,
    /// Its gripper; none where it concerns all.
    pub gripper: Option<Name>,
    /// Its command.
    pub command_id: Option<CommandId>,
    /// Its part.
    pub part_id: Option<PartId>,
    /// How its command has ended.
    pub outcome: Option<Outcome>,
    /// The event as JSON, as it is served.
    #[serde(skip)]
    pub body: Arc<str>,
}

impl Stored {
    /// Of an event's body.
    pub(super) fn of(body: Arc<str>) -> serde_json::Result<Self> {
        let stored: Self = serde_json::from_str(&body)?;
        Ok(Self { body, ..stored })
    }
}

/// A record with its place in its chain.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub(super) chain: Chain,
    pub(super) tip: Tip,
    /// In ms since 1970.
    pub(super) at: i64,
    pub(super) body: Arc<str>,
    pub(super) curve: Option<Vec<u8>>,
    /// What it is as an event.
    pub(super) event: Option<Arc<Stored>>,
}

#[derive(Serialize)]
struct Numbered<'a, T> {
    seq: i64,
    #[serde(flatten)]
    record: &'a T,
}

impl Row {
    /// The event that comes behind this end of its chain.
    pub(super) fn event(end: Tip, event: &Event) -> serde_json::Result<Self> {
        let body: Arc<str> = serde_json::to_string(&Numbered { seq: end.seq + 1, record: event })?.into();
        let stored = Stored::of(body.clone())?;
        Ok(Self {
            chain: Chain::Events,
            tip: end.next(body.as_bytes(), &[]),
            at: milliseconds(event.at),
            body,
            curve: None,
            event: Some(Arc::new(stored)),
        })
    }

    /// How long it is.
    pub(super) fn bytes(&self) -> u64 {
        (self.body.len() + self.curve.as_ref().map_or(0, Vec::len)) as u64
    }

    /// The grip record that comes behind this end of its chain.
    pub(super) fn grip(end: Tip, grip: &GripRecord) -> serde_json::Result<Self> {
        let body: Arc<str> = serde_json::to_string(&Numbered { seq: end.seq + 1, record: grip })?.into();
        let curve = curve::encode(&grip.curve);
        Ok(Self {
            chain: Chain::Grips,
            tip: end.next(body.as_bytes(), &curve),
            at: milliseconds(grip.started_at),
            body,
            curve: Some(curve),
            event: None,
        })
    }
}

/// As `at` is stored: whole ms since 1970, rounded up, so that what is before a limit is so in ms too.
pub(super) fn milliseconds(at: Timestamp) -> i64 {
    let whole = at.as_millisecond();
    whole + i64::from(at.as_nanosecond() > i128::from(whole) * 1_000_000)
}

/// Now, in whole milliseconds, as all records have it.
pub(super) fn now() -> Timestamp {
    let now = Timestamp::now();
    Timestamp::from_millisecond(now.as_millisecond()).unwrap_or(now)
}

/// A value by its name in JSON.
pub(super) fn word(value: &impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        other => other.map(|value| value.to_string()).unwrap_or_default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_is_rounded_up_to_whole_milliseconds() {
        let at = |text: &str| milliseconds(text.parse().unwrap());
        assert_eq!(at("1970-01-01T00:00:00.001Z"), 1);
        assert_eq!(at("1970-01-01T00:00:00.0010001Z"), 2);
        assert_eq!(at("1969-12-31T23:59:59.9985Z"), -1);
        assert_eq!(at("1969-12-31T23:59:59.999Z"), -1);
    }
}
