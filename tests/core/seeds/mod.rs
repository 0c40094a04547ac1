//! Seeded schedules of clients, device and faults on a virtual clock. The actor and its session run against the
//! simulated device. Every invariant is checked on the frames that leave and on those that the device received.
//!
//! `SEEDS=50000 cargo test seeds` runs more seeds; `FIRST_SEED=40000` leaves out those before it. `SEED=4711` runs only
//! that one, and prints its log.

pub mod client;
mod invariants;
mod journal;
mod leases;
mod own_changes;
pub mod schedule;
mod servo;
mod wire;
pub mod world;

use std::collections::BTreeMap;
use std::sync::mpsc;
use std::time::{Duration, Instant};

use world::World;

/// Number of seeds without `SEEDS`.
const DEFAULT_SEEDS: u64 = 1000;

const THREADS: u64 = 2;

/// Time limit of one seed, far above the fraction of a second that it takes.
const ENDS_WITHIN: Duration = Duration::from_mins(1);

/// Number of failed seeds at which the run ends. Until then it goes on, so that a long run lists several causes.
const MOST_FAILED: usize = 20;

fn variable(name: &str) -> Option<u64> {
    std::env::var(name).ok().map(|value| value.parse().expect("a number"))
}

#[test]
fn no_schedule_violates_an_invariant() {
    if let Some(seed) = variable("SEED") {
        let world = World::run(seed);
        println!("{}", world.log.join("\n"));
        return;
    }
    let begin = variable("FIRST_SEED").unwrap_or(0);
    let end = variable("SEEDS").unwrap_or(DEFAULT_SEEDS);
    assert!(begin < end, "no seeds from {begin} up to {end}");
    let (ended, results) = mpsc::channel();
    for first in begin..begin + THREADS {
        let ended = ended.clone();
        // Not joined, so that a hanging schedule fails this test instead of blocking it.
        std::thread::spawn(move || {
            for seed in (first..end).step_by(THREADS as usize) {
                let counts = std::panic::catch_unwind(|| World::run(seed).counts());
                if ended.send((seed, counts.ok())).is_err() {
                    return;
                }
            }
        });
    }
    let mut running: BTreeMap<u64, Instant> =
        (begin..end.min(begin + THREADS)).map(|seed| (seed, Instant::now())).collect();
    let mut total: BTreeMap<String, u64> = BTreeMap::new();
    let mut failed = Vec::new();
    while let Some((&slowest, begun)) = running.iter().min_by_key(|(_, begun)| **begun) {
        let Ok((seed, counts)) = results.recv_timeout(ENDS_WITHIN.saturating_sub(begun.elapsed())) else {
            panic!(
                "seed {slowest} did not end within {ENDS_WITHIN:?}: run with SEED={slowest}; seeds that fail: {failed:?}"
            );
        };
        match counts {
            Some(counts) => {
                for (name, count) in counts {
                    *total.entry(name).or_default() += count;
                }
            }
            None => failed.push(seed),
        }
        // One bug may break most seeds.
        assert!(
            failed.len() < MOST_FAILED,
            "stopped at seed {seed}, which fails like {failed:?}: run with SEED={seed}"
        );
        running.remove(&seed);
        if seed + THREADS < end {
            running.insert(seed + THREADS, Instant::now());
        }
    }
    assert!(failed.is_empty(), "seeds {failed:?} fail: run with SEED={} for the log of the first", failed[0]);
    println!("{} seeds, no violation found; events: {total:#?}", end - begin);
    let missing: Vec<_> = total.iter().filter(|&(_, &count)| count == 0).map(|(name, _)| name).collect();
    assert!(missing.is_empty(), "events that never happened, so remain untested: {missing:?}");
}

#[test]
fn same_seed_gives_the_same_log() {
    for seed in 0..20 {
        assert_eq!(World::run(seed).log, World::run(seed).log, "seed {seed}");
    }
}
