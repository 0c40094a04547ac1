//! Throughput and latency of the journal: durable commands per second on a real disk, their cost for a gripper command,
//! and the time of a page of 100 among a million events for each combination of filters.
//!
//! `cargo bench --bench journal`, or with `-- --events 100000`. Fails if a page takes longer than 20 ms.

mod directory;

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use directory::Directory;
use jiff::{SignedDuration, Timestamp};
use prometheus::Registry;
use tokio::sync::oneshot;
use wsg_gateway::daemon::{ServedDevice, SimulatedDevice, Switch, serve_device};
use wsg_gateway::gripper::recorder::{NullRecorder, Record, Recorder, RestoredState};
use wsg_gateway::gripper::{self, Connector, Handle};
use wsg_gateway::journal::{
    EventKind, EventQuery, Filter, GripQuery, Journal, JournalLocation, Order, Page, Query, ReadError, Reader,
    Retention, verify,
};
use wsg_gateway::model::{
    Action, Admitted, Client, CommandEvent, CommandId, Detail, Done, Door, Event, GripRecord, IdSource, Kind, Link,
    LinkEvent, Motion, Name, Outcome, Parameters, PartId, RequestedValues, Sample, Submission,
};
use wsg_gateway::sim::DeviceConfig;
use wsg_gateway::wsg::{HomingDirection, MoveFlags, Speed, Width};

type Error = Box<dyn std::error::Error>;

/// Duration of each rate measurement.
const MEASURED: Duration = Duration::from_secs(5);

/// Time limit of a page.
const PAGE_LIMIT: Duration = Duration::from_millis(20);

/// Reads of each page; the fastest counts, to exclude other load.
const READS: usize = 3;

/// Commands given to each gripper, with and without a journal.
const COMMANDS: usize = 200;

/// Longer than the pause between two motions, so that the pause is not measured.
const REST: Duration = Duration::from_millis(60);

/// Events recorded before each wait for the disk; fewer than the journal's queue holds.
const BURST: u32 = 4000;

fn main() -> Result<(), Error> {
    let arguments: Vec<_> = std::env::args().collect();
    let events = arguments.windows(2).find(|pair| pair[0] == "--events").map(|pair| &pair[1]);
    let events: u32 = events.map_or(Ok(1_000_000), |count| count.parse())?;
    let directory = Directory::new("journal")?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    for clients in [1, 64] {
        let (journal, _) = open(&directory.0.join(format!("{clients}.db")))?;
        let commands = runtime.block_on(rate(&journal, clients))?;
        let rate = f64::from(commands) / MEASURED.as_secs_f64();
        println!("{clients} clients in lockstep: {rate:.0} commands/s, each of two durable records");
        runtime.block_on(journal.close())?;
    }
    runtime.block_on(commands(&directory.0.join("commands.db")))?;
    let path = directory.0.join("large.db");
    let begun = Instant::now();
    runtime.block_on(fill(&path, events))?;
    let rate = f64::from(events) / begun.elapsed().as_secs_f64();
    let megabytes = std::fs::metadata(&path)?.len() / 1_000_000;
    println!("{events} events and a quarter as many grip records: {rate:.0} events/s, {megabytes} MB");
    let worst = pages(&Reader::open(&path)?, events)?;
    let begun = Instant::now();
    let report = verify(&path)?;
    println!("verified in {:.1?}: {} findings", begun.elapsed(), report.findings.len());
    if worst > PAGE_LIMIT || !report.findings.is_empty() {
        return Err(format!("a page took {worst:?} (limit {PAGE_LIMIT:?}), or verify found damage").into());
    }
    Ok(())
}

fn open(path: &Path) -> Result<(Journal, wsg_gateway::journal::Recovered), Error> {
    Ok(Journal::open(JournalLocation::File(path.to_owned()), Retention::default())?)
}

fn command(id: CommandId, at: Timestamp, gripper: &Name, event: CommandEvent) -> Event {
    let client = Client::new("http:127.0.0.1", Door::Http);
    Event::new(at, Some(gripper.clone()), Detail::Command(event)).by(&client).of(id)
}

fn admitted(part_id: Option<PartId>) -> CommandEvent {
    let parameters = Parameters { width_mm: Some(20.0), speed_mm_s: Some(50.0), part_id, ..Parameters::default() };
    CommandEvent::Admitted(Box::new(Admitted { command: Kind::Grip, holder: None, request_id: None, parameters }))
}

fn done(at: Timestamp, part_id: Option<PartId>, outcome: Outcome) -> CommandEvent {
    CommandEvent::Done(Box::new(Done {
        command: Kind::Grip,
        outcome,
        status: Some("E_SUCCESS".to_owned()),
        status_code: Some(0),
        reached_goal: Some(true),
        stalled: Some(true),
        width_mm: Some(20.1),
        force_n: Some(40.0),
        contact_width_mm: None,
        started_at: at,
        duration_ms: Some(412),
        fast_stop_id: None,
        cancelled_by: None,
        part_id,
        code: None,
        cause: None,
        requested: wsg_gateway::model::RequestedValues::default(),
    }))
}

async fn durable(journal: &Journal, event: Event) -> Result<(), Error> {
    let (notify, durable) = oneshot::channel();
    journal.record(Record::Event(event, Some(notify)));
    Ok(durable.await?)
}

/// Returns the number of commands that `clients` clients record, each waiting for every record.
async fn rate(journal: &Journal, clients: u64) -> Result<u32, Error> {
    let until = Instant::now() + MEASURED;
    let running: Vec<_> = (0..clients)
        .map(|client| {
            let journal = journal.clone();
            tokio::spawn(async move {
                let (mut ids, mut commands) = (IdSource::new(client), 0);
                let gripper: Name = format!("g{client}").parse().map_err(|_| "no name")?;
                while Instant::now() < until {
                    let at = Timestamp::now();
                    let id = ids.command_id(at);
                    durable(&journal, command(id, at, &gripper, admitted(None))).await.map_err(|_| "lost")?;
                    let end = done(at, None, Outcome::PartHeld);
                    durable(&journal, command(id, at, &gripper, end)).await.map_err(|_| "lost")?;
                    commands += 1;
                }
                Ok::<u32, &str>(commands)
            })
        })
        .collect();
    let mut commands = 0;
    for client in running {
        commands += client.await??;
    }
    Ok(commands)
}

/// Starts and homes a simulated gripper with this recorder. The device stops when the switch is dropped.
async fn gripper(recorder: Arc<dyn Recorder>) -> Result<(Handle, Switch), Error> {
    let device = SimulatedDevice::new(DeviceConfig::wsg50());
    let ServedDevice { address, switch, .. } = serve_device(&"tcp://127.0.0.1:0".parse()?, device).await?;
    let name: Name = "g".parse()?;
    let config = gripper::actor::ActorConfig {
        gateway: "gateway".parse()?,
        url: address.url(),
        properties: address.properties(),
        rules: wsg_gateway::model::GripperRules::default(),
        seed: 1,
        metrics: gripper::GripperMetrics::register(&Registry::new(), &name)?,
        name,
    };
    let handle = gripper::spawn(config, Arc::new(address), recorder, RestoredState::default());
    handle.states().wait_for(|state| state.link == Link::Connected).await?;
    run(&handle, Action::Motion(Motion::Home(HomingDirection::Default))).await?;
    Ok((handle, switch))
}

/// Runs a command, and returns the time until its result.
async fn run(handle: &Handle, action: Action) -> Result<Duration, Error> {
    let client = Client::new("http:127.0.0.1", Door::Http);
    let begun = Instant::now();
    let mut ticket = handle.submit(Submission { client, action, request_id: None, lease: None }).await?;
    let command = ticket.wait(Duration::from_mins(1)).await;
    let took = begun.elapsed();
    match command.outcome {
        Some(Outcome::Success) => Ok(took),
        outcome => Err(format!("a {} ended with {outcome:?}", command.kind).into()),
    }
}

/// Runs the same commands alternately with and without a durable journal.
async fn commands(path: &Path) -> Result<(), Error> {
    let (journal, _) = open(path)?;
    let (with, _device) = gripper(Arc::new(journal.clone())).await?;
    let (without, _other_device) = gripper(Arc::new(NullRecorder)).await?;
    let flags = MoveFlags { relative: false, stop_on_block: true };
    let a_move =
        |mm| Ok::<_, Error>(Action::Motion(Motion::Move { flags, width: Width::new(mm)?, speed: Speed::new(400.0)? }));
    let stops = [Action::Stop, Action::Stop];
    let moves = [a_move(50.0)?, a_move(51.0)?];
    for (name, actions) in [("a Stop", stops), ("a move of 1 mm", moves)] {
        let (mut recorded, mut unrecorded) = (Vec::new(), Vec::new());
        for action in actions.iter().cycle().take(COMMANDS) {
            tokio::time::sleep(REST).await;
            recorded.push(run(&with, action.clone()).await?);
            unrecorded.push(run(&without, action.clone()).await?);
        }
        recorded.sort_unstable();
        unrecorded.sort_unstable();
        let (recorded, unrecorded) = (recorded[COMMANDS / 2], unrecorded[COMMANDS / 2]);
        let ratio = recorded.as_secs_f64() / unrecorded.as_secs_f64();
        println!("{name}: with the journal {recorded:.2?}, without {unrecorded:.2?} (medians), ratio {ratio:.2}");
    }
    Ok(journal.close().await?)
}

/// Time of the event with this number, at ten events a second.
fn time(number: u32) -> Timestamp {
    Timestamp::UNIX_EPOCH
        + SignedDuration::from_hours(24 * 365 * 50)
        + SignedDuration::from_millis(i64::from(number) * 100)
}

/// Records this many events of all kinds; one in a thousand has rare values.
async fn fill(path: &Path, events: u32) -> Result<(), Error> {
    let (journal, _) = open(path)?;
    let mut ids = IdSource::new(1);
    for number in (0..events).step_by(4) {
        let (at, rare) = (time(number), number % 4000 == 0);
        let gripper: Name = (if rare { "rare" } else { ["left", "right"][number as usize / 4 % 2] }).parse()?;
        let part_id = PartId::new(if rare { "P-rare" } else { "P-1" }).filter(|_| number % 3 == 0);
        let outcome = if rare { Outcome::NoPart } else { Outcome::PartHeld };
        let id = ids.command_id(at);
        let link = Detail::Link(LinkEvent { link: Link::Connected, link_cause: None });
        let events = [
            command(id, at, &gripper, admitted(part_id.clone())),
            command(id, at, &gripper, done(at, part_id.clone(), outcome)),
            Event::new(at, Some(gripper.clone()), link.clone()),
        ];
        for event in events {
            journal.record(Record::Event(event, None));
        }
        journal.record(Record::Grip(Box::new(grip(id, at, &gripper, part_id, outcome))));
        let last = Event::new(at, Some(gripper), link);
        if number % BURST == 0 {
            durable(&journal, last).await?;
        } else {
            journal.record(Record::Event(last, None));
        }
    }
    Ok(journal.close().await?)
}

fn grip(id: CommandId, at: Timestamp, gripper: &Name, part_id: Option<PartId>, outcome: Outcome) -> GripRecord {
    let sample =
        |i: u16| Sample { t_ms: u32::from(i) * 10, width_mm: 60.0 - f32::from(i), speed_mm_s: -50.0, force_n: 0.0 };
    GripRecord {
        id,
        gateway: gripper.clone(),
        gripper: gripper.clone(),
        serial_number: None,
        kind: Kind::Grip,
        part_id,
        outcome,
        code: None,
        detail: None,
        subject: "http:127.0.0.1".into(),
        requested: RequestedValues::default(),
        started_at: at,
        duration_ms: Some(412),
        width_mm: Some(20.1),
        force_n: Some(40.0),
        measured_at: Some(at),
        peak_force_n: Some(41.5),
        travel_mm: 39.0,
        contact_width_mm: Some(20.2),
        time_to_contact_ms: Some(300),
        samples: 40,
        curve: (0..40).map(sample).collect(),
    }
}

/// Returns all combinations of frequent, rare and absent values.
fn filters<K: Copy>(kinds: &[K]) -> Result<Vec<Filter<K>>, Error> {
    let kinds: Vec<_> = std::iter::once(None).chain(kinds.iter().copied().map(Some)).collect();
    let mut filters = Vec::new();
    for gripper in [None, Some("left"), Some("rare"), Some("none")] {
        let gripper: Option<Name> = gripper.map(str::parse).transpose()?;
        for &kind in &kinds {
            for part_id in [None, Some("P-1"), Some("P-rare"), Some("none")] {
                for outcome in [None, Some(Outcome::PartHeld), Some(Outcome::NoPart), Some(Outcome::Blocked)] {
                    let (gripper, part_id) = (gripper.clone(), part_id.and_then(PartId::new));
                    filters.push(Filter { gripper, kind, part_id, part_prefix: None, outcome, command_id: None });
                }
            }
        }
    }
    Ok(filters)
}

fn pages(reader: &Reader, events: u32) -> Result<Duration, Error> {
    let kinds = [EventKind::Command, EventKind::Link, EventKind::FastStop];
    let events_worst = slowest("events", events, filters(&kinds)?, |query: &EventQuery| reader.events(query))?;
    let kinds = [Kind::Grip, Kind::Move];
    let grips_worst = slowest("grips", events, filters(&kinds)?, |query: &GripQuery| reader.grips(query))?;
    Ok(events_worst.max(grips_worst))
}

fn slowest<K: Copy + std::fmt::Debug>(
    name: &str,
    events: u32,
    filters: Vec<Filter<K>>,
    read: impl Fn(&Query<K>) -> Result<Page, ReadError>,
) -> Result<Duration, Error> {
    let ranges = [
        (None, None),
        (Some(time(events / 100)), Some(time(events / 90))),
        (Some(time(events / 3)), None),
        (None, Some(time(events / 2))),
        (Some(time(events / 2 + 100)), Some(time(events / 2 + 101))),
        (None, Some(Timestamp::UNIX_EPOCH)),
    ];
    let (mut worst, mut times) = ((Duration::ZERO, String::new()), Vec::new());
    for filter in filters {
        for (from, to) in ranges {
            for order in [Order::Newest, Order::Oldest] {
                let query = Query { filter: filter.clone(), from, to, order, ..Query::default() };
                let mut fastest = Duration::MAX;
                for _ in 0..READS {
                    let begun = Instant::now();
                    read(&query)?;
                    fastest = fastest.min(begun.elapsed());
                }
                times.push(fastest);
                if fastest > worst.0 {
                    worst = (fastest, format!("{query:?}"));
                }
            }
        }
    }
    times.sort_unstable();
    let (count, median) = (times.len(), times[times.len() / 2]);
    println!(
        "{name}: {count} queries, a page of 100 takes {median:.2?} (median), {:.2?} (worst): {}",
        worst.0, worst.1
    );
    Ok(worst.0)
}
