//! Servo sessions: a client steers the fingers by a target many times a second.

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use strum::{EnumMessage, IntoStaticStr, VariantArray};
use utoipa::ToSchema;

use settings::{FileSection, SettingValue, between, parsed, plain, settings, whole};
use wsg::{CustomCommand, Force, Speed, Width, id};

/// Most bytes of a target in a script's payload.
const MAX_LAYOUT: usize = 16;

/// Way in which a session's targets reach the fingers.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, IntoStaticStr, EnumMessage, VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum ServoAdapter {
    /// The device's own motions (21h and 22h): a few targets a second, with a stop between them.
    Moves,
    /// A script whose request has a width, a speed on arrival, two gains and two forces (25 bytes). It does not limit the
    /// speed, so the gateway sends widths on the way to the target.
    PositionPd,
    /// A script whose request has a width and a speed (9 bytes).
    WidthSpeed,
    /// A script whose request is described by `servo_layout`.
    Script,
}

impl ServoAdapter {
    /// The adapter as clients see it.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// One value in the request of a script.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(untagged)]
pub enum LayoutItem {
    Field(LayoutField),
    /// This number as a float.
    Number(f32),
}

/// A value that the gateway fills in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LayoutField {
    /// One byte that is 0.
    Zero,
    /// Target width in mm, as a float.
    WidthMm,
    /// Speed in mm/s, as a float.
    SpeedMmS,
    /// Speed in mm/s on arrival at the target, as a float. The gateway asks for rest.
    #[serde(skip)]
    ArrivalSpeed,
    /// Force in N, as a float.
    ForceN,
}

/// Request of the script of a public project: width in mm, speed on arrival in mm/s, proportional and derivative gain, and
/// the forces in N while travelling and while blocked.
const POSITION_PD: &[LayoutItem] = &[
    LayoutItem::Field(LayoutField::Zero),
    LayoutItem::Field(LayoutField::WidthMm),
    LayoutItem::Field(LayoutField::ArrivalSpeed),
    LayoutItem::Number(15.0),
    LayoutItem::Number(0.001),
    LayoutItem::Field(LayoutField::ForceN),
    LayoutItem::Field(LayoutField::ForceN),
];

const WIDTH_SPEED: &[LayoutItem] = &[
    LayoutItem::Field(LayoutField::Zero),
    LayoutItem::Field(LayoutField::WidthMm),
    LayoutItem::Field(LayoutField::SpeedMmS),
];

settings! {
    /// Steering by servo sessions.
    pub struct ServoRules {
        /// Way in which the targets of [servo sessions](steering.md) reach the fingers.
        pub adapter: ServoAdapter = "servo_adapter",
            plain(ServoAdapter::Moves, "\"moves\"", "`\"moves\"`, `\"position_pd\"`, `\"width_speed\"`, `\"script\"`"), Reload;
        /// Command id of the script that takes the targets.
        pub id: u8 = "servo_id", whole(0xB1, between(1..=254, ""), |id| id as u8).shown("`0xB1`", "0xB1"), Reload;
        /// Request of the script for the adapter `script`: fields that the gateway fills in, and numbers. All values are floats
        /// of 4 bytes, little-endian, except `zero`, which is one byte.
        pub layout: Vec<LayoutItem> = "servo_layout", layout(), Reload;
        /// Greatest difference in mm between a target of a [stream](drivers.md#steering) and the one before, or the measured
        /// width if there was none within a second. 0: any. Needs a `servo_adapter` that describes the script `servo_id`.
        pub stream_max_step_mm: u16 = "stream_max_step_mm", whole(0, between(0..=1000, ""), |mm| mm as u16), Reload;
        /// Greatest speed in mm/s that a target of a stream can have. 0: any. Needs the same.
        pub stream_max_speed_mm_s: u16 = "stream_max_speed_mm_s", whole(0, between(0..=1000, ""), |mm_s| mm_s as u16), Reload;
        check ServoRules::check;
    }
}

fn layout() -> SettingValue<Vec<LayoutItem>> {
    let range = "`\"width_mm\"`, `\"speed_mm_s\"`, `\"force_n\"`, `\"zero\"` and numbers";
    parsed(Vec::new(), "[]", range, |items: Vec<LayoutItem>| match items.len() {
        ..=MAX_LAYOUT => Ok(items),
        many => Err(format!("has {many} items; at most {MAX_LAYOUT} are allowed")),
    })
    .shown("`[]`", "[\"width_mm\", \"speed_mm_s\"]")
}

impl ServoRules {
    fn check(&self, section: &mut FileSection<'_>) {
        if CustomCommand::new(self.id, Vec::new()).is_none() {
            let id = self.id;
            let name = id::name(id).unwrap_or("no id of a command");
            section.fail("servo_id", format_args!("{id} ({id:02X}h) is {name} in the manual: use the id of a script"));
        }
        let needed = [LayoutField::WidthMm, LayoutField::SpeedMmS];
        let is_complete = needed.iter().all(|field| self.layout.contains(&LayoutItem::Field(*field)));
        if self.adapter == ServoAdapter::Script && !is_complete {
            section
                .fail("servo_layout", "servo_layout needs \"width_mm\" and \"speed_mm_s\" for the adapter \"script\"");
        }
        if self.limits_streams() && self.adapter == ServoAdapter::Moves {
            let key = if self.stream_max_step_mm > 0 { "stream_max_step_mm" } else { "stream_max_speed_mm_s" };
            let detail = format_args!(
                "{key} needs the places of width and speed in a request: set servo_adapter to that of the script"
            );
            section.fail(key, detail);
        }
    }

    fn limits_streams(&self) -> bool {
        self.stream_max_step_mm > 0 || self.stream_max_speed_mm_s > 0
    }

    /// Whether the targets of this script are limited when a client streams them.
    #[must_use]
    pub fn limits_stream_of(&self, id: u8) -> bool {
        self.limits_streams() && id == self.id
    }

    /// The target in a request of the script. `None` if the payload ends before it.
    #[must_use]
    pub fn target_in(&self, payload: &[u8]) -> Option<ScriptTarget> {
        let mut rest = payload;
        let mut width_mm = None;
        let mut speed_mm_s = None;
        for item in self.items(self.adapter) {
            if *item == LayoutItem::Field(LayoutField::Zero) {
                rest = rest.get(1..)?;
                continue;
            }
            let (bytes, after) = rest.split_first_chunk()?;
            rest = after;
            let value = f32::from_le_bytes(*bytes);
            match item {
                LayoutItem::Field(LayoutField::WidthMm) => width_mm = Some(value),
                LayoutItem::Field(LayoutField::SpeedMmS | LayoutField::ArrivalSpeed) => speed_mm_s = Some(value),
                LayoutItem::Field(_) | LayoutItem::Number(_) => {}
            }
        }
        Some(ScriptTarget { width_mm: width_mm?, speed_mm_s: speed_mm_s? })
    }

    fn items(&self, adapter: ServoAdapter) -> &[LayoutItem] {
        match adapter {
            ServoAdapter::Moves => &[],
            ServoAdapter::PositionPd => POSITION_PD,
            ServoAdapter::WidthSpeed => WIDTH_SPEED,
            ServoAdapter::Script => &self.layout,
        }
    }

    /// Whether the adapter sends a force with each target.
    #[must_use]
    pub fn sends_force(&self, adapter: ServoAdapter) -> bool {
        self.items(adapter).contains(&LayoutItem::Field(LayoutField::ForceN))
    }

    /// The request of the adapter's script for a target. Without a force, the script gets 0. `None` if `servo_id` is no
    /// id of a script, which the configuration refuses.
    #[must_use]
    pub fn request(
        &self,
        adapter: ServoAdapter,
        width: Width,
        speed: Speed,
        force: Option<Force>,
    ) -> Option<CustomCommand> {
        let mut payload = Vec::new();
        for item in self.items(adapter) {
            let value = match item {
                LayoutItem::Field(LayoutField::Zero) => {
                    payload.push(0);
                    continue;
                }
                LayoutItem::Field(LayoutField::WidthMm) => width.mm(),
                LayoutItem::Field(LayoutField::SpeedMmS) => speed.mm_s(),
                LayoutItem::Field(LayoutField::ArrivalSpeed) => 0.0,
                LayoutItem::Field(LayoutField::ForceN) => force.map_or(0.0, Force::n),
                LayoutItem::Number(number) => *number,
            };
            payload.extend(value.to_le_bytes());
        }
        CustomCommand::new(self.id, payload)
    }
}

/// Target in the request of a script, as a client sends it: any number, not only one that a gripper can take.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScriptTarget {
    pub width_mm: f32,
    pub speed_mm_s: f32,
}

/// Terms of a servo session.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoTerms {
    /// Way in which targets reach the fingers; `None` for the configured one.
    pub adapter: Option<ServoAdapter>,
    /// Silence after which the session ends with a Stop.
    pub timeout: Duration,
    /// Greatest speed of a target, and the speed of targets without one.
    pub max_speed: Speed,
    /// Force limit that the session sets first, or that its script gets.
    pub force: Option<Force>,
}

/// What the fingers are to do.
#[derive(Debug, Clone, PartialEq)]
pub enum ServoAim {
    /// One target width.
    Width(Width),
    /// Target widths, with the same time between each two. The last one stays the target.
    Widths(Arc<[Width]>, Duration),
}

/// A client's newest target.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoTarget {
    pub aim: ServoAim,
    /// Speed; that of the session if absent.
    pub speed: Option<Speed>,
    /// Time that the target belongs to, by the gateway's clock.
    pub at: Option<Timestamp>,
}

/// A request for a servo session.
#[derive(Debug, Clone, PartialEq)]
pub enum Steer {
    Start(ServoTerms),
    Aim(ServoTarget),
    Stop,
}

/// Reason for the end of a servo session.
#[derive(
    Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema, IntoStaticStr, EnumMessage, VariantArray,
)]
#[serde(rename_all = "snake_case")]
#[strum(serialize_all = "snake_case")]
pub enum ServoEnd {
    /// The client has ended it.
    Ended,
    /// No target came in time.
    Silence,
    /// A client sent a Stop.
    Stop,
    /// A FAST STOP was latched.
    FastStop,
    /// The lease was lost, released, handed over or taken.
    Lease,
    /// The device refused a target or did not answer it.
    Device,
    /// The link to the device was lost, or the gateway disconnects.
    Link,
}

impl ServoEnd {
    /// The reason as clients see it.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.into()
    }
}

/// A servo session, open or ended.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ServoReport {
    /// Whether the session is open.
    pub open: bool,
    /// Reason that the session has ended; null while it is open.
    #[schema(required)]
    pub ended: Option<ServoEnd>,
    /// Subject of the client that steers.
    pub by: Arc<str>,
    /// Way in which targets reach the fingers.
    pub adapter: ServoAdapter,
    /// Silence after which the session ends with a Stop, in ms.
    pub timeout_ms: u64,
    /// Greatest speed of a target in mm/s.
    pub max_speed_mm_s: f32,
    /// Time at which the session began.
    #[serde(serialize_with = "super::time::milliseconds")]
    pub started_at: Timestamp,
    /// Newest target width in mm; null before the first.
    #[schema(required)]
    pub target_mm: Option<f32>,
    /// Newest target width in mm that the device has answered; null before the first.
    #[schema(required)]
    pub applied_mm: Option<f32>,
    /// Time at which the device answered it, in UTC with microseconds; null before the first.
    #[serde(serialize_with = "super::time::microseconds_or_null")]
    #[schema(required)]
    pub applied_at: Option<Timestamp>,
    /// Age of that target when the device answered it, in ms; null before the first.
    #[schema(required)]
    pub applied_age_ms: Option<f64>,
    /// Targets per second that this device takes while further ones wait, measured in this session or the last one with
    /// the same adapter; null if never measured.
    #[schema(required)]
    pub rate_hz: Option<f32>,
    /// Number of accepted targets.
    pub accepted: u64,
    /// Number of accepted targets that a newer one has replaced before they were sent.
    pub superseded: u64,
    /// Number of refused targets.
    pub refused: u64,
    /// Longest time between two accepted targets, in ms.
    pub longest_gap_ms: u64,
    /// Way that the fingers have travelled, in mm.
    pub travel_mm: f64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn target_is_read_where_the_adapter_writes_it() {
        let layout = vec![
            LayoutItem::Field(LayoutField::SpeedMmS),
            LayoutItem::Number(7.0),
            LayoutItem::Field(LayoutField::Zero),
            LayoutItem::Field(LayoutField::WidthMm),
        ];
        for adapter in [ServoAdapter::PositionPd, ServoAdapter::WidthSpeed, ServoAdapter::Script] {
            let rules = ServoRules { adapter, layout: layout.clone(), ..ServoRules::default() };
            let width = Width::new(42.5).unwrap();
            let request = rules.request(adapter, width, Speed::new(80.0).unwrap(), None).unwrap();
            let speed_mm_s = if adapter == ServoAdapter::PositionPd { 0.0 } else { 80.0 };
            let target = ScriptTarget { width_mm: 42.5, speed_mm_s };
            assert_eq!(rules.target_in(request.payload()), Some(target), "{adapter:?}");
            let cut = request.payload().len() - 1;
            assert_eq!(rules.target_in(&request.payload()[..cut]), None, "{adapter:?}");
        }
    }
}
