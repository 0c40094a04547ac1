//! The gateway is killed under traffic, at moments of chance: its journal opens and verifies each time, knows every
//! command that a client was told of, and its sequence only grows.
//!
//! `KILLS=1000 cargo test --test suite kills` kills more often.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use rand::RngExt;
use serde_json::{Value, json};
use wsg_gateway::gripper::model::{Command, Outcome};
use wsg_gateway::journal::{Journal, Place, Reader, Retention};

use crate::harness::{Answer, Gateway, run};

/// Kills in an ordinary run.
const DEFAULT_KILLS: u64 = 5;

/// How long the traffic goes on at most before the kill.
const LONGEST_TRAFFIC_MS: u64 = 1200;

/// How long before a kill an outcome may have been told that is not in the journal: its record waits for the disk.
const UNWRITTEN_FOR: Duration = Duration::from_millis(100);

/// What clients were told: of each command its newest outcome, if it had one, and when.
#[derive(Default)]
struct Told(BTreeMap<String, (Option<String>, Instant)>);

impl Told {
    fn take(&mut self, answer: &Answer) {
        if let Some(id) = answer.body["id"].as_str() {
            self.0.insert(id.to_owned(), (answer.body["outcome"].as_str().map(str::to_owned), Instant::now()));
        }
    }
}

/// Commands one after the other, without an end.
async fn traffic(gateway: &Gateway, told: &mut Told) {
    for path in ["home?wait_ms=0", "stop", "home?wait_ms=30", "stop"].into_iter().cycle() {
        told.take(&gateway.post(path, &json!({})).await);
    }
}

fn outcome_of(command: &Command) -> Option<String> {
    let outcome = serde_json::to_value(command.outcome).unwrap();
    (outcome != Value::Null).then(|| outcome.as_str().unwrap().to_owned())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_killed_gateway_s_journal_knows_every_command_that_was_told() {
    let kills = std::env::var("KILLS").map_or(DEFAULT_KILLS, |kills| kills.parse().expect("a number"));
    let directory = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-kills", std::process::id()));
    let path = directory.join("journal.db");
    let name = path.to_str().unwrap();
    let (mut told, mut last_seq, mut killed_at) = (Told::default(), 0, Vec::new());
    for _ in 0..kills {
        let gateway = Gateway::start(&["--gripper", "g=sim://wsg50", "--journal", name]).await;
        gateway.until_link("connected").await;
        let kill_after = Duration::from_millis(rand::rng().random_range(0..LONGEST_TRAFFIC_MS));
        // The moment is chance itself: there is nothing to wait for.
        let _ = tokio::time::timeout(kill_after, traffic(&gateway, &mut told)).await;
        killed_at.push(Instant::now());
        gateway.kill().await;
        let verified = run(&["journal", "verify", "--journal", name]).await;
        assert!(verified.status.success(), "{verified:?}");
        let reader = Reader::open(&path).unwrap();
        for id in told.0.keys() {
            let command = reader.command(&"g".parse().unwrap(), id.parse().unwrap()).unwrap();
            assert!(command.is_some(), "{id} was told, and is not in the journal");
        }
        let seq = reader.last_seq().unwrap();
        assert!(seq > last_seq, "{seq} after {last_seq}");
        last_seq = seq;
    }
    let (journal, _) = Journal::open(Place::File(path.clone()), Retention::default()).unwrap();
    let mut told_long_before = 0_u64;
    for (id, (outcome, at)) in &told.0 {
        let command = journal.command("g".parse().unwrap(), id.parse().unwrap()).await.unwrap().unwrap();
        let written = outcome_of(&command);
        let just_before = killed_at.iter().any(|killed| *at <= *killed && *killed <= *at + UNWRITTEN_FOR);
        let may_be_unknown = just_before && command.outcome == Some(Outcome::Unknown);
        let as_told = outcome.is_none() || *outcome == written || may_be_unknown;
        assert!(written.is_some() && as_told, "{id}: {outcome:?} was told, and {written:?} is written");
        told_long_before += u64::from(outcome.is_some() && !just_before);
    }
    journal.close().await.unwrap();
    assert!(told_long_before > kills, "of {told_long_before} outcomes it was asked whether they are in the journal");
    println!("{kills} kills, {} commands told, all of them in the journal, up to seq {last_seq}", told.0.len());
    assert!(told.0.len() as u64 > kills, "so little traffic shows nothing");
    std::fs::remove_dir_all(directory).unwrap();
}
