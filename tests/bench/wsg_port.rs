//! Round trip of a Loop through the WSG port, compared with HAProxy in TCP mode, in turn in one run, while three other
//! clients use the WSG port.
//!
//! `cargo bench --bench wsg_port`. Times are noisy; compare the ratio.

mod directory;
mod program;

use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use directory::Directory;
use program::{Error, Running, start};
use wsg_gateway::wsg::{self, ChecksumEvaluation, Decoded, Decoder, LoopData, Updates, id};

/// Rounds. Each measures as many round trips through HAProxy, and then through the WSG port.
const ROUNDS: usize = 40;
const OF_A_ROUND: usize = 500;

/// Unmeasured rounds at the start.
const WARM_UP: usize = 2;

/// Polling interval of the other clients, as in real scripts.
const POLLED_EVERY: Duration = Duration::from_millis(20);

/// A client that waits for each answer.
struct Client {
    stream: TcpStream,
    decoder: Decoder,
}

impl Client {
    fn connect(address: &str) -> Result<Self, Error> {
        let address: SocketAddr = address.parse()?;
        let deadline = Instant::now() + Duration::from_secs(5);
        loop {
            match TcpStream::connect(address) {
                Ok(stream) => {
                    stream.set_nodelay(true)?;
                    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
                    return Ok(Self { stream, decoder: Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On) });
                }
                Err(error) if Instant::now() > deadline => return Err(error.into()),
                Err(_) => thread::sleep(Duration::from_millis(10)),
            }
        }
    }

    /// Returns the status of the next reply with this id.
    fn ask(&mut self, command: &wsg::Command) -> Result<u16, Error> {
        let mut frame = Vec::new();
        command.encode(&mut frame);
        self.stream.write_all(&frame)?;
        let mut bytes = [0; 512];
        loop {
            let read = self.stream.read(&mut bytes)?;
            if read == 0 {
                return Err("closed".into());
            }
            self.decoder.push(&bytes[..read]);
            while let Some(decoded) = self.decoder.next() {
                if let Decoded::Frame(reply) = decoded
                    && reply.id == command.id()
                {
                    return Ok(u16::from_le_bytes([reply.payload[0], reply.payload[1]]));
                }
            }
        }
    }
}

fn main() -> Result<(), Error> {
    let (_relayed, relayed) = start(&["sim", "tcp://127.0.0.1:0"], " at tcp://")?;
    let (_served, served) = start(&["sim", "tcp://127.0.0.1:0"], " at tcp://")?;
    let gripper = format!("g=tcp://{served}");
    let zenoh = "tcp/127.0.0.1:0";
    let arguments =
        ["--listen", "127.0.0.1:0", "--zenoh-listen", zenoh, "--gripper", &gripper, "--wsg-port", "g=127.0.0.1:0"];
    let (_gateway, said) = start(&arguments, "WSG port of g: tcp://")?;
    let free = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let directory = Directory::new("wsg_port")?;
    let configuration = directory.0.join("haproxy.cfg");
    let times = "timeout connect 5s\n timeout client 1h\n timeout server 1h";
    let relay =
        format!("defaults\n mode tcp\n {times}\nlisten relay\n bind 127.0.0.1:{free}\n server device {relayed}\n");
    std::fs::write(&configuration, relay)?;
    let relay = Command::new("haproxy").args(["-db", "-f"]).arg(configuration).stderr(Stdio::null()).spawn();
    let _relay = Running(relay.map_err(|error| format!("haproxy is needed: {error}"))?);

    let mut through_relay = Client::connect(&format!("127.0.0.1:{free}"))?;
    let mut through_port = Client::connect(&said)?;
    let command = wsg::Command::Loop(LoopData::new(vec![0x55; 16]).ok_or("too long")?);
    let deadline = Instant::now() + Duration::from_secs(5);
    while through_port.ask(&command)? != 0 {
        if Instant::now() > deadline {
            return Err("the gripper does not become ready".into());
        }
    }
    let (ends, polls) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicU64::new(0)));
    let others: Vec<_> = (0..3).map(|_| poll(said.clone(), ends.clone(), polls.clone())).collect();
    let (mut by_relay, mut by_port) = (Vec::new(), Vec::new());
    for round in 0..WARM_UP + ROUNDS {
        let relay = timed(&mut through_relay, &command)?;
        let port = timed(&mut through_port, &command)?;
        if round >= WARM_UP {
            by_relay.extend(relay);
            by_port.extend(port);
        }
    }
    ends.store(true, Ordering::Relaxed);
    for other in others {
        other.join().map_err(|_| "another client panicked")??;
    }
    report(&mut by_relay, &mut by_port, polls.load(Ordering::Relaxed));
    Ok(())
}

/// Starts another client that polls with automatic updates on.
fn poll(address: String, ends: Arc<AtomicBool>, polls: Arc<AtomicU64>) -> thread::JoinHandle<Result<(), Error>> {
    thread::spawn(move || {
        let mut client = Client::connect(&address)?;
        client.ask(&wsg::Command::GetWidth(Updates::On { on_change: false, period_ms: 20 }))?;
        while !ends.load(Ordering::Relaxed) {
            client.ask(&wsg::Command::GetSystemState(Updates::Off))?;
            polls.fetch_add(1, Ordering::Relaxed);
            thread::sleep(POLLED_EVERY);
        }
        Ok(())
    })
}

/// Returns the times of the round trips of one round.
fn timed(client: &mut Client, command: &wsg::Command) -> Result<Vec<Duration>, Error> {
    let timed = |_| {
        let begun = Instant::now();
        match client.ask(command)? {
            0 => Ok(begun.elapsed()),
            status => Err(format!("status {status}").into()),
        }
    };
    (0..OF_A_ROUND).map(timed).collect()
}

fn report(by_relay: &mut [Duration], by_port: &mut [Duration], polls: u64) {
    by_relay.sort_unstable();
    by_port.sort_unstable();
    println!(
        "a Loop of 16 bytes, {ROUNDS} rounds of {OF_A_ROUND} round trips each, in turn, during {polls} polls of three other \
         clients"
    );
    for (name, percent) in [("p50", 50), ("p99", 99)] {
        let of = |times: &[Duration]| times[(times.len() - 1) * percent / 100];
        let (relay, port) = (of(by_relay), of(by_port));
        let ratio = port.as_secs_f64() / relay.as_secs_f64();
        println!("{name}: through HAProxy {relay:?}, through the WSG port {port:?}, ratio {ratio:.2}");
    }
}
