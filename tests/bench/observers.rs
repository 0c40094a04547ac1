//! A thousand observers, a hundred of which read nothing, with a flood of refused motions. The bench measures the time
//! of a FAST STOP to the device, compared with an idle gateway in the same run. It checks that every reading observer
//! gets every event. It compares the processor time of each delivery, before the flood and the stalled observers begin,
//! with that of a Mosquitto that fans out the same bytes.
//!
//! `cargo bench --bench observers`. Variables: `OBSERVERS` (1000), `STALLED` (100), `HZ` (50), `STOPS` (200 idle and
//! 200 loaded, each of a motion) and `SECONDS` (10 per fan-out). Times are noisy; compare the ratios. Mosquitto is skipped
//! if it is not installed.
//!
//! The observers run in a separate process with idle priority (`chrt --idle`, from util-linux). With two or more
//! processors, the last one runs the observers, the clients and the device, and the gateway has the others (`taskset`),
//! as if on separate machines. With `SHARED=1` all processes share all processors.

#[path = "observers/crowd.rs"]
mod crowd;
mod directory;
mod program;
mod socket;
mod stopper;
mod tap;
mod usage;
mod variables;

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::process::{ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use directory::Directory;
use program::{Error, Running, start};
use serde_json::Value;
use stopper::{Stopper, percentile};
use variables::number;

/// Unmeasured stops at the start, idle and loaded.
const WARM_UP: usize = 20;

/// The observers' process, which reports on request.
struct Crowd {
    running: Running,
    asks: ChildStdin,
    says: BufReader<std::process::ChildStdout>,
}

impl Crowd {
    fn start(what: &str, address: &str) -> Result<Self, Error> {
        // The observers must not take time from the gateway and its caller, since real observers run elsewhere.
        let mut command = Command::new("chrt");
        command.args(["--idle", "0"]).arg(std::env::current_exe()?).env("CROWD", what).env("ADDRESS", address);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let (asks, says) = (child.stdin.take().ok_or("no input")?, child.stdout.take().ok_or("no output")?);
        let mut crowd = Self { running: Running(child), asks, says: BufReader::new(says) };
        crowd.report()?;
        Ok(crowd)
    }

    /// Starts the stalled observers and the flood.
    fn disturb(&mut self) -> Result<(), Error> {
        self.ask(crowd::DISTURB).map(drop)
    }

    fn report(&mut self) -> Result<Value, Error> {
        self.ask("")
    }

    fn ask(&mut self, what: &str) -> Result<Value, Error> {
        writeln!(self.asks, "{what}")?;
        let mut line = String::new();
        self.says.read_line(&mut line)?;
        if line.is_empty() {
            return Err(format!("the observers ended: {:?}", self.running.0.try_wait()).into());
        }
        Ok(serde_json::from_str(&line)?)
    }
}

/// Returns the sorted times of some stops.
fn stops(stopper: &Stopper, count: usize) -> Result<Vec<Duration>, Error> {
    let mut times = (0..count).map(|_| stopper.stop()).collect::<Result<Vec<_>, _>>()?;
    times.sort_unstable();
    Ok(times)
}

/// Binds the threads of a process to these processors.
fn bind(process: u32, processors: &str) -> Result<(), Error> {
    let mut command = Command::new("taskset");
    command.args(["-a", "-p", "-c", processors, &process.to_string()]).stdout(Stdio::null());
    // taskset fails if a thread ends meanwhile.
    for _ in 0..5 {
        if command.status()?.success() {
            return Ok(());
        }
    }
    Err(format!("taskset cannot bind process {process}").into())
}

/// Binds this process to the last processor, and returns the others for the gateway.
fn processors() -> Result<Option<String>, Error> {
    let last = std::thread::available_parallelism()?.get() - 1;
    if last == 0 || number("SHARED", 0) == 1 {
        return Ok(None);
    }
    bind(std::process::id(), &last.to_string())?;
    Ok(Some(format!("0-{}", last - 1)))
}

fn main() -> Result<(), Error> {
    if let (Ok(what), Ok(address)) = (std::env::var("CROWD"), std::env::var("ADDRESS")) {
        return crowd::run(&what, &address);
    }
    let processors = processors()?;
    let (_device, device) = start(&["sim", "tcp://127.0.0.1:0"], " at tcp://")?;
    let (tapped, frames) = tap::start(device)?;
    let gripper = format!("g=tcp://{tapped}");
    // A journal file, as in production; a journal in memory would grow with every event.
    let directory = Directory::new("observers")?;
    let journal = directory.0.join("gateway.db").to_string_lossy().into_owned();
    let zenoh = "tcp/127.0.0.1:0";
    let arguments = ["--listen", "127.0.0.1:0", "--zenoh-listen", zenoh, "--gripper", &gripper, "--journal", &journal];
    let (gateway, address) = start(&arguments, " at http://")?;
    if let Some(processors) = &processors {
        bind(gateway.0.id(), processors)?;
    }
    let stopper = Stopper::new(&address, frames)?;
    stops(&stopper, WARM_UP)?;

    let (observers, stalled, seconds) = (number("OBSERVERS", 1000), number("STALLED", 100), number("SECONDS", 10));
    println!("{observers} observers at {} Hz, {stalled} of them stalled, with a flood", number("HZ", 50));
    let count = number("STOPS", 200).max(1);
    let idle = stops(&stopper, count)?;
    let before = gateway.memory()?;
    let mut crowd = Crowd::start("websocket", &address)?;
    stopper.begin_motion()?;
    let cost = fan_out("gateway", &mut crowd, &gateway, seconds)?;
    // Each observer's buffers grow with its first events.
    stops(&stopper, WARM_UP)?;
    let observed = gateway.memory()?;
    crowd.disturb()?;
    while crowd.report()?["refused"] == 0 {}
    stops(&stopper, WARM_UP)?;
    let begun = gateway.memory()?;
    let loaded = stops(&stopper, count)?;
    let ended = gateway.memory()?;
    // The last events are still in transit.
    std::thread::sleep(Duration::from_secs(2));
    let report = crowd.report()?;
    for (name, percent) in [("p50", 50), ("p99", 99)] {
        let (idle, loaded) = (percentile(&idle, percent), percentile(&loaded, percent));
        let ratio = loaded.as_secs_f64() / idle.as_secs_f64();
        println!("FAST STOP to the device, {name} of {count}: idle {idle:?}, loaded {loaded:?}, ratio {ratio:.2}");
    }
    println!(
        "memory: {before:.1} MiB idle, {observed:.1} MiB with observers ({:.1} KiB for each), {begun:.1} MiB with the \
         flood, {ended:.1} MiB at the end ({:+.1} %)",
        (observed - before) * 1024.0 / (observers - stalled) as f64,
        (ended / begun - 1.0) * 100.0
    );
    println!(
        "events: {} observers got all of them, {} missed some; {} motions were refused",
        report["complete"], report["incomplete"], report["refused"]
    );
    drop((crowd, gateway));
    let Some(peer) = mosquitto(seconds, processors.as_deref())? else {
        println!("mosquitto: not installed");
        return Ok(());
    };
    println!("deliveries for the same processor time, compared with Mosquitto: ratio {:.2}", peer / cost);
    Ok(())
}

/// Measures deliveries for some seconds. Returns the processor time of a million deliveries, in seconds.
fn fan_out(name: &str, crowd: &mut Crowd, server: &Running, seconds: usize) -> Result<f64, Error> {
    let delivered = |crowd: &mut Crowd| crowd.report().map(|report| report["delivered"].as_f64().unwrap_or_default());
    let (begun, before, time) = (Instant::now(), delivered(crowd)?, server.time()?);
    std::thread::sleep(Duration::from_secs(seconds as u64));
    let (count, time) = (delivered(crowd)? - before, server.time()? - time);
    let per_second = count / begun.elapsed().as_secs_f64();
    let cost = time / count * 1e6;
    println!("{name}: {per_second:.0} deliveries/s, {cost:.1} s of processor time per million");
    Ok(cost)
}

/// Measures Mosquitto, if it is installed.
fn mosquitto(seconds: usize, processors: Option<&str>) -> Result<Option<f64>, Error> {
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let mut command = Command::new("mosquitto");
    let started = command.args(["-p", &port.to_string()]).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    let Ok(child) = started else { return Ok(None) };
    let server = Running(child);
    let address = format!("127.0.0.1:{port}");
    while std::net::TcpStream::connect(&address).is_err() {}
    if let Some(processors) = processors {
        bind(server.0.id(), processors)?;
    }
    let mut crowd = Crowd::start("mqtt", &address)?;
    fan_out("mosquitto", &mut crowd, &server, seconds).map(Some)
}
