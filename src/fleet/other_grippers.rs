//! The known grippers of other gateways.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use super::report::{FleetGripper, PeerReport};
use crate::gripper::Now;
use crate::model::Name;
use url::Url;

/// Maximum number of known grippers of other gateways: enough for more than a hundred cells. Grippers of gone gateways
/// make room for others.
const MAX_GRIPPERS: usize = 4096;

/// Maximum number of known grippers of one gateway. A flood of states under one gateway's name leaves room for the
/// others.
const MAX_GRIPPERS_OF_ONE: usize = 256;

/// Maximum number of gateways known to be alive.
const MAX_GATEWAYS: usize = 1024;

/// Maximum number of sessions known under one gateway's name. With two or more, it is ambiguous which of them answers;
/// a larger number leaves room for the true one.
const MAX_INSTANCES_OF_ONE: usize = 16;

/// Longest URL of a dashboard, in bytes.
pub const MAX_URL_BYTES: usize = 512;

/// Longest session id that distinguishes gateways with one name, in bytes.
const MAX_INSTANCE_BYTES: usize = 32;

/// Silence after which a gateway is gone, whatever its liveliness token says. A gateway publishes each state at least
/// twice a second.
const GONE_AFTER: Duration = Duration::from_millis(1900);

/// Time for which a gripper is still listed after its gateway is gone.
pub const KEPT_FOR: Duration = Duration::from_hours(1);

/// The last report on a gripper, and its time.
#[derive(Debug)]
struct KnownGripper {
    report: PeerReport,
    at: Instant,
    answer: Option<OwnersAnswer>,
}

/// The answer to this gateway's newest query for a gripper's state. Anyone can publish a state, but an answer names
/// the session that sent it.
#[derive(Debug, Clone, Copy)]
struct OwnersAnswer {
    /// When the query was sent.
    asked_at: Instant,
    is_latched: bool,
    is_stopped: bool,
    /// Whether the answer comes from the only session known as that gateway.
    is_owners: bool,
}

/// Known state of a FAST STOP of one gripper.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum PeerStop {
    /// The gripper's gateway has answered that the device's flags show the FAST STOP.
    Confirmed,
    /// The gripper's gateway has answered that it repeats the FAST STOP until the flags show it.
    Latched,
    /// The gripper's gateway has not answered since, or has answered that nothing is latched.
    Unknown {
        /// Whether the gateway has answered that nothing is latched.
        is_missed: bool,
    },
    /// The gripper's gateway is gone.
    Gone,
}

impl PeerStop {
    /// Whether the gripper's gateway knows of the FAST STOP.
    pub(super) fn has_arrived(self) -> bool {
        matches!(self, Self::Confirmed | Self::Latched)
    }
}

/// Everything known of the other gateways.
#[derive(Debug, Default)]
pub(super) struct Others {
    grippers: BTreeMap<(Name, Name), KnownGripper>,
    alive: BTreeSet<Name>,
    dashboards: BTreeMap<Name, Url>,
    /// Sessions that declare themselves to be a gateway, with its name. Those with this gateway's name are left out.
    instances: BTreeSet<(Name, String)>,
}

impl Others {
    pub(super) fn take_state(&mut self, gateway: Name, gripper: Name, report: PeerReport) {
        let at = Now::read().instant;
        let name = (gateway, gripper);
        if self.grippers.len() >= MAX_GRIPPERS && !self.grippers.contains_key(&name) && !self.make_room(at) {
            tracing::warn!(gateway = %name.0, gripper = %name.1, MAX_GRIPPERS, "too many grippers: ignored");
            return;
        }
        if let Some(known) = self.grippers.get_mut(&name) {
            (known.report, known.at) = (report, at);
        } else if self.count_of(&name) < MAX_GRIPPERS_OF_ONE {
            self.grippers.insert(name, KnownGripper { report, at, answer: None });
        }
    }

    /// Counts the known grippers of the gateway in `name`, which are adjacent in the map.
    fn count_of(&self, name: &(Name, Name)) -> usize {
        let gateway = &name.0;
        let before = self.grippers.range(..name).rev().take_while(|(other, _)| other.0 == *gateway).count();
        before + self.grippers.range(name..).take_while(|(other, _)| other.0 == *gateway).count()
    }

    /// Notes the state of a known gripper that this session sent in reply to a query of `asked_at`.
    pub(super) fn take_answer(&mut self, name: &(Name, Name), report: &PeerReport, session: &str, asked_at: Instant) {
        let is_owners = self.instances_of(&name.0).eq([session]);
        let Some(known) = self.grippers.get_mut(name) else { return };
        let mut answer =
            OwnersAnswer { asked_at, is_latched: report.is_latched(), is_stopped: report.is_stopped(), is_owners };
        match known.answer {
            Some(newer) if newer.asked_at > asked_at => return,
            // If several sessions answer one query, all of them have to report the stop.
            Some(other) if other.asked_at == asked_at => {
                answer.is_latched &= other.is_latched;
                answer.is_stopped &= other.is_stopped;
                answer.is_owners &= other.is_owners;
            }
            _ => {}
        }
        known.answer = Some(answer);
    }

    pub(super) fn take_token(&mut self, gateway: Name, is_alive: bool) {
        if !is_alive {
            self.alive.remove(&gateway);
        } else if self.alive.len() < MAX_GATEWAYS {
            self.alive.insert(gateway);
        }
    }

    /// Takes the URL of a gateway's dashboard. Only web pages are accepted, since people open it.
    pub(super) fn take_dashboard(&mut self, gateway: Name, url: &str, is_alive: bool) {
        let Some(url) = parse_dashboard(url) else { return };
        let has_room = self.dashboards.len() < MAX_GATEWAYS || self.dashboards.contains_key(&gateway);
        if is_alive && has_room {
            self.dashboards.insert(gateway, url);
        } else if !is_alive && self.dashboards.get(&gateway) == Some(&url) {
            // The withdrawal of an older URL can come after the newer one.
            self.dashboards.remove(&gateway);
        }
    }

    /// Takes the token of a session that declares itself to be the gateway with this name. The link's token of a gripper
    /// called `instance` has a similar key, but no session's id.
    pub(super) fn take_instance(&mut self, gateway: Name, instance: &str, is_alive: bool) {
        let is_id = instance.len() <= MAX_INSTANCE_BYTES && instance.bytes().all(|byte| byte.is_ascii_hexdigit());
        let has_room = self.instances.len() < MAX_GATEWAYS;
        if is_alive && is_id && has_room && self.instances_of(&gateway).count() < MAX_INSTANCES_OF_ONE {
            self.instances.insert((gateway, instance.to_owned()));
        } else if !is_alive {
            self.instances.remove(&(gateway, instance.to_owned()));
        }
    }

    /// Whether a session is known as the gateway with this name.
    pub(super) fn is_instance(&self, gateway: &Name, session: &str) -> bool {
        self.instances_of(gateway).any(|instance| instance == session)
    }

    /// Sessions known as the gateway with this name: one, on an honest network.
    fn instances_of(&self, gateway: &Name) -> impl Iterator<Item = &str> {
        self.instances.iter().filter(move |(name, _)| name == gateway).map(|(_, instance)| instance.as_str())
    }

    /// Whether the gateway that owns this gripper, or would own it, is gone; `None` if the gateway is unknown.
    pub(super) fn has_lost(&self, gateway: &Name, gripper: Option<&Name>, now: Instant) -> Option<bool> {
        let mut known =
            self.grippers.iter().filter(|((name, _), _)| name == gateway).map(|(_, known)| known).peekable();
        match gripper.and_then(|gripper| self.grippers.get(&(gateway.clone(), gripper.clone()))) {
            Some(known) => Some(self.is_gone(gateway, known, now)),
            None if known.peek().is_some() => Some(known.all(|known| self.is_gone(gateway, known, now))),
            None => self.alive.contains(gateway).then_some(false),
        }
    }

    pub(super) fn grippers(&self, now: Instant) -> Vec<FleetGripper> {
        let mut grippers = Vec::new();
        for ((gateway, gripper), known) in &self.grippers {
            let since = now.saturating_duration_since(known.at);
            if since < KEPT_FOR {
                let gone = self.is_gone(gateway, known, now);
                let dashboard = self.dashboards.get(gateway);
                grippers.push(known.report.of_gripper(gateway, gripper, since, gone).shown_at(dashboard));
            }
        }
        grippers
    }

    /// Known gateways, and whether each is gone.
    pub(super) fn gateways(&self, now: Instant) -> BTreeMap<Name, bool> {
        let mut gateways = BTreeMap::new();
        let listed = self.grippers.iter().filter(|(_, known)| now.saturating_duration_since(known.at) < KEPT_FOR);
        for ((gateway, _), known) in listed {
            *gateways.entry(gateway.clone()).or_insert(true) &= self.is_gone(gateway, known, now);
        }
        for gateway in &self.alive {
            gateways.entry(gateway.clone()).or_insert(false);
        }
        gateways
    }

    /// Whether a gateway that is alive has not reported its grippers yet.
    pub(super) fn has_unreported(&self) -> bool {
        let reported: BTreeSet<_> = self.grippers.keys().map(|(owner, _)| owner).collect();
        self.alive.iter().any(|gateway| !reported.contains(gateway))
    }

    /// State of each gripper's FAST STOP since `begun`. Grippers of gone gateways are included: they could still move.
    pub(super) fn stops_since(&self, begun: Instant) -> BTreeMap<(Name, Name), PeerStop> {
        let now = Now::read().instant;
        let known = self.grippers.iter().filter(|(_, known)| now.saturating_duration_since(known.at) < KEPT_FOR);
        known.map(|(name, known)| (name.clone(), self.stop_since(begun, &name.0, known, now))).collect()
    }

    fn stop_since(&self, begun: Instant, gateway: &Name, known: &KnownGripper, now: Instant) -> PeerStop {
        match known.answer.filter(|answer| answer.asked_at >= begun) {
            Some(answer) if answer.is_owners && answer.is_stopped => PeerStop::Confirmed,
            Some(answer) if answer.is_owners && answer.is_latched => PeerStop::Latched,
            Some(answer) if !answer.is_latched => PeerStop::Unknown { is_missed: true },
            _ if self.is_gone(gateway, known, now) => PeerStop::Gone,
            _ => PeerStop::Unknown { is_missed: false },
        }
    }

    fn is_gone(&self, gateway: &Name, known: &KnownGripper, now: Instant) -> bool {
        !self.alive.contains(gateway) || now.saturating_duration_since(known.at) >= GONE_AFTER
    }

    /// Forgets the gripper with the oldest report, among those whose gateway is gone.
    fn make_room(&mut self, now: Instant) -> bool {
        let gone = self.grippers.iter().filter(|((gateway, _), known)| self.is_gone(gateway, known, now));
        let oldest = gone.min_by_key(|(_, known)| known.at).map(|(name, _)| name.clone());
        oldest.is_some_and(|name| self.grippers.remove(&name).is_some())
    }
}

/// Parses the URL of a dashboard; returns `None` if it is too long or not that of a web page.
#[must_use]
pub fn parse_dashboard(text: &str) -> Option<Url> {
    let url: Url = Some(text).filter(|text| text.len() <= MAX_URL_BYTES)?.parse().ok()?;
    let is_web = matches!(url.scheme(), "http" | "https");
    // Escaped characters are longer.
    (is_web && url.as_str().len() <= MAX_URL_BYTES).then_some(url)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn report(fast_stop: bool) -> PeerReport {
        let state = serde_json::json!({"link": "connected", "age_ms": 5, "fast_stop": fast_stop, "fast_stop_confirmed": fast_stop});
        PeerReport::of(state.to_string().as_bytes()).unwrap()
    }

    fn name(text: &str) -> Name {
        text.parse().unwrap()
    }

    fn gone(others: &Others, now: Instant) -> Vec<serde_json::Value> {
        others.grippers(now).iter().map(|gripper| serde_json::to_value(gripper).unwrap()["gone"].clone()).collect()
    }

    #[test]
    fn gateway_is_gone_without_its_token_or_after_silence() {
        let mut others = Others::default();
        others.take_token(name("cell-1"), true);
        others.take_state(name("cell-1"), name("left"), report(false));
        let now = Instant::now();
        let lost = |others: &Others, gateway, gripper, now| others.has_lost(&name(gateway), Some(&name(gripper)), now);
        assert_eq!(gone(&others, now), [false]);
        assert_eq!(gone(&others, now + GONE_AFTER), [true]);
        for gripper in ["left", "right"] {
            assert_eq!(lost(&others, "cell-1", gripper, now), Some(false));
            assert_eq!(lost(&others, "cell-1", gripper, now + GONE_AFTER), Some(true), "as in the list");
        }
        others.take_token(name("cell-1"), false);
        assert_eq!(gone(&others, now), [true]);
        assert_eq!(lost(&others, "cell-1", "left", now), Some(true));
        assert_eq!(lost(&others, "cell-2", "left", now), None);
        others.take_token(name("cell-2"), true);
        assert_eq!(lost(&others, "cell-2", "left", now), Some(false), "its grippers are not known yet");
        assert_eq!(others.gateways(now), [(name("cell-1"), true), (name("cell-2"), false)].into());
        assert_eq!(gone(&others, now + KEPT_FOR), [] as [bool; 0]);
    }

    #[test]
    fn only_an_owners_answer_since_the_stop_confirms_it() {
        let (mut others, left) = (Others::default(), (name("cell-1"), name("left")));
        others.take_token(name("cell-1"), true);
        others.take_instance(name("cell-1"), "1", true);
        others.take_instance(name("cell-1"), "alive", true);
        others.take_state(left.0.clone(), left.1.clone(), report(true));
        let begun = Instant::now();
        let later = |ms| begun + Duration::from_millis(ms);
        let stop = |others: &Others| others.stops_since(begun)[&left];
        assert_eq!(stop(&others), PeerStop::Unknown { is_missed: false }, "anyone can publish a state");
        others.take_answer(&left, &report(true), "1", begun.checked_sub(Duration::from_millis(1)).unwrap());
        assert_eq!(stop(&others), PeerStop::Unknown { is_missed: false }, "the query was sent before");
        others.take_answer(&left, &report(true), "2", later(1));
        assert_eq!(stop(&others), PeerStop::Unknown { is_missed: false }, "another session answers");
        others.take_answer(&left, &report(false), "1", later(2));
        assert_eq!(stop(&others), PeerStop::Unknown { is_missed: true });
        others.take_answer(&left, &report(true), "1", later(3));
        assert_eq!(stop(&others), PeerStop::Confirmed);
        others.take_answer(&left, &report(false), "1", later(2));
        assert_eq!(stop(&others), PeerStop::Confirmed, "an answer to an older question");
        others.take_answer(&left, &report(true), "2", later(3));
        assert_eq!(stop(&others), PeerStop::Unknown { is_missed: false }, "two answer the same question");
        others.take_instance(name("cell-1"), "2", true);
        others.take_answer(&left, &report(true), "1", later(4));
        assert_eq!(stop(&others), PeerStop::Unknown { is_missed: false }, "two sessions are known as the gateway");
        others.take_instance(name("cell-1"), "2", false);
        others.take_answer(&left, &report(true), "1", later(5));
        others.take_token(name("cell-1"), false);
        assert_eq!(stop(&others), PeerStop::Confirmed);
    }

    #[test]
    fn dashboard_is_a_web_page_of_its_gateway() {
        let mut others = Others::default();
        others.take_state(name("cell-1"), name("left"), report(false));
        let mut shown = |url: &str, is_alive| {
            others.take_dashboard(name("cell-1"), url, is_alive);
            serde_json::to_value(&others.grippers(Instant::now())[0]).unwrap()["dashboard"].clone()
        };
        assert_eq!(shown("javascript:alert(1)", true), serde_json::Value::Null);
        assert_eq!(shown(&format!("http://cell-1/{}", "x".repeat(MAX_URL_BYTES)), true), serde_json::Value::Null);
        assert_eq!(shown("https://cell-1.example:8080", true), "https://cell-1.example:8080/");
        assert_eq!(shown("https://cell-1.example/", true), "https://cell-1.example/");
        for withdrawn in ["https://cell-1.example:8080/", "alive"] {
            assert_eq!(shown(withdrawn, false), "https://cell-1.example/", "the newer URL stays");
        }
        assert_eq!(shown("https://cell-1.example/", false), serde_json::Value::Null);
    }

    #[test]
    fn one_gateway_leaves_room_for_the_others() {
        let mut others = Others::default();
        for index in 0..=MAX_GRIPPERS_OF_ONE {
            others.take_state(name("cell-1"), name(&format!("g{index}")), report(false));
        }
        assert_eq!(others.grippers.len(), MAX_GRIPPERS_OF_ONE);
        for index in 0..=MAX_INSTANCES_OF_ONE {
            others.take_instance(name("cell-1"), &index.to_string(), true);
        }
        assert_eq!(others.instances.len(), MAX_INSTANCES_OF_ONE);
    }

    #[test]
    fn only_gone_gateways_make_room() {
        let mut others = Others::default();
        let cells = MAX_GRIPPERS / MAX_GRIPPERS_OF_ONE;
        for cell in 0..cells {
            others.take_token(name(&format!("full-{cell}")), true);
            for index in 0..MAX_GRIPPERS_OF_ONE {
                others.take_state(name(&format!("full-{cell}")), name(&format!("g{index}")), report(false));
            }
        }
        others.take_token(name("cell-2"), true);
        others.take_state(name("cell-2"), name("left"), report(false));
        assert_eq!(others.grippers.len(), MAX_GRIPPERS);
        assert!(!others.grippers.contains_key(&(name("cell-2"), name("left"))));
        others.take_token(name("full-0"), false);
        others.take_state(name("cell-2"), name("left"), report(false));
        assert_eq!(others.grippers.len(), MAX_GRIPPERS);
        assert!(others.grippers.contains_key(&(name("cell-2"), name("left"))));
    }
}
