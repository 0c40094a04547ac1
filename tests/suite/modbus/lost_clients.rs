//! Clients that are lost: their connection ends, or their heartbeat stops.

use std::time::{Duration, Instant};

use serde_json::json;
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;

use super::{Cell, FAST_STOP, HEARTBEAT, HOME, MINE, MOVE, MOVING, Plc, Values, until_free};
use crate::harness::eventually;

/// A move that takes several seconds.
const SLOW: (u16, u16) = (2500, 50);

async fn moving(plc: &mut Plc) {
    plc.command(MOVE, Values::at(SLOW.0, SLOW.1)).await.unwrap();
    plc.until("moving", |seen| seen.status & MOVING != 0).await;
}

async fn fast_stop_of(cell: &Cell, lost: Instant) -> Duration {
    let stopped = eventually("23h", async || cell.proxy.frames.first_since(FAST_STOP, lost)).await;
    let state = cell.gateway.until("latched", |state| state["fast_stop_confirmed"] == true).await;
    assert_eq!(state["fast_stop_cause"], "client_lost", "{state}");
    stopped - lost
}

#[tokio::test]
async fn lost_connection_stops_the_motion() {
    let (cell, mut plc) = Cell::homed().await;
    moving(&mut plc).await;
    let lost = Instant::now();
    drop(plc);
    let took = fast_stop_of(&cell, lost).await;
    println!("23h {} ms after the end of the connection", took.as_millis());
    until_free(&cell.gateway).await;
}

#[tokio::test]
async fn stopped_heartbeat_stops_the_motion() {
    let cell = Cell::with("modbus_heartbeat_ms = 800").await;
    let mut plc = Plc::ready(cell.address).await;
    plc.ok(HOME, Values::default()).await;
    plc.command(MOVE, Values::at(SLOW.0, SLOW.1)).await.unwrap();
    let mut beats = Instant::now();
    for beat in 1..=10 {
        beats = Instant::now();
        plc.write(HEARTBEAT, &[beat]).await.unwrap();
        tokio::time::sleep(Duration::from_millis(100)).await;
        // A repeated value does not count as a heartbeat; the time limit has not passed yet.
        plc.write(HEARTBEAT, &[beat]).await.unwrap();
    }
    assert_eq!(cell.proxy.frames.count(FAST_STOP), 0);
    assert_eq!(plc.seen().await.status & MINE, MINE);
    let took = fast_stop_of(&cell, beats).await;
    println!("23h {} ms after the last heartbeat, of 800 ms", took.as_millis());
    assert!(took >= Duration::from_millis(800), "{took:?}");
    let seen = plc.seen().await;
    assert_eq!(seen.status & MINE, 0, "{seen:?}");
}

#[tokio::test]
async fn heartbeat_that_waits_for_a_frozen_gateway_counts() {
    let cell = Cell::with("modbus_heartbeat_ms = 800").await;
    let mut plc = Plc::ready(cell.address).await;
    plc.ok(HOME, Values::default()).await;
    plc.write(HEARTBEAT, &[1]).await.unwrap();
    moving(&mut plc).await;
    plc.write(HEARTBEAT, &[2]).await.unwrap();
    cell.gateway.freeze();
    let thawed = async {
        tokio::time::sleep(Duration::from_secs(1)).await;
        cell.gateway.thaw();
    };
    let (written, ()) = tokio::join!(plc.write(HEARTBEAT, &[3]), thawed);
    written.unwrap();
    assert_eq!(plc.seen().await.status & MINE, MINE);
    assert_eq!(cell.proxy.frames.count(FAST_STOP), 0);
}

#[tokio::test]
async fn on_loss_finish_completes_the_motion() {
    let device = crate::harness::Simulator::with_part().await;
    let toml = format!("[grippers.g]\nurl = \"tcp://{}\"\non_loss_moving = [\"finish\"]\n", device.address);
    let gateway = crate::harness::Gateway::with_file(&["--modbus", "127.0.0.1:0"], &toml).await;
    let address = gateway.word_after("Modbus: ").await.parse().unwrap();
    gateway.until_link("connected").await;
    let mut plc = Plc::ready(address).await;
    plc.command(HOME, Values::default()).await.unwrap();
    drop(plc);
    gateway.until("homed", |state| state["referenced"] == true && state["command_id"].is_null()).await;
    assert_eq!(gateway.state().await["fast_stop"], false);
}

#[tokio::test]
async fn fast_stop_survives_an_immediate_disconnect() {
    let cell = Cell::start().await;
    for reads in [0, 2, 5] {
        // Requests for the status, and a FAST STOP behind them.
        let mut bytes = Vec::new();
        for _ in 0..reads {
            bytes.extend(hex::decode("000100000006010400640010").unwrap());
        }
        bytes.extend(hex::decode("0002000000060106006E0001").unwrap());
        for _ in 0..10 {
            let before = Instant::now();
            let mut stream = TcpStream::connect(cell.address).await.unwrap();
            stream.write_all(&bytes).await.unwrap();
            drop(stream);
            eventually("23h", async || cell.proxy.frames.first_since(FAST_STOP, before)).await;
            let latched = cell.gateway.until("latched", |state| state["fast_stop_confirmed"] == true).await;
            let acknowledged = json!({"fast_stop_id": latched["fast_stop_id"]});
            cell.gateway.post("acknowledge", &acknowledged).await.ok();
        }
    }
}
