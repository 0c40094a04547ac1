//! Seeded schedules of clients, device and faults on a virtual clock. The actor and its session run against the
//! simulated device. Every invariant is checked on the frames that leave and on those that the device received.
//!
//! `SEEDS=1000000 cargo test --release seeds` runs more seeds; `SEED=4711` runs only that one, and prints its log.

pub mod client;
mod invariants;
mod journal;
mod leases;
pub mod schedule;
mod wire;
pub mod world;

use std::collections::BTreeMap;

use world::World;

/// Number of seeds without `SEEDS`.
const DEFAULT_SEEDS: u64 = 1000;

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
    let seeds = variable("SEEDS").unwrap_or(DEFAULT_SEEDS);
    let threads = 2;
    let counts: Vec<_> = std::thread::scope(|scope| {
        let run = |first| {
            scope.spawn(move || {
                let mut counts = BTreeMap::new();
                for seed in (first..seeds).step_by(threads) {
                    let ran = std::panic::catch_unwind(|| World::run(seed).counts());
                    let ran = ran.unwrap_or_else(|_| panic!("seed {seed} fails: run with SEED={seed} for its log"));
                    for (name, count) in ran {
                        *counts.entry(name).or_insert(0) += count;
                    }
                }
                counts
            })
        };
        let running: Vec<_> = (0..threads as u64).map(run).collect();
        running.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    let mut total: BTreeMap<String, u64> = BTreeMap::new();
    for (name, count) in counts.into_iter().flatten() {
        *total.entry(name).or_default() += count;
    }
    println!("{seeds} seeds, no violation found; events: {total:#?}");
    let missing: Vec<_> = total.iter().filter(|&(_, &count)| count == 0).map(|(name, _)| name).collect();
    assert!(missing.is_empty(), "events that never happened, so remain untested: {missing:?}");
}

#[test]
fn same_seed_gives_the_same_log() {
    for seed in 0..20 {
        assert_eq!(World::run(seed).log, World::run(seed).log, "seed {seed}");
    }
}
