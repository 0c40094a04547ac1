//! Rate of `GET …/state`, compared with a bare axum handler that answers the same JSON, alternating in one run.
//!
//! `cargo bench --bench state`. Needs wrk. Rates are noisy; compare the ratio.

mod program;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::time::{Duration, Instant};

use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::routing::get;
use program::{Error, start};

const PATH: &str = "/api/v1/grippers/g/state";

/// Measurements of each server, the first of which is a warm-up.
const ROUNDS: usize = 6;

/// Keep-alive connections, and the duration of a measurement. The gateway limits the rate of each connection.
const LOAD: [&str; 3] = ["-t1", "-c128", "-d3s"];

/// Returns the body of a response.
fn body(address: &str) -> Result<String, Error> {
    let mut stream = TcpStream::connect(address)?;
    write!(stream, "GET {PATH} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")?;
    let mut response = String::new();
    stream.read_to_string(&mut response)?;
    let (_, body) = response.split_once("\r\n\r\n").ok_or("no body")?;
    Ok(body.to_owned())
}

/// Returns the requests per second.
fn rate(address: &str) -> Result<f64, Error> {
    let ran = Command::new("wrk").args(LOAD).arg(format!("http://{address}{PATH}")).output();
    let said = String::from_utf8(ran.map_err(|error| format!("wrk is needed: {error}"))?.stdout)?;
    if said.contains("Non-2xx") || said.contains("Socket errors") {
        return Err(said.into());
    }
    let (_, rate) = said.split_once("Requests/sec:").ok_or("no rate")?;
    Ok(rate.split_whitespace().next().ok_or("no rate")?.parse()?)
}

fn main() -> Result<(), Error> {
    let arguments = ["--listen", "127.0.0.1:0", "--zenoh-listen", "tcp/127.0.0.1:0", "--gripper", "g=sim://wsg50"];
    let (_gateway, gateway) = start(&arguments, " at http://")?;
    let deadline = Instant::now() + Duration::from_secs(5);
    while !body(&gateway)?.contains("\"connected\"") {
        if Instant::now() > deadline {
            return Err("the gripper does not become ready".into());
        }
    }
    let json = body(&gateway)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let listener = runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0"))?;
    let bare = listener.local_addr()?.to_string();
    let handler = get(move || std::future::ready(([(CONTENT_TYPE, "application/json")], json.clone())));
    runtime.spawn(async move { axum::serve(listener, Router::new().route(PATH, handler)).await });
    let mut rates = Vec::new();
    for _ in 0..ROUNDS {
        rates.push((rate(&gateway)?, rate(&bare)?));
    }
    let mut ratios: Vec<_> = rates[1..].iter().map(|(gateway, bare)| gateway / bare).collect();
    ratios.sort_by(f64::total_cmp);
    for (gateway, bare) in &rates[1..] {
        println!("requests per second: gateway {gateway:.0}, bare handler {bare:.0}");
    }
    println!(
        "ratio: least {:.2}, median {:.2}, most {:.2}",
        ratios[0],
        ratios[ratios.len() / 2],
        ratios[ratios.len() - 1]
    );
    Ok(())
}
