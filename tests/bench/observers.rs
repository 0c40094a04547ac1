//! A thousand observers, a hundred of which read nothing, and a flood of refused motions: how long a FAST STOP takes to
//! the device then, beside an idle gateway in the same run; whether every observer that reads got every event; what
//! memory and processor time that costs, beside Mosquitto that fans the same bytes out to as many subscribers.
//!
//! `cargo bench --bench observers`. `OBSERVERS` (1000), `STALLED` (100), `HZ` (50), `STOPS` (200, each once idle and once
//! loaded) and `SECONDS` (10, of each fan-out) change it. Times are noisy; the ratios are what counts. Mosquitto is left
//! out where it isn't installed. The observers are a process of their own, which gives way to all others (`chrt --idle`, of
//! util-linux). Where there are two processors or more, the last one is the observers', the clients' and the device's,
//! and the gateway has the others, idle and loaded (`taskset`): elsewhere those are machines of their own. With `SHARED=1`
//! all have all.

#[path = "observers/crowd.rs"]
mod crowd;
mod directory;
mod program;
#[path = "observers/tap.rs"]
mod tap;

use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::process::{ChildStdin, Command, Stdio};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

use directory::Directory;
use program::{Error, Running, start};
use serde_json::{Value, json};

/// Stops before any is measured, idle and loaded.
const WARM_UP: usize = 50;

/// What the kernel counts processor time in, a second.
const TICKS: f64 = 100.0;

impl Running {
    /// The memory that it has, in MiB.
    fn memory(&self) -> Result<f64, Error> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.0.id()))?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).ok_or("no VmRSS")?;
        Ok(line.trim().trim_end_matches(" kB").parse::<f64>()? / 1024.0)
    }

    /// The processor time that it has used.
    fn time(&self) -> Result<f64, Error> {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.0.id()))?;
        let fields: Vec<_> = stat.rsplit(')').next().ok_or("no stat")?.split_whitespace().collect();
        let ticks = |index: usize| fields.get(index).ok_or("too short").map(|field| field.parse::<f64>());
        Ok((ticks(11)?? + ticks(12)??) / TICKS)
    }
}

/// The observers, in a process of their own, which reports when it is asked.
struct Crowd {
    running: Running,
    asks: ChildStdin,
    says: BufReader<std::process::ChildStdout>,
}

impl Crowd {
    fn start(what: &str, address: &str) -> Result<Self, Error> {
        // Elsewhere observers have processors of their own: here they must not take the gateway's, nor its caller's.
        let mut command = Command::new("chrt");
        command.args(["--idle", "0"]).arg(std::env::current_exe()?).env("CROWD", what).env("ADDRESS", address);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let (asks, says) = (child.stdin.take().ok_or("no input")?, child.stdout.take().ok_or("no output")?);
        let mut crowd = Self { running: Running(child), asks, says: BufReader::new(says) };
        crowd.report()?;
        Ok(crowd)
    }

    fn report(&mut self) -> Result<Value, Error> {
        writeln!(self.asks)?;
        let mut line = String::new();
        self.says.read_line(&mut line)?;
        if line.is_empty() {
            return Err(format!("the observers have ended: {:?}", self.running.0.try_wait()).into());
        }
        Ok(serde_json::from_str(&line)?)
    }
}

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(default)
}

/// A client that stops the gripper, and acknowledges.
struct Stopper {
    runtime: tokio::runtime::Runtime,
    http: reqwest::Client,
    base: String,
    stops: Receiver<Instant>,
}

impl Stopper {
    fn post(&self, path: &str, body: &Value) -> Result<Value, Error> {
        let url = format!("{}/{path}", self.base);
        Ok(self.runtime.block_on(async { self.http.post(url).json(body).send().await?.json().await })?)
    }

    fn state(&self) -> Result<Value, Error> {
        let url = format!("{}/state", self.base);
        Ok(self.runtime.block_on(async { self.http.get(url).send().await?.json().await })?)
    }

    /// How long it takes from the request to the frame at the device.
    fn stop(&self) -> Result<Duration, Error> {
        while self.stops.try_recv().is_ok() {}
        let begun = Instant::now();
        let stopped = self.post("fast-stop", &json!({"reason": "a bench"}))?;
        let reached = self.stops.recv_timeout(Duration::from_secs(5))?;
        while self.state()?["fast_stop_confirmed"] != true {}
        let acknowledged = self.post("acknowledge", &json!({"fast_stop_id": stopped["fast_stop_id"]}))?;
        if acknowledged["fast_stop"] != false {
            return Err(format!("not acknowledged: {acknowledged}").into());
        }
        Ok(reached - begun)
    }

    fn stops(&self, count: usize) -> Result<Vec<Duration>, Error> {
        let mut times = (0..count).map(|_| self.stop()).collect::<Result<Vec<_>, _>>()?;
        times.sort_unstable();
        Ok(times)
    }
}

fn percentile(times: &[Duration], percent: usize) -> Duration {
    times[(times.len() - 1) * percent / 100]
}

/// Which processors the threads of a process may use.
fn bind(process: u32, processors: &str) -> Result<(), Error> {
    let mut command = Command::new("taskset");
    let bound = command.args(["-a", "-p", "-c", processors, &process.to_string()]).stdout(Stdio::null()).status()?;
    if bound.success() { Ok(()) } else { Err(format!("taskset: {bound}").into()) }
}

/// The gateway's processors, and the one of all others, which this process is bound to.
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
    let (tapped, stops) = tap::start(device)?;
    let gripper = format!("g=tcp://{tapped}");
    // In a file, as everywhere: in memory it would grow by what happens.
    let directory = Directory::new("observers")?;
    let journal = directory.0.join("gateway.db").to_string_lossy().into_owned();
    let zenoh = "tcp/127.0.0.1:0";
    let arguments = ["--listen", "127.0.0.1:0", "--zenoh-listen", zenoh, "--gripper", &gripper, "--journal", &journal];
    let (gateway, address) = start(&arguments, " at http://")?;
    if let Some(processors) = &processors {
        bind(gateway.0.id(), processors)?;
    }
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let base = format!("http://{address}/api/v1/grippers/g");
    // The gateway closes an idle connection after 10 s.
    let http = reqwest::Client::builder().pool_idle_timeout(Duration::from_secs(1)).build()?;
    let stopper = Stopper { runtime, http, base, stops };
    while stopper.state()?["link"] != "connected" {}
    stopper.stops(WARM_UP)?;

    let (observers, stalled, seconds) = (number("OBSERVERS", 1000), number("STALLED", 100), number("SECONDS", 10));
    println!("{observers} observers at {} Hz, {stalled} of which read nothing, and a flood", number("HZ", 50));
    let count = number("STOPS", 200);
    let idle = stopper.stops(count)?;
    let before = gateway.memory()?;
    let mut crowd = Crowd::start("websocket", &address)?;
    let fan_out = fan_out(&mut crowd, &gateway, seconds)?;
    // Each observer's buffers grow with the first events that it is told.
    stopper.stops(WARM_UP)?;
    let begun = gateway.memory()?;
    let loaded = stopper.stops(count)?;
    let ended = gateway.memory()?;
    // What was told last is under way.
    std::thread::sleep(Duration::from_secs(2));
    let told = crowd.report()?;
    for (name, percent) in [("p50", 50), ("p99", 99)] {
        let (idle, loaded) = (percentile(&idle, percent), percentile(&loaded, percent));
        let ratio = loaded.as_secs_f64() / idle.as_secs_f64();
        println!("FAST STOP to the device, {name} of {count}: idle {idle:?}, loaded {loaded:?}, ratio {ratio:.2}");
    }
    println!(
        "memory: {before:.1} MiB idle, {begun:.1} MiB loaded, {ended:.1} MiB at the end ({:+.1} %)",
        (ended / begun - 1.0) * 100.0
    );
    println!(
        "events: {} observers read all of them, {} missed some; {} motions were refused",
        told["complete"], told["incomplete"], told["refused"]
    );
    println!("gateway:   {fan_out}");
    drop((crowd, gateway));
    mosquitto(seconds, processors.as_deref())
}

/// What is delivered in so many seconds, and what it costs.
fn fan_out(crowd: &mut Crowd, server: &Running, seconds: usize) -> Result<String, Error> {
    let delivered = |crowd: &mut Crowd| crowd.report().map(|told| told["delivered"].as_f64().unwrap_or_default());
    let (begun, before, time) = (Instant::now(), delivered(crowd)?, server.time()?);
    std::thread::sleep(Duration::from_secs(seconds as u64));
    let (told, time) = (delivered(crowd)? - before, server.time()? - time);
    let second = told / begun.elapsed().as_secs_f64();
    Ok(format!("{second:.0} deliveries a second, {:.1} s of processor time for a million", time / told * 1e6))
}

fn mosquitto(seconds: usize, processors: Option<&str>) -> Result<(), Error> {
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let mut command = Command::new("mosquitto");
    let started = command.args(["-p", &port.to_string()]).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    let Ok(child) = started else {
        println!("mosquitto: not installed");
        return Ok(());
    };
    let server = Running(child);
    let address = format!("127.0.0.1:{port}");
    while std::net::TcpStream::connect(&address).is_err() {}
    if let Some(processors) = processors {
        bind(server.0.id(), processors)?;
    }
    let mut crowd = Crowd::start("mqtt", &address)?;
    println!("mosquitto: {}", fan_out(&mut crowd, &server, seconds)?);
    Ok(())
}
