//! Requests of any form, and many clients.

use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio_modbus::client::{Client as _, Reader as _, Writer as _};
use tokio_modbus::prelude::{ExceptionCode, ReadCode, Request};

use super::{COUNTER, Cell, HOME, Plc, Values};
use crate::harness::{DEADLINE, eventually};

#[tokio::test]
async fn wrong_requests_are_answered_with_exceptions() {
    let cell = Cell::start().await;
    let mut plc = Plc::connect(cell.address).await;
    let client = &mut plc.client;
    let (address, value) = (ExceptionCode::IllegalDataAddress, ExceptionCode::IllegalDataValue);
    assert_eq!(client.read_input_registers(6, 1).await.unwrap(), Err(address));
    assert_eq!(client.read_holding_registers(4, 1).await.unwrap(), Err(address));
    assert_eq!(client.read_input_registers(100, 0).await.unwrap(), Err(value));
    assert_eq!(client.read_input_registers(100, 126).await.unwrap(), Err(value));
    assert_eq!(client.write_single_register(111, 1).await.unwrap(), Err(address));
    assert_eq!(client.write_single_register(1100, 1).await.unwrap(), Err(address));
    assert_eq!(client.read_coils(0, 1).await.unwrap(), Err(ExceptionCode::IllegalFunction));
    let unreadable = client.read_write_multiple_registers(5000, 2, COUNTER, &[1, HOME]).await.unwrap();
    assert_eq!(unreadable, Err(address));
    assert_eq!(client.read_holding_registers(COUNTER, 2).await.unwrap().unwrap(), [0, 0], "nothing was written");
}

#[tokio::test]
async fn device_identifies_itself() {
    let cell = Cell::start().await;
    let mut plc = Plc::connect(cell.address).await;
    let identity = plc.client.call(Request::ReadDeviceIdentification(ReadCode::Basic, 0)).await.unwrap().unwrap();
    let tokio_modbus::Response::ReadDeviceIdentification(identity) = identity else { panic!("{identity:?}") };
    let texts: Vec<_> = identity.device_id_objects.iter().map(|object| object.value_as_str().unwrap()).collect();
    assert_eq!(texts, ["WSG Gateway", "g", env!("CARGO_PKG_VERSION")]);
}

#[tokio::test]
async fn request_with_a_wrong_length_keeps_the_connection() {
    let cell = Cell::start().await;
    let mut stream = TcpStream::connect(cell.address).await.unwrap();
    // Write multiple registers: two are announced, and one follows.
    stream.write_all(&hex::decode("000100000009011000640002020007").unwrap()).await.unwrap();
    stream.write_all(&hex::decode("000200000006010400640001").unwrap()).await.unwrap();
    let mut answers = [0; 20];
    tokio::time::timeout(DEADLINE, stream.read_exact(&mut answers)).await.unwrap().unwrap();
    assert_eq!(hex::encode(answers), "0001000000030190030002000000050104020000");
}

#[tokio::test]
async fn garbage_closes_only_its_own_connection() {
    let cell = Cell::start().await;
    let mut plc = Plc::ready(cell.address).await;
    let mut random = StdRng::seed_from_u64(7);
    for round in 0..300 {
        let mut stream = TcpStream::connect(cell.address).await.unwrap();
        let mut bytes: Vec<u8> = (0..random.random_range(1..300)).map(|_| random.random()).collect();
        if round % 3 > 0 {
            // A valid header, so that the request itself is read. The bytes are the same in each run, and contain no FAST STOP.
            let length = bytes.len().min(200) as u8 + 2;
            let function = [3, 4, 6, 16, 23, 43, random.random()][random.random_range(0..7)];
            bytes.truncate(200);
            bytes = [&[0, round as u8, 0, 0, 0, length, random.random_range(0..3), function][..], &bytes].concat();
        }
        // The gateway may close the connection first.
        let _ = stream.write_all(&bytes).await;
    }
    plc.ok(HOME, Values::default()).await;
    assert!(!cell.gateway.log().contains("panicked"));
    let figures = cell.gateway.figures().await;
    assert!(figures.keys().any(|name| name.contains("door=\"modbus\"")), "{figures:?}");
    let connected = "wsg_clients_connected{door=\"modbus\"}";
    eventually("only one client", async || (cell.gateway.figures().await[connected] <= 1.0).then_some(())).await;
}

#[tokio::test]
async fn lease_holder_is_not_evicted() {
    let (cell, mut plc) = Cell::homed().await;
    let mut crowd = Vec::new();
    // More than the 512 clients that are kept.
    for _ in 0..530 {
        let mut other = Plc::connect(cell.address).await;
        other.seen().await;
        crowd.push(other);
    }
    plc.ok(super::MOVE, Values::at(3000, 2000)).await;
}
