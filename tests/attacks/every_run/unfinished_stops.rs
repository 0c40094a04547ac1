//! FAST STOPs whose bodies stay unfinished. They stop, but must not take the answers of clients that sent a whole request.

use std::io;
use std::sync::Arc;

use tokio::net::TcpStream;

use super::crowded_ports::attacked;
use crate::attack::{MANY, Wanted};
use crate::attacker::Crowd;

pub const UNFINISHED: usize = 2000;

pub const WANTED: Wanted = Wanted { others: 20, ..MANY };

/// Sends the head of a FAST STOP for `h` and one byte of its body, and waits for the end of the connection.
pub async fn half_sent_stop(crowd: Arc<Crowd>, _: usize, stream: TcpStream) -> io::Result<()> {
    let path = "/api/v1/grippers/h/fast-stop";
    let head = format!("POST {path} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n\r\n{{");
    crowd.send_unfinished(stream, &head).await
}

#[test]
fn unfinished_stops_take_no_answer() {
    attacked("half_sent_stops", UNFINISHED, WANTED, |gateway| gateway.address).loses_no_answer();
}

#[test]
fn unfinished_stops_of_another_address_take_no_answer() {
    attacked("half_sent_stops@127.0.0.2", UNFINISHED, WANTED, |gateway| gateway.address).loses_no_answer();
}
