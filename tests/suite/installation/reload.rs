//! Reading the configuration again while the gateway runs.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use serde_json::{Value, json};

use crate::harness::wsg::{Driver, PENDING, move_to};
use crate::harness::{Gateway, Simulator, Socket, eventually, run};

/// A gateway and its configuration file.
pub struct Configured {
    file: PathBuf,
    pub gateway: Gateway,
}

impl Drop for Configured {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.file);
    }
}

impl Configured {
    pub async fn start(toml: &str) -> Self {
        let file = std::env::temp_dir().join(format!("wsg-reload-{}.toml", uuid::Uuid::now_v7()));
        std::fs::write(&file, toml).unwrap();
        let gateway = Gateway::start(&["--config", file.to_str().unwrap(), "--zenoh-listen", "tcp/127.0.0.1:0"]).await;
        Self { file, gateway }
    }

    /// Reloads this configuration, and returns the changes.
    pub async fn reload(&self, toml: &str) -> Value {
        self.try_reload(toml).await.ok()["changes"].clone()
    }

    async fn try_reload(&self, toml: &str) -> crate::harness::Answer {
        std::fs::write(&self.file, toml).unwrap();
        self.gateway.send(self.gateway.request("POST", "/api/v1/reload").json(&json!({}))).await
    }

    async fn names(&self) -> Vec<String> {
        let list = self.gateway.send(self.gateway.request("GET", "/api/v1/grippers")).await.ok();
        list["grippers"].as_array().unwrap().iter().map(|one| one["gripper"].as_str().unwrap().to_owned()).collect()
    }
}

fn gripper(name: &str, rest: &str) -> String {
    format!("[grippers.{name}]\nurl = \"sim://wsg50\"\n{rest}\n")
}

#[tokio::test]
async fn grippers_are_added_removed_and_changed_without_touching_the_others() {
    let g = gripper("g", "");
    let one = Configured::start(&format!("{g}{}", gripper("h", ""))).await;
    let gateway = &one.gateway;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let mut socket = Socket::open(gateway).await;
    socket.call("subscribe", json!({"topics": ["state"]})).await;
    let id = gateway.begin("move", &json!({"width_mm": 10, "speed_mm_s": 20})).await;

    assert_eq!(
        one.reload(&format!("{g}{}", gripper("k", ""))).await,
        json!(["gripper h: removed", "gripper k: added"])
    );
    assert_eq!(one.names().await, ["g", "k"]);
    socket.notification("state", |update| update["gripper"] == "k").await;
    let slower = gripper("k", "motion_pause_ms = 100\nwsg_port = \"127.0.0.1:0\"");
    assert_eq!(one.reload(&format!("{g}{slower}")).await, json!(["gripper k: changed", "gripper k: WSG port changed"]));
    assert_eq!(one.reload(&format!("{g}{slower}")).await, json!([]));
    gateway.command(&id).await.ok();
    let ended = gateway.send(gateway.request("GET", &format!("/api/v1/grippers/g/commands/{id}?wait_ms=20000"))).await;
    ended.outcome("SUCCESS");
    let figures = gateway.figures().await;
    assert!(!figures.keys().any(|name| name.contains("gripper=\"h\"")), "the removed gripper has no metrics");
    assert!(figures.keys().any(|name| name.contains("wsg_link_up{gripper=\"k\"")));
    let reloaded = gateway.events("kind=gateway", 3).await;
    let last = &reloaded[0];
    assert_eq!((&last["event"], &last["subject"]), (&"reloaded".into(), &"http:127.0.0.1".into()), "{last}");
}

#[tokio::test]
async fn unusable_configuration_changes_nothing() {
    let g = gripper("g", "");
    let one = Configured::start(&g).await;
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap();
    for (toml, expected) in [
        (format!("nonsense = 1\n{g}"), "nonsense"),
        (format!("name = \"other\"\n{g}"), "name cannot change while the gateway runs"),
        (String::new(), "the configured grippers (the new file names none) cannot change"),
        (format!("{g}[access]\n"), "whether clients need credentials, cannot change"),
        (format!("{g}{}", gripper("h", &format!("wsg_port = \"{port}\""))), "cannot listen on"),
        (
            format!("{g}{}[tls]\ncertificate = \"none.pem\"\nkey = \"none.pem\"", gripper("h", "")),
            "whether connections are encrypted",
        ),
    ] {
        let refused = one.try_reload(&toml).await.problem(409, "invalid_configuration");
        assert!(refused["detail"].as_str().unwrap().contains(expected), "{refused}");
        assert_eq!(one.names().await, ["g"]);
    }
}

#[tokio::test]
async fn reload_that_needs_a_restart_names_each_key_and_applies_nothing() {
    let g = gripper("g", "modbus_unit = 1");
    let modbus = "modbus = \"127.0.0.1:0\"\n";
    let one = Configured::start(&format!("{modbus}{g}")).await;
    let more = gripper("h", "modbus_unit = 2");
    for (toml, expected) in [
        (format!("name = \"other\"\n{modbus}{g}{more}"), "name cannot change"),
        (format!("journal_max_age_days = 3\n{modbus}{g}{more}"), "journal_max_age_days cannot change"),
        (format!("journal_max_size_mb = 3\n{modbus}{g}{more}"), "journal_max_size_mb cannot change"),
        (format!("public_url = \"https://cell-7.example\"\n{modbus}{g}{more}"), "public_url cannot change"),
        (format!("{g}{more}"), "modbus cannot change"),
        (
            format!("{modbus}{}{}", gripper("g", "modbus_unit = 3"), gripper("h", "modbus_unit = 1")),
            "modbus_unit (another gripper had this unit) cannot change",
        ),
        (format!("{modbus}{g}{more}[zenoh]\nmax_hz = 7\n"), "[zenoh] cannot change"),
        (format!("{modbus}{g}{more}[access]\n"), "[access], or whether clients need credentials, cannot change"),
        (
            format!("name = \"other\"\npublic_url = \"https://cell-7.example\"\n{modbus}{g}{more}"),
            "name, public_url cannot change while the gateway runs: restart it",
        ),
    ] {
        let refused = one.try_reload(&toml).await.problem(409, "invalid_configuration");
        assert!(refused["detail"].as_str().unwrap().contains(expected), "{refused}");
        assert_eq!(one.names().await, ["g"], "{expected}");
    }
}

#[tokio::test]
async fn changed_device_is_left_cleanly() {
    let [first, second] = [Simulator::start(&[]).await, Simulator::start(&[]).await];
    let toml = |device: &Simulator| format!("[grippers.g]\nurl = \"tcp://{}\"\n", device.address);
    let one = Configured::start(&toml(&first)).await;
    one.gateway.until_link("connected").await;
    one.gateway.post("fast-stop", &json!({})).await.ok();
    assert_eq!(one.reload(&toml(&second)).await, json!(["gripper g: changed"]));
    one.gateway.until_link("connected").await;
    let state = one.gateway.state().await;
    assert_eq!(state["fast_stop"], true, "the latch stays: {state}");
    let mut driver = Driver::connect(first.address).await;
    assert_eq!(driver.flags().await & 1 << 12, 1 << 12, "FAST STOP of the client");
    driver.leave().await;
}

#[tokio::test]
async fn device_can_move_after_its_gripper_is_removed() {
    let [first, second] = [Simulator::start(&[]).await, Simulator::start(&[]).await];
    let at = |name: &str, device: &Simulator| format!("[grippers.{name}]\nurl = \"tcp://{}\"\n", device.address);
    let one = Configured::start(&[at("g", &first), at("h", &second)].concat()).await;
    one.gateway.until_link("connected").await;
    let swapped = [at("g", &second), at("h", &first)].concat();
    let refused = one.try_reload(&swapped).await.problem(409, "invalid_configuration");
    let expected = format!("g cannot use tcp://{} yet, because h uses that device", second.address);
    assert!(refused["detail"].as_str().unwrap().contains(&expected), "{refused}");
    assert_eq!(one.reload(&at("g", &first)).await, json!(["gripper h: removed"]));
    assert_eq!(one.reload(&at("g", &second)).await, json!(["gripper g: changed"]));
    assert_eq!(one.reload(&swapped).await, json!(["gripper h: added"]));
    one.gateway.until_link("connected").await;
    // An added gripper can have the device that another leaves.
    assert_eq!(one.reload(&at("g", &second)).await, json!(["gripper h: removed"]));
    let passed_on = [at("g", &first), at("k", &second)].concat();
    assert_eq!(one.reload(&passed_on).await, json!(["gripper k: added", "gripper g: changed"]));
    one.gateway.until_link("connected").await;
}

#[tokio::test]
async fn added_gripper_has_time_to_connect_before_its_alarm() {
    // Nothing listens there.
    let at = |name: &str, port: u16| format!("[grippers.{name}]\nurl = \"tcp://127.0.0.1:{port}\"\n");
    let one = Configured::start(&at("g", 1)).await;
    let not_reached = async |gripper: &str| {
        eventually("the alarm is raised", async || {
            let list = one.gateway.send(one.gateway.request("GET", "/api/v1/alarms")).await.ok();
            list["alarms"].as_array().unwrap().iter().find(|alarm| alarm["gripper"] == gripper).cloned()
        })
        .await
    };
    assert_eq!(not_reached("g").await["alarm"], "not_reached");
    one.reload(&[at("g", 1), at("h", 2)].concat()).await;
    let alarm = not_reached("h").await;
    let reloaded = &one.gateway.events("kind=gateway", 3).await[0];
    let time = |value: &Value| value.as_str().unwrap().parse::<jiff::Timestamp>().unwrap();
    let after = time(&alarm["began_at"]).duration_since(time(&reloaded["at"]));
    assert!(after.as_secs_f64() > 2.5, "{after} after the reload");
}

#[tokio::test]
async fn port_keeps_its_socket_when_its_rules_change() {
    let port = |rest: &str| gripper("g", &format!("wsg_port = \"127.0.0.1:0\"\n{rest}"));
    let one = Configured::start(&port("")).await;
    let address = one.gateway.word_after("WSG port of g: tcp://").await.parse().unwrap();
    one.gateway.until_link("connected").await;
    Driver::connect(address).await.leave().await;
    assert_eq!(one.reload(&port("wsg_port_allow = [\"192.0.2.0/24\"]")).await, json!(["gripper g: WSG port changed"]));
    let mut refused = tokio::net::TcpStream::connect(address).await.unwrap();
    let read = tokio::io::AsyncReadExt::read(&mut refused, &mut [0; 8]).await;
    assert!(matches!(read, Ok(0) | Err(_)), "{read:?}");
    one.reload(&port("")).await;
    Driver::connect(address).await.leave().await;
    let changes = one.reload(&port("wsg_port_limits = \"fixed\"")).await;
    assert_eq!(changes, json!(["gripper g: WSG port changed"]));
    let mut driver = Driver::connect(address).await;
    assert_eq!(driver.status(0x37, &[1]).await, 16, "E_ACCESS_DENIED");
}

#[tokio::test]
async fn hang_up_reloads() {
    let g = gripper("g", "");
    let one = Configured::start(&g).await;
    one.gateway.until_link("connected").await;
    std::fs::write(&one.file, format!("{g}{}", gripper("h", ""))).unwrap();
    one.gateway.hang_up();
    eventually("the new gripper", async || (one.names().await == ["g", "h"]).then_some(())).await;
}

#[tokio::test]
async fn command_reloads_and_prints_the_changes() {
    let g = gripper("g", "");
    let one = Configured::start(&g).await;
    std::fs::write(&one.file, format!("hosts = [\"gateway.example\"]\n{g}")).unwrap();
    let url = one.gateway.url("/");
    let ended = run(&["reload", "--url", &url]).await;
    assert!(ended.status.success() && ended.stdout == "hosts: changed", "{ended:?}");
    let ended = run(&["reload", "--url", &url]).await;
    assert!(ended.status.success() && ended.stdout == "no changes", "{ended:?}");
    std::fs::write(&one.file, "nonsense = 1").unwrap();
    let ended = run(&["reload", "--url", &url]).await;
    assert!(!ended.status.success() && ended.stderr.contains("nonsense"), "{ended:?}");
}

/// Returns a configuration with `g`, and with other grippers that come, go and change.
fn configuration(random: &mut StdRng) -> String {
    let (idle_timeout_s, host) = (random.random_range(5..8), random.random_range(0..3));
    let mut toml = format!("idle_timeout_s = {idle_timeout_s}\nhosts = [\"h{host}.example\"]\n");
    toml += &gripper("g", "");
    for name in ["h", "k", "m"] {
        match random.random_range(0..4) {
            0 => {}
            1 => toml += &gripper(name, ""),
            2 => toml += &gripper(name, "motion_pause_ms = 100"),
            _ => toml += &gripper(name, "update_period_ms = 20\nwsg_port = \"127.0.0.1:0\""),
        }
    }
    toml
}

#[tokio::test(flavor = "multi_thread")]
async fn two_hundred_reloads_disturb_no_client_of_an_unchanged_gripper() {
    let mut random = StdRng::seed_from_u64(7);
    let one = Configured::start(&configuration(&mut random)).await;
    let gateway = &one.gateway;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let mut socket = Socket::open(gateway).await;
    socket.call("subscribe", json!({"topics": ["state", "frames"]})).await;
    let is_over = AtomicBool::new(false);
    let moving = async {
        let mut moved = 0;
        // At least one motion begins after a reload, however fast they are.
        while !is_over.load(Ordering::Relaxed) || moved < 3 {
            let width_mm = if moved % 2 == 0 { 60 } else { 70 };
            gateway.post("move", &json!({"width_mm": width_mm, "speed_mm_s": 400})).await.outcome("SUCCESS");
            moved += 1;
        }
        moved
    };
    let reloading = async {
        let mut memory = Vec::new();
        for count in 1..=200 {
            one.reload(&configuration(&mut random)).await;
            if count % 50 == 0 {
                memory.push(gateway.figures().await["process_resident_memory_bytes"] / 1e6);
            }
        }
        is_over.store(true, Ordering::Relaxed);
        memory
    };
    let reading = async {
        while !is_over.load(Ordering::Relaxed) {
            socket.next().await.expect("the WebSocket stays open");
        }
    };
    let (moved, memory, ()) = tokio::join!(moving, reloading, reading);
    println!("{moved} motions during 200 reloads; resident MB after each 50: {memory:.1?}");
    assert_eq!(socket.call("state", json!({"gripper": "g"})).await["link"], "connected", "the WebSocket is still open");
    let link = gateway.figures().await;
    assert!(link["wsg_reconnects_total{gripper=\"g\"}"] < 1.0, "the unchanged gripper keeps its link");
    assert!(memory[3] < memory[1] + 15.0, "resident memory grows: {memory:?} MB");
}

#[tokio::test]
async fn client_that_is_no_longer_named_loses_its_rights() {
    let toml = |clients: &str| {
        let boss = "[[clients]]\nname = \"boss\"\naddress = \"127.0.0.9\"\nrole = \"supervisor\"\n";
        format!("{boss}{clients}{}", gripper("g", "wsg_port = \"127.0.0.1:0\"\nwsg_port_allow = [\"127.0.0.77\"]"))
    };
    let plc = "[[clients]]\nname = \"plc\"\naddress = \"127.0.0.1\"\nrole = \"operator\"\n";
    let one = Configured::start(&toml(plc)).await;
    let address = one.gateway.word_after("WSG port of g: tcp://").await.parse().unwrap();
    one.gateway.until_link("connected").await;
    let mut driver = Driver::connect(address).await;
    assert_eq!(driver.run(0x20, &[0]).await, 0);
    std::fs::write(&one.file, toml("")).unwrap();
    one.gateway.hang_up();
    one.gateway.until_logged("configuration reloaded").await;
    assert_eq!(driver.status(0x20, &[0]).await, 16, "E_ACCESS_DENIED");
    assert_eq!(driver.status(0x23, &[]).await, 0, "a FAST STOP needs no role");
}

#[tokio::test]
async fn reload_of_other_settings_stops_no_client_of_a_wsg_port() {
    let toml = |drain_ms: u32, rest: &str| {
        format!("drain_ms = {drain_ms}\n{}", gripper("g", &format!("wsg_port = \"127.0.0.1:0\"\n{rest}")))
    };
    let one = Configured::start(&toml(2000, "")).await;
    let address = one.gateway.word_after("WSG port of g: tcp://").await.parse().unwrap();
    one.gateway.until_link("connected").await;
    one.gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let mut driver = Driver::connect(address).await;
    assert_eq!(driver.status(0x21, &move_to(5.0, 20.0)).await, PENDING);
    one.gateway.until_moving().await;
    assert_eq!(one.reload(&toml(3000, "")).await, json!(["gripper g: changed"]));
    assert_eq!(one.reload(&toml(3000, "lease_max_ttl_ms = 50000")).await, json!(["gripper g: changed"]));
    assert_eq!(driver.end_of(0x21).await, 0);
    assert_eq!(one.gateway.state().await["fast_stop"], false);
    driver.leave().await;
}

#[tokio::test]
async fn fast_stop_reaches_a_gripper_that_a_reload_drains() {
    let toml =
        |rest: &str| format!("drain_ms = 20000\n{}", gripper("g", &format!("wsg_port = \"127.0.0.1:0\"\n{rest}")));
    let one = Configured::start(&toml("")).await;
    let address = one.gateway.word_after("WSG port of g: tcp://").await.parse().unwrap();
    one.gateway.until_link("connected").await;
    one.gateway.post("home", &json!({})).await.outcome("SUCCESS");
    let mut driver = Driver::connect(address).await;
    let id = one.gateway.begin("move", &json!({"width_mm": 5, "speed_mm_s": 5})).await;
    one.gateway.until_moving().await;
    std::fs::write(&one.file, toml("update_period_ms = 20")).unwrap();
    one.gateway.hang_up();
    one.gateway.until_logged("draining").await;
    assert_eq!(driver.status(0x23, &[]).await, 0);
    let ended =
        one.gateway.send(one.gateway.request("GET", &format!("/api/v1/grippers/g/commands/{id}?wait_ms=5000"))).await;
    ended.outcome("ABORTED");
}
