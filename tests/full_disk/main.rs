//! A gateway whose disk fills up under traffic. It needs a file system of its own, which it mounts in a mount namespace
//! of its own, and so is not a part of plain `cargo test`: `tests/run` starts it, or
//! `unshare --map-root-user --mount cargo test --test full_disk`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

#[path = "../suite/harness/mod.rs"]
#[allow(dead_code, unused_imports, reason = "the other doubles are for the other tests")]
mod harness;

use std::collections::BTreeSet;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use wsg_gateway::journal::Reader;

use harness::{Answer, Gateway, Proxy, Simulator, eventually, run};

/// Twice what the journal's write-ahead log grows to.
const DISK_BYTES: usize = 8 << 20;

/// How soon a FAST STOP has to reach the device.
const FAST_STOP_WITHIN: Duration = Duration::from_millis(250);

/// How many FAST STOPs are asked for while the disk is full.
const FAST_STOPS: usize = 10;

/// How soon the journal goes on when there is room: it tries each second.
const GOES_ON_WITHIN: Duration = Duration::from_secs(5);

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

    /// Writes until nothing has room any more.
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
        // A gateway that a failed test leaves behind still has its files open.
        let _ = Command::new("umount").arg("--lazy").arg(&self.0).status();
        let _ = std::fs::remove_dir(&self.0);
    }
}

/// Motions one after the other, without an end. Whatever the disk does, each is a command or a problem of ours.
async fn traffic(gateway: &Gateway, told: &mut BTreeSet<String>) {
    for n in 0_u32.. {
        let a_move = json!({"width_mm": 40 + n % 2 * 20, "speed_mm_s": 400});
        for (path, body) in [("move?wait_ms=20", a_move), ("stop", json!({}))] {
            let Answer { status, body, .. } = gateway.post(path, &body).await;
            assert!(matches!(status, 200 | 202 | 409 | 503), "{status} {body}");
            told.extend(body["id"].as_str().map(str::to_owned));
        }
    }
}

async fn journal_fails(gateway: &Gateway) -> Value {
    gateway.until("the journal fails", |state| state["journal_cause"].is_string()).await
}

/// A FAST STOP, its way to the device, and its acknowledge: its id, and how long its frame took.
async fn fast_stop(gateway: &Gateway, proxy: &Proxy) -> (String, Duration) {
    let (before, asked_at) = (proxy.frames.count(0x23), Instant::now());
    let body = json!({"reason": "the disk is full"});
    let (stopped, reached_after) = tokio::join!(
        gateway.post("fast-stop", &body),
        eventually("it reaches the device", async || (proxy.frames.count(0x23) > before).then(|| asked_at.elapsed()))
    );
    let stopped = stopped.ok();
    assert_eq!(stopped["fast_stop_confirmed"], true, "{stopped}");
    gateway.post("acknowledge", &json!({"fast_stop_id": stopped["fast_stop_id"]})).await.ok();
    (stopped["fast_stop_id"].as_str().unwrap().to_owned(), reached_after)
}

/// While the disk is full.
async fn on_a_full_disk(gateway: &Gateway, proxy: &Proxy) -> Vec<String> {
    let state = journal_fails(gateway).await;
    let cause = state["journal_cause"].as_str().unwrap();
    assert!(cause.contains("journal.db") && cause.contains("full") && cause.contains("make room"), "{cause}");
    let not_ready = gateway.get("/readyz").await;
    assert_eq!((not_ready.status, not_ready.text("journal_cause").as_str()), (503, cause), "{not_ready:?}");
    assert_eq!(not_ready.field("not_ready"), &json!([]), "the gripper is not the reason");
    let figures = gateway.figures().await;
    assert!(figures["wsg_journal_up"] < 1.0 && figures["wsg_link_up{gripper=\"g\"}"] > 0.0, "{figures:#?}");

    // What was written down before runs on.
    gateway.until("nothing runs", |state| state["command"].is_null()).await;
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
    assert_eq!(proxy.frames.motions(), motions, "nothing moves that is not written down");
    ids
}

/// Reads back what clients were told of: nothing of it may be missing.
fn check_journal(path: &Path, told: &BTreeSet<String>) {
    let reader = Reader::open(path).unwrap();
    for id in told {
        let command = reader.command(&"g".parse().unwrap(), id.parse().unwrap()).unwrap();
        assert!(
            command.is_some_and(|command| command.outcome.is_some()),
            "{id} was told, and has no end in the journal"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_full_disk_refuses_motions_and_never_a_fast_stop_and_the_journal_goes_on_when_there_is_room() {
    let disk = Disk::mount();
    let path = disk.0.join("journal.db");
    let journal = path.to_str().unwrap();
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gripper = format!("g=tcp://{}", proxy.address);
    let gateway = Gateway::start(&["--gripper", &gripper, "--journal", journal]).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");

    let mut told = BTreeSet::new();
    let fast_stops = {
        let scenario = async {
            let motions = proxy.frames.motions();
            eventually("traffic", async || (proxy.frames.motions() > motions + 5).then_some(())).await;
            disk.fill();
            let fast_stops = on_a_full_disk(&gateway, &proxy).await;

            disk.make_room();
            let (room_since, motions) = (Instant::now(), proxy.frames.motions());
            eventually("motions go on", async || (proxy.frames.motions() > motions).then_some(())).await;
            let went_on_after = room_since.elapsed();
            println!("the journal went on {went_on_after:?} after there was room");
            assert!(went_on_after <= GOES_ON_WITHIN, "{went_on_after:?}");
            fast_stops
        };
        tokio::select! {
            () = traffic(&gateway, &mut told) => unreachable!("it has no end"),
            fast_stops = scenario => fast_stops,
        }
    };
    eventually("it is ready", async || (gateway.get("/readyz").await.status == 200).then_some(())).await;
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
    check_journal(&path, &told);
    println!("{} commands were told, all of them in the journal", told.len());
    assert!(told.len() > 5, "so little traffic shows nothing");
}
