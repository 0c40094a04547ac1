//! Kills the gateway under traffic at random moments. Each time its journal opens and verifies, contains every command
//! that a client saw, and continues its sequence.
//!
//! `KILLS=1000 cargo test --test suite kills` kills more often.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use rand::RngExt;
use serde_json::{Value, json};
use wsg_gateway::journal::{Journal, JournalLocation, Reader, Retention};
use wsg_gateway::model::{CommandReport, Outcome};

use crate::harness::{Answer, Gateway, JournalFile, run};

/// Number of kills without `KILLS`.
const DEFAULT_KILLS: u64 = 5;

/// Maximum number of kills before a new journal begins. Each kill verifies the whole journal.
const KILLS_OF_A_JOURNAL: u64 = 50;

/// Longest traffic before a kill.
const LONGEST_TRAFFIC_MS: u64 = 1200;

/// Time before a kill in which a reported outcome can be missing from the journal: its record waits for the disk.
const UNWRITTEN_FOR: Duration = Duration::from_millis(100);

/// Newest outcome that a client saw of each command, if any, with its time.
#[derive(Default)]
struct Reported(BTreeMap<String, (Option<String>, Instant)>);

impl Reported {
    fn take(&mut self, answer: &Answer) {
        if let Some(id) = answer.body["id"].as_str() {
            self.0.insert(id.to_owned(), (answer.body["outcome"].as_str().map(str::to_owned), Instant::now()));
        }
    }
}

/// Sends commands one after another, without end.
async fn traffic(gateway: &Gateway, reported: &mut Reported) {
    for path in ["home?wait_ms=0", "stop", "home?wait_ms=30", "stop"].into_iter().cycle() {
        reported.take(&gateway.post(path, &json!({})).await);
    }
}

fn outcome_of(command: &CommandReport) -> Option<String> {
    let outcome = serde_json::to_value(command.outcome).unwrap();
    (outcome != Value::Null).then(|| outcome.as_str().unwrap().to_owned())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn killed_gateway_keeps_reported_commands() {
    let kills = std::env::var("KILLS").map_or(DEFAULT_KILLS, |kills| kills.parse().expect("a number"));
    assert!(kills > 0, "KILLS must be at least 1");
    let journals = kills.div_ceil(KILLS_OF_A_JOURNAL);
    for index in 0..journals {
        kill_repeatedly((kills + index) / journals).await;
    }
}

/// Kills gateways that use one journal, one after another.
async fn kill_repeatedly(kills: u64) {
    let journal = JournalFile::on_disk();
    let name = journal.path();
    let path = PathBuf::from(&name);
    let (mut reported, mut last_seq, mut killed_at) = (Reported::default(), 0, Vec::new());
    for _ in 0..kills {
        let gateway = Gateway::start(&["--gripper", "g=sim://wsg50", "--journal", &name]).await;
        gateway.until_link("connected").await;
        let kill_after = Duration::from_millis(rand::rng().random_range(0..LONGEST_TRAFFIC_MS));
        // The kill comes at a random moment, so nothing is waited for.
        let _ = tokio::time::timeout(kill_after, traffic(&gateway, &mut reported)).await;
        killed_at.push(Instant::now());
        gateway.kill().await;
        let verified = run(&["journal", "verify", "--journal", &name]).await;
        assert!(verified.status.success(), "{verified:?}");
        let reader = Reader::open(&path).unwrap();
        for id in reported.0.keys() {
            let command = reader.command(&"g".parse().unwrap(), id.parse().unwrap()).unwrap();
            assert!(command.is_some(), "{id} was reported, but is not in the journal");
        }
        let seq = reader.last_seq().unwrap();
        assert!(seq > last_seq, "{seq} after {last_seq}");
        last_seq = seq;
    }
    let (journal, _) = Journal::open(JournalLocation::File(path.clone()), Retention::default()).unwrap();
    let mut compared = 0_u64;
    for (id, (outcome, at)) in &reported.0 {
        let command = journal.command("g".parse().unwrap(), id.parse().unwrap()).await.unwrap().unwrap();
        let written = outcome_of(&command);
        let just_before = killed_at.iter().any(|killed| *at <= *killed && *killed <= *at + UNWRITTEN_FOR);
        let may_be_unknown = just_before && command.outcome == Some(Outcome::Unknown);
        let agrees = outcome.is_none() || *outcome == written || may_be_unknown;
        assert!(written.is_some() && agrees, "{id}: {outcome:?} was reported, but the journal has {written:?}");
        compared += u64::from(outcome.is_some() && !just_before);
    }
    journal.close().await.unwrap();
    assert!(compared > kills, "only {compared} outcomes could be compared");
    println!("{kills} kills, {} reported commands, all in the journal, up to seq {last_seq}", reported.0.len());
    assert!(reported.0.len() as u64 > kills, "too little traffic");
}
