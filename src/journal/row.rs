//! Records, as they are stored and served.

use std::sync::Arc;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, VariantArray};
use utoipa::ToSchema;

use super::chain::{Chain, Tip};
use super::curve;
use crate::model::{CommandId, Detail, DeviceEvent, Event, GripRecord, Name, Outcome, PartId};

/// Kind of an event.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, EnumMessage, VariantArray)]
#[serde(rename_all = "snake_case")]
pub enum EventKind {
    /// A command was admitted or ended.
    Command,
    /// A FAST STOP was latched or confirmed.
    FastStop,
    /// A FAST STOP was acknowledged, or the acknowledgement failed.
    Acknowledge,
    /// A lease was requested, taken, handed over, released or lost.
    Lease,
    /// The connection state of the device link changed.
    Link,
    /// The device restarted, was replaced, reported a fault, lost a part or moved by itself.
    Device,
    /// A client changed a setting, or the gateway restored one.
    Settings,
    /// A request was refused.
    Refused,
    /// The gateway started or ended, or its journal lost or removed records.
    Gateway,
    /// An alarm was raised, ended or was acknowledged.
    Alarm,
    /// A recipe was set or removed.
    Recipe,
}

/// A durable event, with the values that filters compare.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Stored {
    /// Sequence number, from 1.
    pub seq: i64,
    pub kind: EventKind,
    /// Gripper of the event; absent if it concerns all.
    pub gripper: Option<Name>,
    pub command_id: Option<CommandId>,
    pub part_id: Option<PartId>,
    /// Outcome of the event's command, once that has ended.
    pub outcome: Option<Outcome>,
    /// The event as JSON, as it is served.
    #[serde(skip)]
    pub body: Arc<str>,
}

impl Stored {
    /// Parses an event's body.
    pub(super) fn of(body: Arc<str>) -> serde_json::Result<Self> {
        let stored: Self = serde_json::from_str(&body)?;
        Ok(Self { body, ..stored })
    }
}

/// A durable grip record, new or changed.
#[derive(Debug, Clone, PartialEq)]
pub struct GripUpdate {
    /// Sequence number of the record, from 1.
    pub seq: i64,
    pub gripper: Name,
    /// The record as JSON, as it is served.
    pub body: Arc<str>,
}

impl GripUpdate {
    /// Parses a record's body.
    pub(super) fn of(body: Arc<str>) -> serde_json::Result<Self> {
        #[derive(Deserialize)]
        struct Parts {
            seq: i64,
            gripper: Name,
        }
        let Parts { seq, gripper } = serde_json::from_str(&body)?;
        Ok(Self { seq, gripper, body })
    }
}

/// A record with its place in its chain.
#[derive(Debug, Clone)]
pub(super) struct Row {
    pub(super) chain: Chain,
    pub(super) tip: Tip,
    /// Time in ms since 1970.
    pub(super) at: i64,
    pub(super) body: Arc<str>,
    pub(super) curve: Option<Vec<u8>>,
    /// The event; absent for grip records.
    pub(super) event: Option<Arc<Stored>>,
    /// Command whose grip record is new or has changed.
    pub(super) grip: Option<CommandId>,
}

#[derive(Serialize)]
struct Numbered<'a, T> {
    seq: i64,
    #[serde(flatten)]
    record: &'a T,
}

impl Row {
    /// Makes the row of an event that follows this end of its chain.
    pub(super) fn event(end: Tip, event: &Event) -> serde_json::Result<Self> {
        let body: Arc<str> = serde_json::to_string(&Numbered { seq: end.seq + 1, record: event })?.into();
        let stored = Stored::of(body.clone())?;
        let is_lost = matches!(event.detail, Detail::Device(DeviceEvent::PartLost { .. }));
        Ok(Self {
            chain: Chain::Events,
            tip: end.next(body.as_bytes(), &[]),
            at: milliseconds(event.at),
            body,
            curve: None,
            event: Some(Arc::new(stored)),
            grip: event.command_id.filter(|_| is_lost),
        })
    }

    /// Returns the size of body and curve.
    pub(super) fn bytes(&self) -> u64 {
        (self.body.len() + self.curve.as_ref().map_or(0, Vec::len)) as u64
    }

    /// Makes the row of a grip record that follows this end of its chain.
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
            grip: Some(grip.id),
        })
    }
}

/// Converts a time to whole ms since 1970, rounded up, so that comparisons with a limit hold in ms too.
pub(super) fn milliseconds(at: Timestamp) -> i64 {
    let whole = at.as_millisecond();
    whole + i64::from(at.as_nanosecond() > i128::from(whole) * 1_000_000)
}

/// Returns the current time in whole milliseconds, the resolution of all records.
pub(super) fn now() -> Timestamp {
    let now = Timestamp::now();
    Timestamp::from_millisecond(now.as_millisecond()).unwrap_or(now)
}

/// Returns the name of a value in JSON.
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
    fn times_are_rounded_up_to_whole_milliseconds() {
        let at = |text: &str| milliseconds(text.parse().unwrap());
        assert_eq!(at("1970-01-01T00:00:00.001Z"), 1);
        assert_eq!(at("1970-01-01T00:00:00.0010001Z"), 2);
        assert_eq!(at("1969-12-31T23:59:59.9985Z"), -1);
        assert_eq!(at("1969-12-31T23:59:59.999Z"), -1);
    }
}
