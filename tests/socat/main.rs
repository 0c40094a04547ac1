//! RS-232 through socat, which stands for an adapter that is pulled and comes back. Not a part of plain `cargo test`, so
//! that a machine without socat never counts it as passed: `cargo test --test socat`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

#[path = "../suite/harness/mod.rs"]
#[allow(dead_code, unused_imports, reason = "the other doubles are for the other tests")]
mod harness;

use std::path::{Path, PathBuf};

use serde_json::json;
use tokio::process::{Child, Command};

use harness::process::Process;
use harness::{Gateway, eventually};

fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-{name}", std::process::id()))
}

/// An adapter whose ends are this pty and that port.
async fn plug_in(pty: &Path, port: &Path) -> Child {
    let mut command = Command::new("socat");
    command.arg(format!("pty,raw,echo=0,link={}", pty.display())).arg(format!("{},raw,echo=0", port.display()));
    let adapter = command.kill_on_drop(true).spawn().expect("socat has to be installed");
    eventually("the adapter's pty", async || pty.exists().then_some(())).await;
    adapter
}

#[tokio::test]
async fn a_pulled_adapter_is_named_and_comes_back() {
    let (line, port) = (path("line"), path("port"));
    let device = Process::start(&["sim", &format!("serial://pty?link={}", line.display())]);
    device.word_after("a simulated wsg50 at ").await;
    let mut adapter = plug_in(&port, &line).await;
    let gateway = Gateway::start(&["--gripper", &format!("g=serial://{}", port.display())]).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");

    adapter.kill().await.unwrap();
    let state = gateway.until_link("reconnecting").await;
    let cause = state["link_cause"].as_str().unwrap();
    assert!(cause.contains(port.to_str().unwrap()), "{cause}");
    gateway.post("home", &json!({})).await.problem(503, "link_down");
    // It says what is there instead, once it has tried again.
    gateway
        .until("absent", |state| state["link_cause"].as_str().is_some_and(|cause| cause.contains("not there")))
        .await;

    // A killed socat leaves its link behind.
    std::fs::remove_file(&port).unwrap();
    let _adapter = plug_in(&port, &line).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
}
