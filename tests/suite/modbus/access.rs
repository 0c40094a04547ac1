//! Clients by their addresses, and their rights.

use std::net::SocketAddr;

use serde_json::json;
use tokio::io::AsyncReadExt as _;
use tokio::net::TcpStream;
use tokio_modbus::client::Reader as _;
use tokio_modbus::prelude::{ExceptionCode, SlaveContext as _};

use super::{COUNTER, FAST_STOP_REGISTER, GATEWAY, HOME, LATCHED, MINE, MOVE, MOVING, NOK, NONE, Plc, STOP, Values};
use crate::harness::{DEADLINE, Directory, Gateway, eventually, run};

/// Problem of a client without the right.
const FORBIDDEN: u16 = 29;

async fn gateway(settings: &str) -> (Gateway, SocketAddr) {
    let toml = format!(
        "modbus = \"127.0.0.1:0\"\n{settings}\n[grippers.g]\nurl = \"sim://wsg50\"\nmodbus_unit = 1\n[grippers.h]\nurl = \
         \"sim://wsg50\"\n"
    );
    let gateway = Gateway::with_file(&[], &toml).await;
    let address = gateway.word_after("Modbus: ").await.parse().unwrap();
    (gateway, address)
}

#[tokio::test]
async fn only_allowed_addresses_can_connect() {
    let (_gateway, address) = gateway("modbus_allow = [\"127.0.0.2\"]").await;
    let mut other = TcpStream::connect(address).await.unwrap();
    let end = tokio::time::timeout(DEADLINE, other.read(&mut [0; 16])).await.expect("the connection is closed");
    assert!(matches!(end, Ok(0) | Err(_)), "{end:?}");
    let mut allowed = Plc::from("127.0.0.2", address).await;
    assert_eq!(allowed.seen().await.counter, 0);
}

/// A client that the configuration knows by its address, with this role.
async fn client_with_role(role: &str) -> (Gateway, Plc) {
    let client = format!("[[clients]]\nname = \"hmi\"\naddress = \"127.0.0.3\"\nrole = \"{role}\"\n[access]\n");
    let (gateway, address) = gateway(&client).await;
    let mut plc = Plc::from("127.0.0.3", address).await;
    plc.write(COUNTER, &[0, NONE]).await.unwrap();
    (gateway, plc)
}

#[tokio::test]
async fn observer_reads_and_stops_but_moves_nothing() {
    let (_gateway, mut hmi) = client_with_role("observer").await;
    for command in [HOME, STOP] {
        let refused = hmi.ended(command, Values::default()).await;
        assert_eq!((refused.problem, refused.status & NOK), (FORBIDDEN, NOK), "{refused:?}");
    }
    hmi.write(FAST_STOP_REGISTER, &[1]).await.unwrap();
    hmi.until("latched", |seen| seen.status & LATCHED != 0).await;
}

#[tokio::test]
async fn stop_controller_reads_and_stops_but_moves_nothing() {
    let (_gateway, mut curtain) = client_with_role("stop").await;
    let refused = curtain.ended(HOME, Values::default()).await;
    assert_eq!((refused.problem, refused.status & NOK), (FORBIDDEN, NOK), "{refused:?}");
    let stopped = curtain.ended(STOP, Values::default()).await;
    assert_ne!(stopped.problem, FORBIDDEN, "{stopped:?}");
    curtain.write(FAST_STOP_REGISTER, &[1]).await.unwrap();
    curtain.until("latched", |seen| seen.status & LATCHED != 0).await;
}

#[tokio::test]
async fn holder_that_may_no_longer_move_loses_its_lease() {
    let files = Directory::new();
    let toml = |role: &str| {
        format!(
            "modbus = \"127.0.0.1:0\"\n[[clients]]\nname = \"plc7\"\naddress = \"127.0.0.3\"\nrole = \"{role}\"\n\
             [access]\n[grippers.g]\nurl = \"sim://wsg50\"\n"
        )
    };
    let file = files.write("gateway.toml", &toml("operator"));
    let token = files.file("tokens.json");
    let create = ["token", "--tokens", &token, "create", "--name", "boss", "--role", "supervisor"];
    let secret = run(&create).await.stdout.trim().to_owned();
    let gateway = Gateway::start(&["--config", &file, "--tokens", &token]).await;
    let ask = async |path: &str| {
        let request = gateway.request("GET", path).header("Authorization", format!("Bearer {secret}"));
        gateway.send(request).await.ok()
    };
    let mut plc = Plc::from("127.0.0.3", gateway.word_after("Modbus: ").await.parse().unwrap()).await;
    eventually("connected", async || (ask("state").await["link"] == "connected").then_some(())).await;
    plc.write(COUNTER, &[0, NONE]).await.unwrap();
    plc.ok(HOME, Values::default()).await;
    plc.command(MOVE, Values::at(2500, 50)).await.unwrap();
    plc.until("moving", |seen| seen.status & (MOVING | MINE) == MOVING | MINE).await;
    files.write("gateway.toml", &toml("observer"));
    gateway.hang_up();
    let stopped = async || Some(ask("state").await).filter(|state| state["fast_stop"] == true);
    let state = eventually("a FAST STOP", stopped).await;
    assert_eq!((&state["fast_stop_cause"], &state["lease_holder"]), (&json!("client_lost"), &json!(null)), "{state}");
    let loss = async || {
        let events = ask("/api/v1/events?kind=lease").await["events"].take();
        events.as_array()?.iter().find(|event| event["event"] == "lost").cloned()
    };
    assert_eq!(eventually("the loss", loss).await["cause"], "forbidden");
    assert_eq!(plc.seen().await.status & MINE, 0);
}

#[tokio::test]
async fn gateway_unit_stops_all_grippers() {
    let (gateway, address) = gateway("").await;
    gateway.until_link("connected").await;
    let mut plc = Plc::connect(address).await;
    plc.client.set_slave(tokio_modbus::Slave(GATEWAY));
    assert_eq!(plc.inputs(100, 2).await[0], 2, "grippers");
    assert_eq!(plc.write(COUNTER, &[1, HOME]).await, Err(ExceptionCode::IllegalDataAddress));
    plc.write(FAST_STOP_REGISTER, &[1]).await.unwrap();
    for gripper in ["g", "h"] {
        let path = format!("/api/v1/grippers/{gripper}/state");
        let stopped = async || (gateway.get(&path).await.ok()["fast_stop"] == true).then_some(());
        eventually("latched", stopped).await;
    }
    let events = gateway.events("kind=fast_stop", 2).await;
    let latched: Vec<_> = events.iter().filter(|event| event["event"] == "latched").collect();
    assert!(latched.len() == 2 && latched.iter().all(|event| event["subject"] == "modbus:127.0.0.1"), "{events:?}");
    assert!(plc.inputs(101, 1).await[0] & LATCHED != 0);
}

#[tokio::test]
async fn unit_identifier_selects_the_gripper() {
    let (gateway, address) = gateway("").await;
    let mut plc = Plc::connect(address).await;
    gateway.until_link("connected").await;
    gateway.post("home", &json!({})).await.outcome("SUCCESS");
    for (unit, is_homed) in [(1, true), (2, false)] {
        plc.client.set_slave(tokio_modbus::Slave(unit));
        assert_eq!(plc.inputs(106, 1).await[0] != 0x8000, is_homed, "unit {unit}");
    }
    plc.client.set_slave(tokio_modbus::Slave(3));
    let unknown = plc.client.read_input_registers(0, 1).await.unwrap();
    assert_eq!(unknown, Err(ExceptionCode::GatewayPathUnavailable));
}
