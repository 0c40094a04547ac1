//! The Python example for Zenoh users. Its tests are excluded from plain `cargo test`, so that a machine without the
//! package does not count them as passed. Run them with `WSG_TEST_PYTHON=…/bin/python cargo test --test zenoh`, with
//! `eclipse-zenoh` installed there.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

#[path = "../suite/harness/mod.rs"]
#[allow(dead_code, unused_imports, reason = "parts used only by other tests")]
mod harness;

use std::process::Stdio;
use std::time::Instant;

use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt as _, BufReader};
use tokio::process::{Child, Command};
use tokio::time::timeout;

use harness::{DEADLINE, Gateway, Proxy, Simulator, eventually};

const FAST_STOP: u8 = 0x23;
const DISCONNECT_ANNOUNCEMENT: u8 = 0x07;

/// A gripper with a part of 20 mm in reach, behind a recording proxy.
struct Rig {
    _device: Simulator,
    proxy: Proxy,
    gateway: Gateway,
    endpoint: String,
}

impl Rig {
    async fn start() -> Self {
        let device = Simulator::with_part().await;
        let proxy = Proxy::to(device.address);
        let gateway = Gateway::connected_to(proxy.address).await;
        let endpoint = gateway.word_after("Zenoh: ").await;
        Self { _device: device, proxy, gateway, endpoint }
    }

    fn example(&self, name: &str, arguments: &[&str]) -> Child {
        let python = std::env::var("WSG_TEST_PYTHON").expect("WSG_TEST_PYTHON names a Python with eclipse-zenoh");
        let script = format!("{}/deploy/zenoh/{name}", env!("CARGO_MANIFEST_DIR"));
        let mut command = Command::new(python);
        command.env("PYTHONDONTWRITEBYTECODE", "1").arg(script).args(arguments);
        command.args(["--connect", &self.endpoint, "--gripper", "g"]);
        command.stdout(Stdio::piped()).stderr(Stdio::inherit()).kill_on_drop(true).spawn().unwrap()
    }

    /// Runs an example until it exits, and returns its output.
    async fn output(&self, name: &str, arguments: &[&str]) -> String {
        let ended = timeout(DEADLINE * 2, self.example(name, arguments).wait_with_output()).await;
        let ended = ended.expect("the example exits").unwrap();
        let output = String::from_utf8(ended.stdout).unwrap();
        assert!(ended.status.success(), "{name}: {output}");
        output
    }
}

#[tokio::test]
async fn example_watches_and_grips() {
    let rig = Rig::start().await;
    let output = rig.output("watch_and_grip.py", &["--speed-mm-s", "100"]).await;
    assert!(output.contains("grip: PART_HELD, "), "{output}");
    assert!(output.lines().filter(|line| line.contains(" mm ")).count() > 3, "the example prints updates: {output}");
    let state = rig.gateway.state().await;
    assert_eq!((&state["state"], &state["lease_holder"]), (&json!("HOLDING"), &Value::Null));
    assert_eq!(rig.proxy.frames.count(FAST_STOP), 0);
}

#[tokio::test]
async fn killed_example_leaves_a_fast_stop() {
    let rig = Rig::start().await;
    rig.gateway.post("home", &json!({"direction": "outer"})).await.outcome("SUCCESS");
    let mut example = rig.example("watch_and_grip.py", &["--speed-mm-s", "5"]);
    let mut lines = BufReader::new(example.stdout.take().unwrap()).lines();
    let line = timeout(DEADLINE, lines.next_line()).await.expect("the example grips").unwrap();
    assert!(line.is_some(), "the example prints updates");
    rig.gateway.until_moving().await;
    let killed = Instant::now();
    example.kill().await.unwrap();
    eventually("23h", async || rig.proxy.frames.first_since(FAST_STOP, killed)).await;
    let state = rig.gateway.until("the FAST STOP is confirmed", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!((&state["fast_stop_cause"], &state["lease_holder"]), (&json!("client_lost"), &Value::Null), "{state}");
    let event = rig.gateway.get("/api/v1/events?kind=lease&limit=1").await.ok()["events"][0].clone();
    assert_eq!(
        (&event["event"], &event["cause"], &event["door"]),
        (&json!("lost"), &json!("disconnected"), &json!("zenoh"))
    );
    assert_eq!(rig.proxy.frames.count(DISCONNECT_ANNOUNCEMENT), 0, "the gateway's own connection stays");
}
