//! Processor time and memory of many grippers, each of which sends all its values at 100 Hz: a quarter of them first,
//! then all.
//!
//! `cargo bench --bench grippers`. Variables: `GRIPPERS` (256) and `SECONDS` (10 for each number). All devices run in one
//! other process.

mod program;
mod usage;
mod variables;

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use program::{Error, start, start_all};
use variables::number;

/// Limit of the time until all grippers are connected.
const CONNECTED_WITHIN: Duration = Duration::from_mins(1);

fn get(address: &str, path: &str) -> Result<String, Error> {
    let mut stream = TcpStream::connect(address)?;
    stream.set_read_timeout(Some(CONNECTED_WITHIN))?;
    write!(stream, "GET {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")?;
    let mut response = String::new();
    stream.read_to_string(&mut response)?;
    Ok(response)
}

/// Returns the number of frames received from all devices.
fn frames(address: &str) -> Result<f64, Error> {
    let metrics = get(address, "/metrics")?;
    let received = metrics
        .lines()
        .filter(|line| line.starts_with("wsg_frames_total{") && line.contains("direction=\"received\""))
        .filter_map(|line| line.rsplit(' ').next()?.parse::<f64>().ok());
    Ok(received.sum())
}

/// The cost of some grippers.
struct Cost {
    /// Processor time used per second.
    cores: f64,
    frames_per_second: f64,
    memory_mib: f64,
}

fn measure(grippers: usize) -> Result<Cost, Error> {
    let urls = vec!["tcp://127.0.0.1:0"; grippers];
    let (_devices, devices) = start_all(&[&["sim"], &urls[..]].concat(), " at tcp://", grippers)?;
    let given: Vec<_> = devices.iter().enumerate().map(|(index, device)| format!("g{index}=tcp://{device}")).collect();
    let mut arguments = vec!["--listen", "127.0.0.1:0", "--zenoh-listen", "tcp/127.0.0.1:0"];
    arguments.extend(given.iter().flat_map(|gripper| ["--gripper", gripper]));
    let (gateway, address) = start(&arguments, " at http://")?;
    let deadline = Instant::now() + CONNECTED_WITHIN;
    while !get(&address, "/readyz")?.starts_with("HTTP/1.1 200 ") {
        if Instant::now() > deadline {
            return Err("not all grippers are connected".into());
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    let (begun, time, received) = (Instant::now(), gateway.time()?, frames(&address)?);
    std::thread::sleep(Duration::from_secs(number("SECONDS", 10) as u64));
    let (time, received) = (gateway.time()? - time, frames(&address)? - received);
    let seconds = begun.elapsed().as_secs_f64();
    Ok(Cost { cores: time / seconds, frames_per_second: received / seconds, memory_mib: gateway.memory()? })
}

fn main() -> Result<(), Error> {
    let all = number("GRIPPERS", 256).max(2);
    let few = all.div_ceil(4);
    let [a_quarter, whole] = [measure(few)?, measure(all)?];
    for (count, cost) in [(few, &a_quarter), (all, &whole)] {
        println!(
            "{count} grippers: {:.2} of a core, {:.0} frames/s received, {:.1} MiB",
            cost.cores, cost.frames_per_second, cost.memory_mib
        );
    }
    let more = (all - few) as f64;
    println!(
        "each further gripper: {:.2} % of a core, {:.0} KiB; ratio of the costs a gripper {:.2}",
        100.0 * (whole.cores - a_quarter.cores) / more,
        1024.0 * (whole.memory_mib - a_quarter.memory_mib) / more,
        (whole.cores / all as f64) / (a_quarter.cores / few as f64)
    );
    Ok(())
}
