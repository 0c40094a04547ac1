//! A gateway whose disk fills up under traffic. The test mounts a file system in its own mount namespace, so it is
//! excluded from plain `cargo test`. `tests/run` starts it; by hand: `unshare --map-root-user --mount cargo test --test
//! full_disk`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

#[path = "../suite/harness/mod.rs"]
#[allow(dead_code, unused_imports, reason = "parts used only by other tests")]
mod harness;

use std::collections::BTreeSet;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use wsg_gateway::journal::Reader;

use harness::{Answer, Gateway, Proxy, Simulator, eventually, run};

/// Twice the size of the journal's write-ahead log.
const DISK_BYTES: usize = 8 << 20;

/// Time limit of a FAST STOP to the device.
const FAST_STOP_WITHIN: Duration = Duration::from_millis(250);

/// Number of FAST STOPs while the disk is full.
const FAST_STOPS: usize = 10;

/// Time for the journal to recover once there is room: it retries each second.
const RECOVERS_WITHIN: Duration = Duration::from_secs(5);

/// A small file system in memory.
struct Disk(PathBuf);

impl Disk {
    fn mount() -> Self {
        let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-full-disk", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        let size = format!("size={DISK_BYTES}");
        let mounted = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(&path).status();
        assert!(mounted.unwrap().success(), "mounting needs a namespace: unshare --map-root-user --mount …");
        Self(path)
    }

    fn filler(&self) -> PathBuf {
        self.0.join("filler")
    }

    /// Writes until the disk is full.
    fn fill(&self) {
        let mut file = std::fs::File::create(self.filler()).unwrap();
        let full = loop {
            if let Err(error) = file.write_all(&[0; 4096]) {
                break error;
            }
        };
        assert_eq!(full.kind(), std::io::ErrorKind::StorageFull, "{full}");
    }

    fn make_room(&self) {
        std::fs::remove_file(self.filler()).unwrap();
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        // After a failed test, a gateway may still have files open.
        let _ = Command::new("umount").arg("--lazy").arg(&self.0).status();
        let _ = std::fs::remove_dir(&self.0);
    }
}

/// Sends motions one after another, without end. Each must be a command or a problem of the gateway.
async fn traffic(gateway: &Gateway, reported: &mut BTreeSet<String>) {
    for n in 0_u32.. {
        let a_move = json!({"width_mm": 40 + n % 2 * 20, "speed_mm_s": 400});
        for (path, body) in [("move?wait_ms=20", a_move), ("stop", json!({}))] {
            let Answer { status, body, .. } = gateway.post(path, &body).await;
            assert!(matches!(status, 200 | 202 | 409 | 503), "{status} {body}");
            reported.extend(body["id"].as_str().map(str::to_owned));
        }
    }
}

async fn journal_fails(gateway: &Gateway) -> Value {
    gateway.until("the journal failure is reported", |state| state["journal_cause"].is_string()).await
}

/// Requests and acknowledges a FAST STOP, and returns its id and the time until the device has it.
async fn fast_stop(gateway: &Gateway, proxy: &Proxy) -> (String, Duration) {
    let (before, asked_at) = (proxy.frames.count(0x23), Instant::now());
    let body = json!({"reason": "the disk is full"});
    let (stopped, reached_after) = tokio::join!(
        gateway.post("fast-stop", &body),
        eventually("23h reaches the device", async || (proxy.frames.count(0x23) > before).then(|| asked_at.elapsed()))
    );
    let stopped = stopped.ok();
    assert_eq!(stopped["fast_stop_confirmed"], true, "{stopped}");
    gateway.post("acknowledge", &json!({"fast_stop_id": stopped["fast_stop_id"]})).await.ok();
    (stopped["fast_stop_id"].as_str().unwrap().to_owned(), reached_after)
}

/// Checks the gateway while the disk is full.
async fn on_a_full_disk(gateway: &Gateway, proxy: &Proxy) -> Vec<String> {
    let state = journal_fails(gateway).await;
    let cause = state["journal_cause"].as_str().unwrap();
    assert!(cause.contains("journal.db") && cause.contains("full") && cause.contains("make room"), "{cause}");
    let not_ready = gateway.get("/readyz").await;
    assert_eq!((not_ready.status, not_ready.text("journal_cause").as_str()), (503, cause), "{not_ready:?}");
    assert_eq!(not_ready.field("not_ready"), &json!([]), "the gripper is not the reason");
    let figures = gateway.figures().await;
    assert!(figures["wsg_journal_up"] < 1.0 && figures["wsg_link_up{gripper=\"g\"}"] > 0.0, "{figures:#?}");

    // A motion that is already recorded continues.
    gateway.until("no command is running", |state| state["command"].is_null()).await;
    let motions = proxy.frames.motions();
    for path in ["move", "grip", "release"] {
        let refused = gateway.post(path, &json!({"width_mm": 50, "speed_mm_s": 50})).await.problem(503, "journal_down");
        assert!(refused["detail"].as_str().unwrap().contains("full"), "{refused}");
    }
    gateway.post("home", &json!({})).await.problem(503, "journal_down");

    let (mut ids, mut slowest) = (Vec::new(), Duration::ZERO);
    for _ in 0..FAST_STOPS {
        let (id, reached_after) = fast_stop(gateway, proxy).await;
        slowest = slowest.max(reached_after);
        ids.push(id);
    }
    println!("on a full disk the slowest of {FAST_STOPS} FAST STOPs reached the device after {slowest:?}");
    assert!(slowest <= FAST_STOP_WITHIN, "{slowest:?}");
    assert_eq!(proxy.frames.motions(), motions, "no motion without a record");
    ids
}

/// Checks that `doctor` names the full disk and its remedy.
async fn doctor_names_the_disk(journal: &str) {
    let flags = ["--listen", "127.0.0.1:0", "--gripper", "g=sim://wsg50", "--zenoh-mode", "off", "--journal", journal];
    let ended = run(&[&["doctor"][..], &flags].concat()).await;
    let problems: Vec<_> = ended.stdout.lines().filter(|line| line.starts_with("PROBLEM")).collect();
    let [problem] = problems[..] else { panic!("not one problem: {ended:?}") };
    assert!(problem.contains("disk") && problem.contains("0 MB are free") && problem.contains("free some space"));
    assert!(!ended.status.success(), "{ended:?}");
}

/// Checks that the journal has every command that a client saw.
fn check_journal(path: &Path, reported: &BTreeSet<String>) {
    let reader = Reader::open(path).unwrap();
    for id in reported {
        let command = reader.command(&"g".parse().unwrap(), id.parse().unwrap()).unwrap();
        assert!(
            command.is_some_and(|command| command.outcome.is_some()),
            "{id} was reported, but has no end in the journal"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn full_disk_blocks_motion_but_not_fast_stop() {
    let disk = Disk::mount();
    let path = disk.0.join("journal.db");
    let journal = path.to_str().unwrap();
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gripper = format!("g=tcp://{}", proxy.address);
    let gateway = Gateway::start(&["--gripper", &gripper, "--journal", journal]).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");

    let mut reported = BTreeSet::new();
    let fast_stops = {
        let scenario = async {
            let motions = proxy.frames.motions();
            eventually("traffic", async || (proxy.frames.motions() > motions + 5).then_some(())).await;
            disk.fill();
            let fast_stops = on_a_full_disk(&gateway, &proxy).await;
            doctor_names_the_disk(journal).await;

            disk.make_room();
            let (room_since, motions) = (Instant::now(), proxy.frames.motions());
            eventually("motions resume", async || (proxy.frames.motions() > motions).then_some(())).await;
            let recovered_after = room_since.elapsed();
            println!("the journal recovered {recovered_after:?} after there was room");
            assert!(recovered_after <= RECOVERS_WITHIN, "{recovered_after:?}");
            fast_stops
        };
        tokio::select! {
            () = traffic(&gateway, &mut reported) => unreachable!("the traffic does not end"),
            fast_stops = scenario => fast_stops,
        }
    };
    eventually("the gateway is ready", async || (gateway.get("/readyz").await.status == 200).then_some(())).await;
    assert_eq!(gateway.state().await["journal_cause"], Value::Null);
    let figures = gateway.figures().await;
    assert!(figures["wsg_journal_up"] > 0.0 && figures["wsg_journal_records_lost_total"] < 1.0, "{figures:#?}");
    let events = gateway.get("/api/v1/events?kind=fast_stop&limit=100").await.ok();
    for id in fast_stops {
        let latched = |event: &Value| event["event"] == "latched" && event["fast_stop_id"] == json!(id);
        assert!(events["events"].as_array().unwrap().iter().any(latched), "{id} is not in {events}");
    }

    let ended = gateway.terminate().await;
    assert!(ended.status.success() && !ended.stderr.contains("panicked"), "{ended:?}");
    assert!(ended.stderr.contains("journal cannot be written"), "{ended:?}");
    let verified = run(&["journal", "verify", "--journal", journal]).await;
    assert!(verified.status.success() && verified.stdout.contains("all intact"), "{verified:?}");
    check_journal(&path, &reported);
    println!("{} reported commands, all in the journal", reported.len());
    assert!(reported.len() > 5, "too little traffic");
}
