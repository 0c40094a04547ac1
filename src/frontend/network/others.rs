//! What is known of the other gateways' grippers.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use super::told::{FleetGripper, Told};
use crate::gripper::Now;
use crate::gripper::model::Name;

/// Grippers of other gateways that are known at a time: a hundred cells, and more. Those that are gone make room.
const MAX_GRIPPERS: usize = 4096;

/// Gateways that are known to live at a time.
const MAX_GATEWAYS: usize = 1024;

/// The most bytes of what tells gateways apart that have one name.
const MAX_INSTANCE_BYTES: usize = 32;

/// A gateway tells each state twice a second at least: one that has said nothing for so long is gone, whatever its
/// liveliness token says.
const GONE_AFTER: Duration = Duration::from_millis(1900);

/// How long a gripper whose gateway is gone is still told of.
const KEPT_FOR: Duration = Duration::from_hours(1);

/// What a gripper's gateway told last, and when.
#[derive(Debug)]
struct Known {
    told: Told,
    at: Instant,
}

/// What is known of a FAST STOP of one gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Stop {
    /// The gripper's flags have shown it.
    Confirmed,
    /// Its gateway repeats it until they do.
    Latched,
    /// Its gateway has not told of it; or has told, since it was asked for, that there is none.
    Unknown {
        /// That.
        is_news: bool,
    },
    /// Its gateway is gone.
    Gone,
}

/// All of it.
#[derive(Debug, Default)]
pub(super) struct Others {
    grippers: BTreeMap<(Name, Name), Known>,
    alive: BTreeSet<Name>,
    /// Which of them there are by each name, this one left out.
    instances: BTreeSet<(Name, String)>,
}

impl Others {
    pub(super) fn take_state(&mut self, gateway: Name, gripper: Name, told: Told) {
        let at = Now::read().instant;
        let name = (gateway, gripper);
        if self.grippers.len() >= MAX_GRIPPERS && !self.grippers.contains_key(&name) && !self.make_room(at) {
            tracing::warn!(gateway = %name.0, gripper = %name.1, MAX_GRIPPERS, "too many grippers on the network");
            return;
        }
        self.grippers.insert(name, Known { told, at });
    }

    pub(super) fn take_token(&mut self, gateway: Name, is_alive: bool) {
        if !is_alive {
            self.alive.remove(&gateway);
        } else if self.alive.len() < MAX_GATEWAYS {
            self.alive.insert(gateway);
        }
    }

    /// One of the gateways of this name, which says so by a token that is its own.
    pub(super) fn take_instance(&mut self, gateway: Name, instance: &str, is_alive: bool) {
        let instance = (gateway, instance.to_owned());
        if !is_alive {
            self.instances.remove(&instance);
        } else if self.instances.len() < MAX_GATEWAYS && instance.1.len() <= MAX_INSTANCE_BYTES {
            self.instances.insert(instance);
        }
    }

    /// How many other gateways have this name.
    pub(super) fn count(&self, gateway: &Name) -> usize {
        self.instances.iter().filter(|(name, _)| name == gateway).count()
    }

    /// Whether the gateway is gone that has this gripper, or would have it; none where it isn't known.
    pub(super) fn has_lost(&self, gateway: &Name, gripper: &Name, now: Instant) -> Option<bool> {
        let mut known =
            self.grippers.iter().filter(|((name, _), _)| name == gateway).map(|(_, known)| known).peekable();
        match self.grippers.get(&(gateway.clone(), gripper.clone())) {
            Some(known) => Some(self.is_gone(gateway, known, now)),
            None if known.peek().is_some() => Some(known.all(|known| self.is_gone(gateway, known, now))),
            None => self.alive.contains(gateway).then_some(false),
        }
    }

    pub(super) fn grippers(&self, now: Instant) -> Vec<FleetGripper> {
        let tell = |((gateway, gripper), known): (&(Name, Name), &Known)| {
            let since = now.saturating_duration_since(known.at);
            let gone = self.is_gone(gateway, known, now);
            (since < KEPT_FOR).then(|| known.told.of_gripper(gateway, gripper, since, gone))
        };
        self.grippers.iter().filter_map(tell).collect()
    }

    /// What is known of each gripper's FAST STOP since then, also of those whose gateway is gone: they may move on.
    pub(super) fn stops_since(&self, begun: Instant) -> BTreeMap<(Name, Name), Stop> {
        let now = Now::read().instant;
        let known = self.grippers.iter().filter(|(_, known)| now.saturating_duration_since(known.at) < KEPT_FOR);
        let stop = |(name, known): (&(Name, Name), &Known)| {
            let is_news = known.at >= begun;
            let stop = match (is_news, self.is_gone(&name.0, known, now)) {
                (true, _) if known.told.is_stopped() => Stop::Confirmed,
                (true, _) if known.told.is_latched() => Stop::Latched,
                (_, true) => Stop::Gone,
                (is_news, false) => Stop::Unknown { is_news },
            };
            (name.clone(), stop)
        };
        known.map(stop).collect()
    }

    fn is_gone(&self, gateway: &Name, known: &Known, now: Instant) -> bool {
        !self.alive.contains(gateway) || now.saturating_duration_since(known.at) >= GONE_AFTER
    }

    /// Forgets the gripper that was not heard of for longest, if its gateway is gone.
    fn make_room(&mut self, now: Instant) -> bool {
        let gone = self.grippers.iter().filter(|((gateway, _), known)| self.is_gone(gateway, known, now));
        let oldest = gone.min_by_key(|(_, known)| known.at).map(|(name, _)| name.clone());
        oldest.is_some_and(|name| self.grippers.remove(&name).is_some())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(fast_stop: bool) -> Told {
        let state = serde_json::json!({"link": "connected", "age_ms": 5, "fast_stop": fast_stop, "fast_stop_confirmed": fast_stop});
        Told::of(state.to_string().as_bytes()).unwrap()
    }

    fn name(text: &str) -> Name {
        text.parse().unwrap()
    }

    fn gone(others: &Others, now: Instant) -> Vec<serde_json::Value> {
        others.grippers(now).iter().map(|gripper| serde_json::to_value(gripper).unwrap()["gone"].clone()).collect()
    }

    #[test]
    fn a_gateway_is_gone_with_its_token_and_when_it_is_silent() {
        let mut others = Others::default();
        others.take_token(name("cell-1"), true);
        others.take_state(name("cell-1"), name("left"), told(false));
        let now = Instant::now();
        let lost = |others: &Others, gateway, gripper, now| others.has_lost(&name(gateway), &name(gripper), now);
        assert_eq!(gone(&others, now), [false]);
        assert_eq!(gone(&others, now + GONE_AFTER), [true]);
        for gripper in ["left", "right"] {
            assert_eq!(lost(&others, "cell-1", gripper, now), Some(false));
            assert_eq!(lost(&others, "cell-1", gripper, now + GONE_AFTER), Some(true), "as it is told");
        }
        others.take_token(name("cell-1"), false);
        assert_eq!(gone(&others, now), [true]);
        assert_eq!(lost(&others, "cell-1", "left", now), Some(true));
        assert_eq!(lost(&others, "cell-2", "left", now), None);
        others.take_token(name("cell-2"), true);
        assert_eq!(lost(&others, "cell-2", "left", now), Some(false), "it has not told of it yet");
        assert_eq!(gone(&others, now + KEPT_FOR), [] as [bool; 0]);
    }

    #[test]
    fn a_stop_counts_that_was_told_of_since_it_was_asked_for() {
        let mut others = Others::default();
        others.take_token(name("cell-1"), true);
        others.take_state(name("cell-1"), name("left"), told(true));
        let begun = Instant::now() + Duration::from_nanos(1);
        let stops = |others: &Others| others.stops_since(begun).into_values().collect::<Vec<_>>();
        assert_eq!(stops(&others), [Stop::Unknown { is_news: false }]);
        while Now::read().instant < begun {}
        others.take_state(name("cell-1"), name("left"), told(false));
        assert_eq!(stops(&others), [Stop::Unknown { is_news: true }]);
        others.take_state(name("cell-1"), name("left"), told(true));
        assert_eq!(stops(&others), [Stop::Confirmed]);
        others.take_state(name("cell-1"), name("left"), told(false));
        others.take_token(name("cell-1"), false);
        assert_eq!(stops(&others), [Stop::Gone], "it may move on");
    }

    #[test]
    fn who_is_gone_makes_room_and_who_lives_does_not() {
        let mut others = Others::default();
        others.take_token(name("cell-1"), true);
        for index in 0..MAX_GRIPPERS {
            others.take_state(name("cell-1"), name(&format!("g{index}")), told(false));
        }
        others.take_token(name("cell-2"), true);
        others.take_state(name("cell-2"), name("left"), told(false));
        assert_eq!(others.grippers.len(), MAX_GRIPPERS);
        assert!(!others.grippers.contains_key(&(name("cell-2"), name("left"))));
        others.take_token(name("cell-1"), false);
        others.take_state(name("cell-2"), name("left"), told(false));
        assert_eq!(others.grippers.len(), MAX_GRIPPERS);
        assert!(others.grippers.contains_key(&(name("cell-2"), name("left"))));
    }
}
