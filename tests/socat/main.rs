//! Tests that need socat as a serial adapter that can be pulled, and as a client machine that can be frozen with
//! SIGSTOP. They are excluded from plain `cargo test`, so that a machine without socat does not count them as passed.
//! Run them with `cargo test --test socat`.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

#[path = "../suite/harness/mod.rs"]
#[allow(dead_code, unused_imports, reason = "parts used only by other tests")]
mod harness;

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, BufReader};
use tokio::process::ChildStderr;

use harness::child::{Child, Signal};
use harness::{Directory, Gateway, Process, Proxy, Simulator, eventually};

/// Plugs in an adapter between this pty and that port.
async fn plug_in(pty: &Path, port: &Path) -> Child {
    let mut command = Command::new("socat");
    command.arg(format!("pty,raw,echo=0,link={}", pty.display())).arg(format!("{},raw,echo=0", port.display()));
    let (adapter, ..) = Child::start(&mut command);
    eventually("the adapter's pty", async || pty.exists().then_some(())).await;
    adapter
}

#[tokio::test]
async fn pulled_adapter_is_named_and_reconnected() {
    let files = Directory::new();
    let [line, port] = ["line", "port"].map(|name| PathBuf::from(files.file(name)));
    let device = Process::start(&["sim", &format!("serial://pty?link={}", line.display())]);
    device.word_after("a simulated wsg50 at ").await;
    let mut adapter = plug_in(&port, &line).await;
    let gateway = Gateway::start(&["--gripper", &format!("g=serial://{}", port.display())]).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");

    adapter.kill();
    adapter.ended().await;
    let state = gateway.until_link("reconnecting").await;
    let cause = state["link_cause"].as_str().unwrap();
    assert!(cause.contains(port.to_str().unwrap()), "{cause}");
    gateway.post("home", &json!({})).await.problem(503, "link_down");
    // After the next attempt, the cause names the missing device.
    gateway
        .until("absent", |state| state["link_cause"].as_str().is_some_and(|cause| cause.contains("does not exist")))
        .await;

    // A killed socat leaves its symbolic link behind.
    std::fs::remove_file(&port).unwrap();
    let _adapter = plug_in(&port, &line).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
}

/// Starts a relay between one client and the gateway, and returns its address. Bytes sent while it is frozen arrive
/// when it thaws.
async fn between(gateway: &Gateway) -> (Child, String) {
    let target = gateway.url("/").replace("http://", "TCP:").trim_end_matches('/').to_owned();
    let mut command = Command::new("socat");
    command.args(["-d", "-d", "TCP-LISTEN:0,bind=127.0.0.1", &target]).stderr(Stdio::piped());
    let (child, _, stderr) = Child::start(&mut command);
    let mut lines = BufReader::new(ChildStderr::from_std(stderr.unwrap()).unwrap()).lines();
    loop {
        let line = lines.next_line().await.unwrap().expect("socat listens");
        if let Some((_, address)) = line.split_once("listening on AF=2 ") {
            // socat keeps logging, so its output must be drained.
            tokio::spawn(async move { while let Ok(Some(_)) = lines.next_line().await {} });
            return (child, address.trim().to_owned());
        }
    }
}

#[tokio::test]
async fn client_frozen_past_its_lease_moves_nothing() {
    let device = Simulator::start(&[]).await;
    let proxy = Proxy::to(device.address);
    let gateway = Gateway::homed_at(proxy.address).await;
    let (frozen, address) = between(&gateway).await;
    let http = reqwest::Client::builder().pool_max_idle_per_host(1).build().unwrap();
    let post = async |path: &str, body: Value| {
        let answer = http.post(format!("http://{address}/api/v1/grippers/g/{path}")).json(&body).send().await.unwrap();
        answer.json::<Value>().await.unwrap()
    };
    let lease = post("lease", json!({"holder": "a", "ttl_ms": 300})).await;
    frozen.signal(Signal::STOP);

    let thawed = post("move", json!({"width_mm": 10, "speed_mm_s": 50, "lease": lease["token"]}));
    let meanwhile = async {
        gateway.until("the lease has expired", |state| state["lease_holder"].is_null()).await;
        let taken = gateway.post("lease", &json!({"holder": "b", "ttl_ms": 60000})).await.ok();
        let body = json!({"width_mm": 90, "speed_mm_s": 200, "lease": taken["token"]});
        gateway.post("move", &body).await.outcome("SUCCESS");
        let motions = proxy.frames.motions();
        frozen.signal(Signal::CONT);
        motions
    };
    let (refused, motions) = tokio::join!(thawed, meanwhile);
    assert_eq!((&refused["code"], &refused["holder"]), (&json!("stale_lease"), &json!("b")), "{refused}");
    assert_eq!(proxy.frames.motions(), motions, "no motion reaches the device");
}
