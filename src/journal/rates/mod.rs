//! Rate limits for records, so that no client can flush the audit trail by repeating cheap requests.
//!
//! Each client's address has an account of bytes. While bytes are left, every event is a record of its own. After that,
//! the newest event of a kind stands for all of its kind, and carries their count. It is written when the account
//! allows, but at least a second later. No count is lost. Changes of recipes cannot be merged, because each version is
//! recorded: beyond the rate, the client's next change is refused.
//!
//! A motion's two records are exempt, because every motion has to be recorded; the device bounds their rate. Events
//! that no client causes are exempt too: those of the gateway, the link and the device. A gripper's alarms are not:
//! each FAST STOP raises one.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::mem::{Discriminant, discriminant};
use std::net::{IpAddr, Ipv6Addr};
use std::num::NonZero;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::model::{
    AlarmKind, AlarmStep, Client, CommandEvent, CommandId, Detail, DeviceEvent, Door, Event, FastStopEvent,
    FastStopStep, Kind, LeaseStep, Name, RefusedEvent, SettingChange,
};

/// Initial and maximum bytes of an account: some 1,700 records. A PLC that changes a setting in each 10 ms cycle is
/// recorded one by one for 17 s.
const BURST: u64 = 1 << 20;

/// Bytes that an account gets each second: about one record. One address that floods four grippers through all
/// interfaces draws on eight accounts: two of its own, two of Zenoh's, and each gripper's.
/// 8 × (1 MiB + 768 B/s × 604,800 s) = 3.7 GB a week, so the default 4,096 MB hold more than a week of such a flood.
const REFILL_PER_S: u64 = 768;

/// Bytes that a record takes in the file besides its JSON: hash, indexes and page overhead.
const OVERHEAD: u64 = 300;

/// Shortest time for which events are merged, so that an aggregate is written at most once a second.
const MERGED_FOR: Duration = Duration::from_secs(1);

/// Maximum number of separate accounts: more than a cell has clients. Further clients share one.
const MAX_ACCOUNTS: usize = 64;

/// Maximum number of separate aggregates. Further ones of an account share one.
const MAX_MERGED: usize = 256;

/// Maximum number of Stops with their second record still to come: more than the lanes of 32 grippers hold.
const MAX_OPEN_STOPS: usize = 1024;

/// Account to which a client's records are charged.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Account {
    payer: Payer,
    /// FAST STOPs, acknowledgements and alarms have an account of their own, so that other records cannot use it up.
    is_fast_stop: bool,
}

/// Identity of a client that it cannot invent.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Payer {
    /// Address of a peer; for IPv6 its /64 network, because a host has 2^64 addresses there.
    Address(IpAddr),
    /// Name of a credential.
    Credential(String),
    /// All clients of an interface that knows only names of the clients' own choice.
    Interface(Door),
    /// Alarms, and events of FAST STOPs that the device shows, whichever client caused them.
    Gripper(Name),
    /// Clients beyond [`MAX_ACCOUNTS`].
    Others,
}

impl Account {
    fn of(event: &Event) -> Option<Self> {
        let is_fast_stop = matches!(event.detail, Detail::FastStop(_) | Detail::Acknowledge(_) | Detail::Alarm(_));
        let payer = match (&event.subject, event.door, &event.gripper) {
            (Some(subject), Some(door), _) => Payer::of(subject, door),
            (_, _, Some(gripper)) if is_fast_stop => Payer::Gripper(gripper.clone()),
            _ => return None,
        };
        Some(Self { payer, is_fast_stop })
    }
}

impl Payer {
    fn of(subject: &str, door: Door) -> Self {
        if matches!(door, Door::Zenoh | Door::Mqtt) {
            return Self::Interface(door);
        }
        let address = subject.split_once(':').and_then(|(_, address)| address.parse().ok());
        match address {
            Some(IpAddr::V6(address)) => {
                let network = address.to_bits() >> 64 << 64;
                Self::Address(Ipv6Addr::from_bits(network).into())
            }
            Some(address) => Self::Address(address),
            None => Self::Credential(subject.to_owned()),
        }
    }
}

/// Kinds of events that are merged into the newest one.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
enum Mergeable {
    Stop,
    FastStop(Discriminant<FastStopStep>),
    Acknowledge,
    Lease(Discriminant<LeaseStep>),
    Setting(Discriminant<SettingChange>),
    Device(Discriminant<DeviceEvent>),
    Refused(String),
    Alarm(AlarmKind, AlarmStep),
    /// Kinds beyond [`MAX_MERGED`].
    Others,
}

impl Mergeable {
    fn of(detail: &Detail) -> Option<Self> {
        Some(match detail {
            Detail::Command(CommandEvent::Admitted(admitted)) if admitted.command == Kind::Stop => Self::Stop,
            Detail::Command(CommandEvent::Done(done)) if done.command == Kind::Stop => Self::Stop,
            // Changes of recipes are refused beyond the rate.
            Detail::Command(_) | Detail::Link(_) | Detail::Gateway(_) | Detail::Recipe(_) => return None,
            Detail::FastStop(event) => Self::FastStop(discriminant(&event.event)),
            Detail::Acknowledge(_) => Self::Acknowledge,
            Detail::Lease(event) => Self::Lease(discriminant(&event.event)),
            Detail::Settings(event) => Self::Setting(discriminant(&event.setting)),
            Detail::Device(event) => Self::Device(discriminant(event)),
            Detail::Refused(event) => Self::Refused(event.code.clone()),
            Detail::Alarm(event) => Self::Alarm(event.alarm, event.event),
        })
    }
}

/// Bytes left in an account; below 0 by at most one record.
#[derive(Debug)]
struct Balance {
    bytes: f64,
    at: Instant,
}

impl Balance {
    fn refill(&mut self, now: Instant) {
        let earned = now.saturating_duration_since(self.at).as_secs_f64() * REFILL_PER_S as f64;
        self.bytes = (self.bytes + earned).min(BURST as f64);
        self.at = self.at.max(now);
    }

    fn is_full(&self) -> bool {
        self.bytes >= BURST as f64
    }
}

#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Slot {
    account: Account,
    gripper: Option<Name>,
    kind: Mergeable,
}

/// The accounts, and the aggregates that wait for them.
#[derive(Debug, Default)]
pub(super) struct Rates(Mutex<State>);

#[derive(Debug, Default)]
struct State {
    balances: HashMap<Account, Balance>,
    /// Newest event of each slot, and the time at which merging began.
    merged: HashMap<Slot, (Instant, Event)>,
    open_stops: HashSet<CommandId>,
    /// Time at which unused accounts were last closed.
    closed_at: Option<Instant>,
}

impl Rates {
    /// Returns an event that is to be written now, or merges it and returns none.
    pub(super) fn take(&self, now: Instant, event: Event) -> Option<Event> {
        let Some(account) = Account::of(&event) else { return Some(event) };
        let mut state = self.state();
        if matches!(event.detail, Detail::Recipe(_)) {
            let account = state.known(now, account);
            state.charge(&account, &event);
            return Some(event);
        }
        let Some(kind) = Mergeable::of(&event.detail) else { return Some(event) };
        let account = state.known(now, account);
        if let Detail::Command(command) = &event.detail {
            let is_admitted = matches!(command, CommandEvent::Admitted(_));
            return state.take_stop(now, account, is_admitted, event);
        }
        let slot = Slot { account, gripper: event.gripper.clone(), kind };
        if state.has(&slot.account) && !state.merged.contains_key(&slot) {
            state.charge(&slot.account, &event);
            return Some(event);
        }
        state.merge(now, slot, event);
        None
    }

    /// Whether a client has not exceeded the rate at which changes are recorded that cannot be merged.
    pub(super) fn allows(&self, now: Instant, client: &Client) -> bool {
        let account = Account { payer: Payer::of(&client.subject, client.door), is_fast_stop: false };
        let mut state = self.state();
        let account = state.known(now, account);
        state.has(&account)
    }

    /// Returns the aggregates that are due, oldest first; all of them when the journal closes.
    pub(super) fn due(&self, now: Instant, all: bool) -> Vec<Event> {
        let mut state = self.state();
        let mut due: Vec<_> = state
            .merged
            .iter()
            .filter(|(_, (since, _))| all || now >= *since + MERGED_FOR)
            .map(|(slot, (since, _))| (*since, slot.clone()))
            .collect();
        due.sort_by_key(|(since, _)| *since);
        let mut events = Vec::new();
        for (_, slot) in due {
            state.refill(now, &slot.account);
            if (all || state.has(&slot.account))
                && let Some((_, event)) = state.merged.remove(&slot)
            {
                state.charge(&slot.account, &event);
                events.push(event);
            }
        }
        events.sort_by_key(|event| event.at);
        events
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl State {
    /// Opens an account if needed, and returns it; the shared one if there are too many.
    fn known(&mut self, now: Instant, account: Account) -> Account {
        let is_new = !self.balances.contains_key(&account);
        if is_new && self.balances.len() >= MAX_ACCOUNTS {
            self.close_unused(now);
        }
        let is_one_too_many = is_new && self.balances.len() >= MAX_ACCOUNTS;
        let account = if is_one_too_many { Account { payer: Payer::Others, ..account } } else { account };
        self.refill(now, &account);
        account
    }

    /// Closes the accounts that are full and have no waiting aggregates.
    fn close_unused(&mut self, now: Instant) {
        if self.closed_at.is_some_and(|at| now < at + MERGED_FOR) {
            return;
        }
        self.closed_at = Some(now);
        self.balances.values_mut().for_each(|balance| balance.refill(now));
        let waiting: HashSet<_> = self.merged.keys().map(|slot| &slot.account).collect();
        self.balances.retain(|account, balance| !balance.is_full() || waiting.contains(account));
    }

    fn refill(&mut self, now: Instant, account: &Account) {
        match self.balances.get_mut(account) {
            Some(balance) => balance.refill(now),
            None => drop(self.balances.insert(account.clone(), Balance { bytes: BURST as f64, at: now })),
        }
    }

    fn has(&self, account: &Account) -> bool {
        self.balances.get(account).is_some_and(|balance| balance.bytes > 0.0)
    }

    fn charge(&mut self, account: &Account, event: &Event) {
        let bytes = serde_json::to_vec(event).map_or(0, |json| json.len() as u64) + OVERHEAD;
        if let Some(balance) = self.balances.get_mut(account) {
            balance.bytes -= bytes as f64;
        }
    }

    /// Takes a Stop's record. A Stop has both of its records, or is counted with the newest: after a restart a first
    /// record without the second would end as `UNKNOWN`.
    fn take_stop(&mut self, now: Instant, account: Account, is_admitted: bool, event: Event) -> Option<Event> {
        let Some(id) = event.command_id else { return Some(event) };
        if is_admitted {
            if !self.has(&account) || self.open_stops.len() >= MAX_OPEN_STOPS {
                return None;
            }
            self.open_stops.insert(id);
        } else if !self.open_stops.remove(&id) {
            let slot = Slot { account, gripper: event.gripper.clone(), kind: Mergeable::Stop };
            self.merge(now, slot, event);
            return None;
        }
        self.charge(&account, &event);
        Some(event)
    }

    fn merge(&mut self, now: Instant, mut slot: Slot, mut event: Event) {
        if self.merged.len() >= MAX_MERGED && !self.merged.contains_key(&slot) {
            slot = Slot { gripper: None, kind: Mergeable::Others, ..slot };
        }
        match self.merged.entry(slot) {
            Entry::Occupied(mut entry) => {
                let (_, newest) = entry.get_mut();
                absorb(&mut event, newest);
                *newest = event;
            }
            Entry::Vacant(entry) => drop(entry.insert((now, event))),
        }
    }
}

/// Merges an older event into the newest one.
fn absorb(newest: &mut Event, older: &mut Event) {
    let mut more = 0;
    match (count(&mut newest.detail), count(&mut older.detail).copied()) {
        (Some(count), Some(older)) => *count += older,
        (_, older) => more = older.unwrap_or(1),
    }
    more += newest.aggregated.map_or(0, NonZero::get) + older.aggregated.map_or(0, NonZero::get);
    newest.aggregated = NonZero::new(more);
}

/// Returns the count of requests in an event; `None` if its kind has no count of its own.
fn count(detail: &mut Detail) -> Option<&mut u64> {
    match detail {
        Detail::FastStop(FastStopEvent { count, .. })
        | Detail::Refused(RefusedEvent { count, .. })
        | Detail::Device(DeviceEvent::Streamed { count, .. }) => Some(count),
        _ => None,
    }
}

#[cfg(test)]
mod tests;
