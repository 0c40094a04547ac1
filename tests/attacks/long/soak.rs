//! A thousand clients come and go for a long time, while memory, descriptors and the time of a FAST STOP stay flat.
//!
//! `SECONDS_OF_SOAK=3600 cargo test --test attacks soak -- --nocapture` runs it for an hour.

use std::io;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::time::{sleep, timeout};

use super::streams::followed;
use crate::attacker::{Attacker, Crowd, Done};
use crate::device::Device;
use crate::every_run::subscribed;
use crate::gateway::{Gateway, Usage};
use crate::http;
use crate::poller::Poller;
use crate::probe::{Probe, Way};
use crate::websocket::{KEY, TEXT, frame, upgrade};

const CLIENTS: usize = 1000;

/// Duration without `SECONDS_OF_SOAK`.
const DEFAULT_SECONDS: u64 = 300;

/// Number of periods. The first quarter warms up; the second quarter is compared with the last.
const PERIODS: usize = 12;
const QUARTER: usize = PERIODS / 4;

/// FAST STOPs over HTTP in each period.
const STOPS: usize = 20;

/// Limit on the median time of a FAST STOP.
const MEDIAN_WITHIN: Duration = Duration::from_millis(50);

/// Growth still considered flat: noise of the allocator, and variation in the number of connected clients.
const NOISE_MB: usize = 8;
const NOISE_DESCRIPTORS_PERCENT: usize = 15;
const NOISE_TIME: Duration = Duration::from_millis(10);

/// Time for the gateway to notice that the clients have left.
const NOTICES_WITHIN: Duration = Duration::from_secs(20);

/// Descriptors of idle pools, such as the journal's readers, that may be open after the clients have left.
const POOLED: usize = 16;

const POLLS_EVERY: Duration = Duration::from_millis(500);

/// Stays for up to ten seconds, then leaves in the middle of its requests.
pub async fn come_and_go(crowd: Arc<Crowd>, index: usize, stream: TcpStream) -> io::Result<()> {
    let stays_for = Duration::from_millis(rand::random_range(100..10_000));
    let visit = async {
        match index % 5 {
            0 => subscribed(crowd, stream, r#"{"topics": ["state", "telemetry", "events"], "max_hz": 2}"#).await,
            1 => followed(crowd, stream, "topics=state,events&max_hz=2").await,
            2 => poll(&crowd, stream).await,
            3 => hold(&crowd, stream).await,
            _ => send_half(&crowd, stream).await,
        }
    };
    timeout(stays_for, visit).await.unwrap_or(Ok(()))
}

/// Polls the state on one connection.
async fn poll(crowd: &Crowd, mut stream: TcpStream) -> io::Result<()> {
    let (request, mut buffer) = (http::request("GET", "/api/v1/grippers/h/state", ""), [0; 4096]);
    let _inside = crowd.inside();
    while stream.write_all(request.as_bytes()).await.is_ok() && stream.read(&mut buffer).await? > 0 {
        crowd.sent(1);
        sleep(POLLS_EVERY).await;
    }
    Ok(())
}

/// Asks for the lease, and moves the fingers, which only one client at a time can do.
async fn hold(crowd: &Crowd, mut stream: TcpStream) -> io::Result<()> {
    stream.write_all(upgrade(KEY).as_bytes()).await?;
    let lease = r#"{"jsonrpc": "2.0", "id": 1, "method": "lease", "params": {"gripper": "h"}}"#;
    let motion = r#"{"jsonrpc": "2.0", "id": 2, "method": "move", "params": {"gripper": "h", "width_mm": 20, "speed_mm_s": 50}}"#;
    let mut buffer = [0; 4096];
    let _inside = crowd.inside();
    for request in [lease, motion] {
        if stream.read(&mut buffer).await? == 0 {
            return Ok(());
        }
        stream.write_all(&frame(TEXT, request.as_bytes())).await?;
        crowd.sent(1);
    }
    while stream.read(&mut buffer).await? > 0 {}
    Ok(())
}

/// Sends half of a request.
async fn send_half(crowd: &Crowd, mut stream: TcpStream) -> io::Result<()> {
    stream
        .write_all(b"POST /api/v1/grippers/h/move HTTP/1.1\r\nHost: localhost\r\nContent-Length: 20\r\n\r\n{")
        .await?;
    let _inside = crowd.inside();
    while stream.read(&mut [0; 512]).await? > 0 {}
    Ok(())
}

/// Returns the duration of the soak.
pub fn soak_time() -> Duration {
    let seconds = std::env::var("SECONDS_OF_SOAK").map_or(DEFAULT_SECONDS, |value| value.parse().expect("a number"));
    Duration::from_secs(seconds)
}

/// Measurements of one period.
struct Period {
    highest: Usage,
    /// Times of the FAST STOPs over HTTP, sorted.
    times: Vec<Duration>,
}

impl Period {
    fn median(&self) -> Duration {
        self.times[STOPS / 2]
    }
}

/// Sends FAST STOPs over HTTP at even intervals, and then one over each other interface.
fn measured(gateway: &Gateway, probe: &mut Probe<'_>, lasts: Duration) -> Period {
    let measurement = gateway.measure();
    let mut times = Vec::new();
    for _ in 0..STOPS {
        let begun = Instant::now();
        let stop = probe.stops(Way::FreshHttp, 1);
        times.push(stop.percentile(100).expect("a FAST STOP over HTTP reached the device"));
        std::thread::sleep((lasts / STOPS as u32).saturating_sub(begun.elapsed()));
    }
    for way in Way::OTHERS {
        assert_eq!(probe.stops(way, 1).reached(), 1, "a FAST STOP over {way:?} reached the device");
    }
    times.sort_unstable();
    Period { highest: measurement.end(), times }
}

/// Returns the median of a value over some periods.
fn median<T: Ord + Copy>(periods: &[Period], value: impl Fn(&Period) -> T) -> T {
    let mut values: Vec<_> = periods.iter().map(value).collect();
    values.sort_unstable();
    values[values.len() / 2]
}

#[test]
fn soak_leaves_memory_descriptors_and_times_flat() {
    let (g, h) = (Device::start(), Device::start());
    let gateway = Gateway::with_journal_file(&g, &h);
    let mut probe = Probe::of(&gateway, &g);
    let poller = Poller::start(gateway.address);
    let before = gateway.usage();
    let mut clients = Attacker::start("come_and_go", CLIENTS, gateway.address);
    let lasts = soak_time() / PERIODS as u32;
    println!("| period of {lasts:?} | RSS MB | descriptors | FAST STOP p50 | max | connections so far |");
    let (mut periods, mut opened_before) = (Vec::new(), 0);
    for number in 1..=PERIODS {
        let period = measured(&gateway, &mut probe, lasts);
        let (Usage { rss_mb, descriptors }, Done { inside, opened, .. }) = (period.highest, clients.done());
        let (median, slowest) = (period.median(), period.times[STOPS - 1]);
        println!("| {number} | {rss_mb} | {descriptors} | {median:?} | {slowest:?} | {opened} |");
        assert!(inside > CLIENTS / 2 && opened > opened_before, "{inside} clients are there, {opened} came so far");
        assert!(median <= MEDIAN_WITHIN, "half of the FAST STOPs took longer than {median:?}");
        opened_before = opened;
        periods.push(period);
    }
    let polls = poller.end();
    drop(clients);
    let until = Instant::now() + NOTICES_WITHIN;
    while gateway.usage().descriptors > before.descriptors + POOLED && Instant::now() < until {
        std::thread::sleep(POLLS_EVERY);
    }
    let after = gateway.usage();
    println!("before {before:?}, after the clients have left {after:?}");
    assert!(after.descriptors <= before.descriptors + POOLED, "descriptors leak: {before:?} before, {after:?} after");
    assert_eq!(polls.lost, 0, "polls lost of {}, first: {:?}", polls.asked, polls.first_loss);
    let (early, late) = (&periods[QUARTER..2 * QUARTER], &periods[PERIODS - QUARTER..]);
    let pair = |value: fn(&Period) -> usize| (median(early, value), median(late, value));
    let (memory, descriptors) = (pair(|period| period.highest.rss_mb), pair(|period| period.highest.descriptors));
    let times = (median(early, Period::median), median(late, Period::median));
    println!("early and late: {memory:?} MB, {descriptors:?} descriptors, FAST STOP p50 {times:?}");
    assert!(memory.1 <= memory.0 + NOISE_MB, "memory grows: {memory:?} MB");
    // The highest number follows the load of the machine, which delays the end of connections.
    let most = descriptors.0 * (100 + NOISE_DESCRIPTORS_PERCENT) / 100;
    assert!(descriptors.1 <= most, "descriptors grow: {descriptors:?}");
    assert!(times.1 <= times.0 + NOISE_TIME, "FAST STOPs become slower: {times:?}");
}
