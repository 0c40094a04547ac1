//! Changes of the device or its link that repeat quickly. The first few of each kind are recorded at once, and further
//! ones are counted per second, so that a flickering device does not fill the disk. FAST STOPs and events of commands
//! are always recorded.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

use super::Recording;
use crate::Now;
use model::{Detail, DeviceEvent, Event};

/// Time for which changes are counted before they are recorded.
const COUNTED_FOR: Duration = Duration::from_secs(1);

/// Changes of one kind that are recorded at once. A restart or a reconnection has fewer.
const MAX_IMMEDIATE: u64 = 4;

/// Kinds distinguished. All further kinds are counted together, and the newest of them is recorded.
const MAX_KINDS: usize = 16;

/// Changes within the current second.
#[derive(Debug, Default)]
pub(in crate::actor) struct Flicker {
    /// Kinds in the order of their last change.
    kinds: Vec<ChangeKind>,
    until: Option<Instant>,
}

#[derive(Debug)]
struct ChangeKind {
    name: String,
    written: u64,
    /// The newest unrecorded change. `left_out` counts those before it.
    newest: Option<Event>,
    left_out: u64,
}

impl Flicker {
    /// Takes a change. Returns it if it has to be recorded now; otherwise it is counted.
    fn take(&mut self, now: Instant, name: String, event: Event) -> Option<Event> {
        self.until.get_or_insert(now + COUNTED_FOR);
        let found = self.kinds.iter().position(|kind| kind.name == name);
        let name = if found.is_none() && self.kinds.len() >= MAX_KINDS { "others".to_owned() } else { name };
        let found = found.or_else(|| self.kinds.iter().position(|kind| kind.name == name));
        let mut kind = match found {
            Some(index) => self.kinds.remove(index),
            None => ChangeKind { name, written: 0, newest: None, left_out: 0 },
        };
        let prompt = if kind.written < MAX_IMMEDIATE {
            kind.written += 1;
            Some(event)
        } else {
            kind.left_out += u64::from(kind.newest.replace(event).is_some());
            None
        };
        self.kinds.push(kind);
        prompt
    }

    /// Ends the second. Returns the changes left out and the newest of each kind, to be recorded. A kind that was quiet
    /// for a second starts over.
    fn end(&mut self, now: Instant) -> (Option<DeviceEvent>, Vec<Event>) {
        let mut names = BTreeSet::new();
        let mut count = 0;
        for kind in self.kinds.iter().filter(|kind| kind.left_out > 0) {
            names.insert(kind.name.as_str());
            count += kind.left_out;
        }
        let cause = names.into_iter().collect::<Vec<_>>().join(", ");
        self.kinds.retain(|kind| kind.newest.is_some());
        for kind in &mut self.kinds {
            kind.left_out = 0;
        }
        let newest = self.kinds.iter_mut().filter_map(|kind| kind.newest.take()).collect();
        self.until = (!self.kinds.is_empty()).then_some(now + COUNTED_FOR);
        ((count > 0).then_some(DeviceEvent::Flickering { cause, count }), newest)
    }

    pub(in crate::actor) fn next_timeout(&self) -> Option<Instant> {
        self.until
    }
}

impl Recording {
    /// Records a change of the device or its link, now or with the counted ones. Returns whether it was recorded now.
    pub(in crate::actor) fn change_of_device(&mut self, now: Now, event: Event) -> bool {
        let kind = kind_of(&event).filter(|_| event.command_id.is_none());
        let event = match kind {
            Some(kind) => self.flicker.take(now.instant, kind, event),
            None => Some(event),
        };
        let Some(event) = event else { return false };
        self.record(event);
        true
    }

    /// Records the counted changes.
    pub(in crate::actor) fn record_flicker(&mut self, now: Now) {
        let (left_out, newest) = self.flicker.end(now.instant);
        if !newest.is_empty() {
            let changes: Vec<_> = newest.iter().filter_map(kind_of).collect();
            tracing::warn!(gripper = %self.gripper, ?changes, "changes repeat quickly: the journal counts them");
        }
        let left_out = left_out.map(|event| self.event(now, Detail::Device(event)));
        for event in left_out.into_iter().chain(newest) {
            self.record(event);
        }
    }
}

/// Kind of an event that can repeat quickly; `None` for other events.
fn kind_of(event: &Event) -> Option<String> {
    Some(match &event.detail {
        Detail::Link(link) => format!("link {}", link.link),
        Detail::Device(DeviceEvent::Fault { flags }) => format!("fault {}", flags.join(" ")),
        Detail::Device(DeviceEvent::FaultCleared { flags }) => format!("fault_cleared {}", flags.join(" ")),
        Detail::Device(DeviceEvent::ValuesUnknown { values, .. }) => format!("values_unknown {}", values.join(" ")),
        Detail::Device(DeviceEvent::ValuesKnown { values }) => format!("values_known {}", values.join(" ")),
        Detail::Device(DeviceEvent::ForeignMotion) => "foreign_motion".to_owned(),
        Detail::Device(DeviceEvent::Restarted) => "restarted".to_owned(),
        Detail::Device(DeviceEvent::Replaced { .. }) => "replaced".to_owned(),
        Detail::Device(DeviceEvent::PartLost { .. }) => "part_lost".to_owned(),
        _ => return None,
    })
}
