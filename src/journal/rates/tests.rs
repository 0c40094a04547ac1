//! Floods of events, on a virtual clock.

use super::super::tests::{Directory, at, id, keep, name, started};
use super::super::{Record, Recorder as _};
use super::*;
use crate::model::{
    Admitted, Alarm, AlarmCause, AlarmEvent, AlarmId, AlarmPriority, Client, Done, FastStopCause, IdSource, Outcome,
    Parameters, RequestedValues, SettingsEvent,
};

/// Upper bound of an event's size in the tests, by which an account can be overdrawn.
const ONE: u64 = 1024;

fn client(subject: &str, door: Door) -> Client {
    Client::new(subject, door)
}

fn setting(client: &Client, force_n: f32) -> Event {
    let setting = SettingChange::ForceLimit { force_n };
    Event::new(at(1), Some(name("left")), Detail::Settings(SettingsEvent { restored: false, setting })).by(client)
}

fn refused(client: &Client, code: &str) -> Event {
    let (command, cause) = ("move".to_owned(), "the lease is held".to_owned());
    let refused = RefusedEvent { command, code: code.to_owned(), cause, count: 1 };
    Event::new(at(1), Some(name("left")), Detail::Refused(refused)).by(client)
}

/// Returns the two records of a Stop.
fn stop(client: &Client, number: u32) -> [Event; 2] {
    let admitted = Admitted { command: Kind::Stop, holder: None, request_id: None, parameters: Parameters::default() };
    let done = Done {
        command: Kind::Stop,
        outcome: Outcome::Success,
        status: None,
        status_code: None,
        reached_goal: None,
        stalled: None,
        width_mm: None,
        force_n: None,
        contact_width_mm: None,
        started_at: at(1),
        duration_ms: None,
        fast_stop_id: None,
        part_id: None,
        cancelled_by: None,
        code: None,
        cause: None,
        requested: RequestedValues::default(),
    };
    [CommandEvent::Admitted(Box::new(admitted)), CommandEvent::Done(Box::new(done))]
        .map(|event| Event::new(at(1), Some(name("left")), Detail::Command(event)).by(client).of(id(number)))
}

fn bytes(events: &[Event]) -> u64 {
    events.iter().map(|event| serde_json::to_vec(event).unwrap().len() as u64 + OVERHEAD).sum()
}

/// Returns the number of requests that these events stand for.
fn total(events: &[Event]) -> u64 {
    let of = |event: &Event| aggregated(event) + count(&mut event.detail.clone()).copied().unwrap_or(1);
    events.iter().map(of).sum()
}

fn aggregated(event: &Event) -> u64 {
    event.aggregated.map_or(0, NonZero::get)
}

/// Simulates an hour in which `next` makes events a hundred times a second. Returns the written events, and the number
/// of made ones.
fn hour(rates: &Rates, start: Instant, mut next: impl FnMut(u32) -> Vec<Event>) -> (Vec<Event>, u64) {
    let (mut written, mut made) = (Vec::new(), 0);
    for number in 0..360_000 {
        let now = start + Duration::from_millis(u64::from(number) * 10);
        for event in next(number) {
            made += 1;
            written.extend(rates.take(now, event));
        }
        if number % 100 == 0 {
            written.extend(rates.due(now, false));
        }
    }
    written.extend(rates.due(start + Duration::from_hours(1), true));
    (written, made)
}

#[test]
fn flood_from_one_address_is_bounded_and_counted() {
    let (rates, start) = (Rates::default(), Instant::now());
    // One address on three interfaces is one payer.
    let clients = [("http:10.0.0.7", Door::Http), ("ws:10.0.0.7", Door::Ws), ("wsg:10.0.0.7", Door::Wsg)]
        .map(|(s, d)| client(s, d));
    let (written, made) = hour(&rates, start, |number| vec![setting(&clients[number as usize % 3], number as f32)]);
    let allowed = BURST + REFILL_PER_S * 3600 + ONE;
    assert!(bytes(&written) <= allowed, "{} of {allowed}", bytes(&written));
    assert!(bytes(&written) >= allowed - 2 * ONE, "the account is used");
    assert_eq!(total(&written), made);
    let newest = written.last().map(|event| event.detail.clone());
    assert_eq!(newest, Some(setting(&clients[0], 359_999.0).detail), "the newest value is written");
}

#[test]
fn week_of_flood_fits_the_default_size() {
    let accounts = 2 + 2 + 4;
    let week = accounts * (BURST + REFILL_PER_S * 7 * 86_400);
    assert!(week < 4_096_000_000, "{week}");
}

#[test]
fn invented_names_share_one_account() {
    let (rates, start) = (Rates::default(), Instant::now());
    let next = |number| vec![setting(&client(&format!("zenoh:robot-{number}"), Door::Zenoh), 40.0)];
    let (written, made) = hour(&rates, start, next);
    assert!(bytes(&written) <= BURST + REFILL_PER_S * 3600 + ONE, "{}", bytes(&written));
    assert_eq!(total(&written), made);
    // A name that looks like an address is a name all the same.
    assert_eq!(
        Account::of(&setting(&client("zenoh:10.0.0.8", Door::Zenoh), 1.0)).map(|account| account.payer),
        Some(Payer::Interface(Door::Zenoh))
    );
}

#[test]
fn addresses_of_one_network_share_one_account() {
    let account = |subject| Account::of(&setting(&client(subject, Door::Http), 1.0)).unwrap();
    assert_eq!(account("http:2001:db8::1"), account("http:2001:db8::ffff:2"));
    assert_ne!(account("http:2001:db8::1"), account("http:2001:db8:0:1::1"));
    assert_ne!(account("http:10.0.0.1"), account("http:10.0.0.2"));
}

#[test]
fn accounts_are_bounded() {
    let (rates, start) = (Rates::default(), Instant::now());
    for number in 0..10_000_u32 {
        rates.take(start, setting(&client(&format!("http:{}", std::net::Ipv4Addr::from(number)), Door::Http), 1.0));
    }
    assert_eq!(rates.state().balances.len(), MAX_ACCOUNTS + 1);
    // Unused accounts are closed; the shared one stays, because an aggregate waits for it.
    rates.take(start + Duration::from_hours(1), setting(&client("http:10.0.0.1", Door::Http), 1.0));
    assert_eq!(rates.state().balances.len(), 2);
}

#[test]
fn aggregates_are_bounded() {
    let (rates, start) = (Rates::default(), Instant::now());
    let client = client("http:10.0.0.7", Door::Http);
    let mut made = 0;
    let mut written = 0;
    while written + 10_000 > made {
        made += 1;
        let taken = rates.take(start, refused(&client, &format!("code-{}", made % 5000)));
        written += u64::from(taken.is_some());
    }
    assert_eq!(rates.state().merged.len(), MAX_MERGED + 1);
    let due = rates.due(start, true);
    assert_eq!(written + total(&due), made);
}

#[test]
fn flooding_stops_have_both_records_or_count() {
    let (rates, start) = (Rates::default(), Instant::now());
    let client = client("http:10.0.0.7", Door::Http);
    let (written, made) = hour(&rates, start, |number| stop(&client, number).to_vec());
    assert!(bytes(&written) <= BURST + REFILL_PER_S * 3600 + 2 * ONE, "{}", bytes(&written));
    let mut open = HashSet::new();
    let mut merged = 0;
    for event in &written {
        match (&event.detail, event.command_id) {
            (Detail::Command(CommandEvent::Admitted(_)), Some(id)) => assert!(open.insert(id)),
            (_, Some(id)) if open.remove(&id) => {}
            _ => merged += aggregated(event) + 1,
        }
    }
    assert!(open.is_empty(), "each first record has its second");
    let pairs =
        written.iter().filter(|event| matches!(&event.detail, Detail::Command(CommandEvent::Admitted(_)))).count();
    assert_eq!(pairs as u64 + merged, made / 2);
}

#[test]
fn plc_in_a_10_ms_cycle_is_recorded_one_by_one() {
    let (rates, start) = (Rates::default(), Instant::now());
    let client = client("http:10.0.0.7", Door::Http);
    for cycle in 0..1000 {
        let now = start + Duration::from_millis(cycle * 10);
        assert!(rates.take(now, setting(&client, cycle as f32)).is_some(), "cycle {cycle}");
    }
}

#[test]
fn fast_stop_is_recorded_beside_a_flood_of_its_address() {
    let (rates, now) = (Rates::default(), Instant::now());
    let client = client("http:10.0.0.7", Door::Http);
    while rates.take(now, setting(&client, 1.0)).is_some() {}
    let fast_stop = FastStopEvent {
        event: FastStopStep::Latched,
        fast_stop_id: IdSource::new(1).fast_stop_id(at(1)),
        cause: FastStopCause::Requested,
        reason: String::new(),
        count: 1,
    };
    let event = Event::new(at(1), Some(name("left")), Detail::FastStop(fast_stop)).by(&client);
    assert!(rates.take(now, event).is_some());
}

#[test]
fn alarms_of_repeated_fast_stops_are_bounded_and_counted() {
    let (rates, start) = (Rates::default(), Instant::now());
    let alarm = |step, count: u32| {
        let cause =
            AlarmCause { fast_stop_id: Some(IdSource::new(count.into()).fast_stop_id(at(1))), ..AlarmCause::default() };
        let alarm = Alarm {
            id: AlarmId::generate(),
            alarm: AlarmKind::FastStop,
            priority: AlarmPriority::Critical,
            gripper: Some(name("left")),
            gateway: None,
            cause,
            began_at: at(1),
            ended_at: None,
            count: 1,
            acknowledged_at: None,
            acknowledged_by: None,
            acknowledged_label: None,
        };
        Event::new(at(1), alarm.gripper.clone(), Detail::Alarm(Box::new(AlarmEvent::of(step, &alarm))))
    };
    let (written, made) =
        hour(&rates, start, |number| vec![alarm(AlarmStep::Ended, number), alarm(AlarmStep::Raised, number + 1)]);
    assert!(bytes(&written) <= BURST + REFILL_PER_S * 3600 + 2 * ONE, "{}", bytes(&written));
    let counted: u64 = written.iter().map(|event| aggregated(event) + 1).sum();
    assert_eq!(counted, made);
    let newest = written.iter().rev().find_map(|event| match &event.detail {
        Detail::Alarm(alarm) if alarm.event == AlarmStep::Raised => alarm.cause.fast_stop_id,
        _ => None,
    });
    assert_eq!(newest, Some(IdSource::new(360_000).fast_stop_id(at(1))), "the alarm that is listed is recorded");
}

#[test]
fn motions_are_exempt() {
    let (rates, now) = (Rates::default(), Instant::now());
    for number in 0..10_000 {
        assert!(rates.take(now, super::super::tests::admitted(1, "left", number, None)).is_some());
    }
}

#[tokio::test]
async fn flooded_journal_grows_no_more_than_its_accounts() {
    let directory = Directory::new();
    let (journal, _) = directory.open();
    let client = client("http:10.0.0.7", Door::Http);
    for round in 0..40_u32 {
        for number in 0..500_u32 {
            journal.record(Record::Event(setting(&client, (round * 500 + number) as f32), None));
        }
        keep(&journal, started(1)).await;
    }
    journal.close().await.unwrap();
    drop(journal);
    let bytes = std::fs::metadata(directory.journal()).unwrap().len();
    // The file also has the empty tables and the gateway's own events.
    assert!(bytes < BURST + BURST / 4, "{bytes}");
    assert!(bytes > BURST / 2, "the account's bytes match the file's: {bytes}");
}
