//! `wsg-gateway journal` on a file that another process writes.

use std::path::Path;

use jiff::Timestamp;
use serde_json::json;
use tokio::sync::oneshot;
use wsg_gateway::gripper::recorder::{Record, Recorder as _};
use wsg_gateway::journal::{Journal, JournalLocation, Retention};
use wsg_gateway::model::{Detail, Event, GatewayEvent, Link, LinkEvent, Name};

use crate::harness::{Gateway, JournalFile, Process, Simulator, eventually, run};

async fn keep(journal: &Journal, second: i64, gripper: Option<&str>, detail: Detail) {
    let (notify, durable) = oneshot::channel();
    let gripper = gripper.map(|name| name.parse::<Name>().unwrap());
    let event = Event::new(Timestamp::from_second(second).unwrap(), gripper, detail);
    journal.record(Record::Event(event, Some(notify)));
    durable.await.unwrap();
}

fn started() -> Detail {
    Detail::Gateway(GatewayEvent::Started { version: "1.0.0", gateway: "cell-7".to_owned() })
}

fn link(link: Link, cause: Option<&str>) -> Detail {
    Detail::Link(LinkEvent { link, link_cause: cause.map(str::to_owned) })
}

/// Returns an open journal with three events.
async fn filled(file: &JournalFile) -> Journal {
    let (journal, _) = Journal::open(JournalLocation::File(file.path().into()), Retention::default()).unwrap();
    keep(&journal, 1000, None, started()).await;
    keep(&journal, 1001, Some("left"), link(Link::Connected, None)).await;
    keep(&journal, 1002, Some("right"), link(Link::Reconnecting, Some("reset, by \"peer\""))).await;
    journal
}

/// Starts a gateway with a simulated device and this journal, and homes the gripper.
async fn gateway(device: &Simulator, file: &JournalFile, on_failure: &str) -> Gateway {
    let gripper = format!("g=tcp://{}", device.address);
    let arguments = ["--gripper", &gripper, "--journal", &file.path()];
    let gateway = Gateway::with_file(&arguments, &format!("on_journal_failure = \"{on_failure}\"\n")).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    gateway
}

#[tokio::test]
async fn removed_or_replaced_journal_is_reported_and_blocks_motion() {
    for is_replaced in [false, true] {
        let (file, device) = (JournalFile::new(), Simulator::start(&[]).await);
        let gateway = gateway(&device, &file, "refuse").await;
        std::fs::remove_file(file.path()).unwrap();
        if is_replaced {
            std::fs::write(file.path(), "another file").unwrap();
        }
        let a_move = json!({"width_mm": 50, "speed_mm_s": 200});
        gateway.post("move", &a_move).await.problem(503, "journal_down");
        let state =
            gateway.until("the state reports the journal failure", |state| state["journal_cause"].is_string()).await;
        assert!(state["journal_cause"].as_str().unwrap().contains("restart the gateway"), "{state}");
        let refused = gateway.post("move", &a_move).await.problem(503, "journal_down");
        assert!(refused["detail"].as_str().unwrap().contains("journal.db was re"), "{refused}");
        let not_ready = gateway.get("/readyz").await;
        assert_eq!((not_ready.status, not_ready.field("journal_cause")), (503, &state["journal_cause"]));
        assert!(gateway.figures().await["wsg_journal_up"] < 1.0);
        let stopped = gateway.post("fast-stop", &json!({})).await.ok();
        assert_eq!(stopped["fast_stop_confirmed"], true);
        let ended = gateway.terminate().await;
        assert!(ended.stderr.contains("journal cannot be written"), "{ended:?}");
        if is_replaced {
            assert_eq!(std::fs::read(file.path()).unwrap(), b"another file");
        }
    }
}

#[tokio::test]
async fn motions_continue_without_a_journal_if_configured() {
    let (file, device) = (JournalFile::new(), Simulator::start(&[]).await);
    let gateway = gateway(&device, &file, "continue").await;
    std::fs::remove_file(file.path()).unwrap();
    gateway.until("the failure is reported", |state| state["journal_cause"].is_string()).await;
    gateway.post("move", &json!({"width_mm": 50, "speed_mm_s": 200})).await.outcome("SUCCESS");
    assert_eq!(gateway.get("/readyz").await.status, 503);
}

/// Output lines of a journal subcommand.
async fn output(file: &JournalFile, arguments: &[&str]) -> Vec<String> {
    let ended = run(&[&["journal", "--journal", &file.path()], arguments].concat()).await;
    assert!(ended.status.success(), "{arguments:?}: {ended:?}");
    ended.stdout.lines().map(str::to_owned).collect()
}

#[tokio::test]
async fn list_applies_its_filters() {
    let file = JournalFile::new();
    let _journal = filled(&file).await;
    assert_eq!(
        output(&file, &["list"]).await,
        [
            "1970-01-01T00:16:42.000Z        3  right      -                      link reconnecting        reset, by \"peer\"",
            "1970-01-01T00:16:41.000Z        2  left       -                      link connected",
            "1970-01-01T00:16:40.000Z        1  -          -                      gateway started",
        ]
    );
    for (arguments, expected) in [
        (&["--gripper", "left"][..], &["2"][..]),
        (&["--kind", "link", "--order", "oldest"], &["2", "3"]),
        (&["--from", "1970-01-01T00:16:41Z", "--to", "1970-01-01T00:16:42Z"], &["2"]),
        (&["--limit", "1"], &["3"]),
        (&["--outcome", "part_held"], &[]),
        (&["--part-id", "P-1", "--kind", "link"], &[]),
        (&["--grips"], &[]),
    ] {
        let lines = output(&file, &[&["list"], arguments].concat()).await;
        let seqs: Vec<_> = lines.iter().filter_map(|line| line.split_whitespace().nth(1)).collect();
        assert_eq!(seqs, expected, "{arguments:?}");
    }
    for command in ["list", "export"] {
        let ended = run(&["journal", "--journal", &file.path(), command, "--gripper", "middle"]).await;
        let expected = format!("no records match in {}: for another journal, pass --journal PATH", file.path());
        assert!(ended.status.success() && ended.stderr.starts_with(&expected), "{ended:?}");
    }
}

#[tokio::test]
async fn export_writes_json_and_csv() {
    let file = JournalFile::new();
    let _journal = filled(&file).await;
    let json = output(&file, &["export"]).await;
    assert_eq!(json.len(), 3);
    assert!(json[1].starts_with(r#"{"seq":2,"at":"1970-01-01T00:16:41.000Z","gripper":"left""#), "{json:?}");
    let csv = output(&file, &["export", "--format", "csv"]).await;
    assert!(csv[0].starts_with("seq,at,kind,gripper,subject,door,command_id,phase,"), "{csv:?}");
    assert!(csv[3].contains("\"reset, by \"\"peer\"\"\""), "{csv:?}");
    assert_eq!(csv.len(), 4);
    assert_eq!(output(&file, &["export", "--grips", "--format", "csv"]).await.len(), 1);
}

#[tokio::test]
async fn follow_prints_stored_and_new_events() {
    let file = JournalFile::new();
    let journal = filled(&file).await;
    let since = Process::start(&["journal", "--journal", &file.path(), "follow", "--after", "1"]);
    let left = Process::start(&["journal", "--journal", &file.path(), "follow", "--after", "0", "--gripper", "left"]);
    eventually("both print the stored events", async || (since.lines() == 2 && left.lines() == 1).then_some(())).await;
    keep(&journal, 1003, Some("right"), link(Link::Connected, None)).await;
    keep(&journal, 1004, Some("left"), link(Link::Unresponsive, Some("silent"))).await;
    eventually("both print the new events", async || (since.lines() == 4 && left.lines() == 2).then_some(())).await;
    assert!(left.stdout().ends_with("link unresponsive        silent"), "{}", left.stdout());
}

#[tokio::test]
async fn verify_finds_a_changed_event() {
    let file = JournalFile::new();
    let journal = filled(&file).await;
    let expected = ["3 events, 0 grip records, 0 persisted values: all intact"];
    assert_eq!(output(&file, &["verify"]).await, expected);
    journal.close().await.unwrap();
    let path = file.path();
    let mut bytes = std::fs::read(&path).unwrap();
    let name = bytes.windows(12).position(|window| window == b"reconnecting").unwrap();
    bytes[name] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let ended = run(&["journal", "--journal", &path, "verify"]).await;
    assert_eq!(ended.status.code(), Some(1), "{ended:?}");
    assert_eq!(ended.stdout, "events 3: changed since it was written (hash mismatch)");
    assert!(ended.stderr.contains("4 events, 0 grip records, 0 persisted values; findings: 1"), "{ended:?}");
}

#[tokio::test]
async fn wrong_argument_is_named_with_a_remedy() {
    let file = JournalFile::new();
    let _journal = filled(&file).await;
    let path = file.path();
    let none = Path::new(&path).with_file_name("none.db");
    for (arguments, expected) in [
        (&["--journal", none.to_str().unwrap(), "list"][..], "does not exist: pass --journal PATH, or --name NAME"),
        (&["--journal", ":memory:", "list"], "name a file"),
        (&["--journal", &path, "list", "--kind", "links"], "expected one of `command`, `fast_stop`"),
        (&["--journal", &path, "list", "--kind", "link", "--grips"], "expected one of `home`, `move`"),
        (&["--journal", &path, "list", "--from", "yesterday"], "--from yesterday"),
        (&["--journal", &path, "list", "--gripper", "Left"], "is not a valid name"),
        (&["--name", "Cell 7", "verify"], "is not a valid name"),
    ] {
        let ended = run(&[&["journal"], arguments].concat()).await;
        assert!(!ended.status.success() && ended.stderr.contains(expected), "{arguments:?}: {ended:?}");
    }
}
