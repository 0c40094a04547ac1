//! A gateway process under chosen limits, with measurements of its memory and descriptors.

use std::fs::File;
use std::net::{SocketAddr, TcpStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::device::Device;
use crate::http;
use crate::mqtt::Mqtt;

/// Time for the gateway to start and connect to its devices.
const STARTS_WITHIN: Duration = Duration::from_secs(20);

const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Interval of the measurements.
const MEASURE_EVERY: Duration = Duration::from_millis(50);

/// A gateway that serves two devices as `g` and `h`, with a WSG port for each, and Modbus. It is killed by its own id on
/// drop.
#[derive(Debug)]
pub struct Gateway {
    child: Child,
    logged: PathBuf,
    pub address: SocketAddr,
    /// WSG port of `g`.
    pub port: SocketAddr,
    /// WSG port of `h`, if there is one.
    pub other_port: Option<SocketAddr>,
    /// Address of Modbus, where `g` is unit 1 and `h` is unit 2; `None` without Modbus.
    pub modbus: Option<SocketAddr>,
    pub zenoh: String,
    /// Broker of the gateway, if it uses one.
    pub mqtt: Option<Mqtt>,
    pub grippers: &'static [&'static str],
}

/// Limits of the gateway, besides those of this process.
#[derive(Debug, Clone, Copy)]
pub enum Limits {
    Inherited,
    /// Limits the number of file descriptors.
    Descriptors {
        soft: u32,
        hard: u32,
    },
    /// Limits the address space, so that excessive memory use ends the gateway rather than the machine.
    Memory {
        mb: u32,
    },
}

impl Gateway {
    /// Starts a gateway, and waits until both devices are connected.
    pub fn start(g: &Device, h: &Device, limits: Limits) -> Self {
        Self::with_broker(&serving(g, h), limits)
    }

    /// Starts a gateway whose journal is a file. A journal in memory grows with each event.
    pub fn with_journal_file(g: &Device, h: &Device) -> Self {
        let journal = format!("--journal={}", file("journal").display());
        Self::with_broker(&[&serving(g, h)[..], &[journal]].concat(), Limits::Inherited)
    }

    fn with_broker(arguments: &[String], limits: Limits) -> Self {
        // An aborted process with the same id may have left a journal.
        remove_files();
        let mqtt = Mqtt::start();
        let config = file("config");
        std::fs::write(&config, mqtt.section()).unwrap();
        let config = format!("--config={}", config.display());
        let mut gateway = Self::with(&[arguments, &[config]].concat(), &["g", "h"], limits);
        mqtt.until_subscribed();
        gateway.mqtt = Some(mqtt);
        gateway
    }

    /// Starts a gateway with `g` alone, and without Modbus.
    pub fn of(g: &Device, limits: Limits) -> Self {
        remove_files();
        let arguments = [format!("--gripper=g=tcp://{}", g.address), "--wsg-port=g=127.0.0.1:0".to_owned()];
        Self::with(&arguments, &["g"], limits)
    }

    fn with(arguments: &[String], grippers: &'static [&'static str], limits: Limits) -> Self {
        let (said, logged) = (file("out"), file("log"));
        let limits = match limits {
            Limits::Inherited => String::new(),
            Limits::Descriptors { soft, hard } => format!("ulimit -Sn {soft} && ulimit -Hn {hard} && "),
            Limits::Memory { mb } => format!("ulimit -v {} && ", u64::from(mb) * 1024),
        };
        let mut command = Command::new("sh");
        for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("WSG_GATEWAY")) {
            command.env_remove(name);
        }
        command
            .env("WSG_GATEWAY_JOURNAL", ":memory:")
            .args(["-c", &format!("{limits}exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_wsg-gateway")])
            .args(["--listen=127.0.0.1:0", "--zenoh-listen=tcp/127.0.0.1:0"])
            .args(arguments)
            .stdin(Stdio::null())
            .stdout(File::create(&said).unwrap())
            .stderr(File::create(&logged).unwrap());
        let mut child = command.spawn().unwrap();
        let until = Instant::now() + STARTS_WITHIN;
        let mut word_after = |before: &str| loop {
            let text = std::fs::read_to_string(&said).unwrap();
            // A line is complete once it has a line end.
            let line = text.split_once(before).and_then(|(_, rest)| rest.split_once('\n'));
            if let Some((line, _)) = line {
                return line.split_whitespace().next().unwrap().trim_end_matches('/').to_owned();
            }
            let log = || std::fs::read_to_string(&logged).unwrap();
            assert!(child.try_wait().unwrap().is_none(), "the gateway has ended: {}", log());
            assert!(Instant::now() < until, "no {before:?} within {STARTS_WITHIN:?}: {}", log());
            std::thread::sleep(LOOK_EVERY);
        };
        let address = word_after(" at http://").parse().unwrap();
        let port = word_after("WSG port of g: tcp://").parse().unwrap();
        let zenoh = word_after("Zenoh: ");
        let mut served = |argument: &str, before: &str| {
            let is_served = arguments.iter().any(|given| given.starts_with(argument));
            is_served.then(|| word_after(before).parse().unwrap())
        };
        let other_port = served("--wsg-port=h=", "WSG port of h: tcp://");
        let modbus = served("--modbus=", "Modbus: ");
        let gateway = Self { child, logged, address, port, other_port, modbus, zenoh, mqtt: None, grippers };
        for gripper in grippers {
            gateway.until_connected(gripper);
        }
        gateway
    }

    pub fn until_connected(&self, gripper: &str) {
        let (path, until) = (format!("/api/v1/grippers/{gripper}/state"), Instant::now() + STARTS_WITHIN);
        while http::get(self.address, &path).is_none_or(|answer| !answer.body.contains(r#""link":"connected""#)) {
            assert!(Instant::now() < until, "{gripper} is not connected within {STARTS_WITHIN:?}");
            std::thread::sleep(LOOK_EVERY);
        }
    }

    /// Log so far.
    pub fn log(&self) -> String {
        String::from_utf8_lossy(&std::fs::read(&self.logged).unwrap()).into_owned()
    }

    /// Opens an HTTP connection.
    pub fn connect(&self) -> std::io::Result<TcpStream> {
        http::connect(self.address)
    }

    /// Measures memory and descriptors once.
    pub fn usage(&self) -> Usage {
        usage(self.child.id()).expect("the gateway runs")
    }

    /// Measures memory and descriptors until [`Measurement::end`].
    pub fn measure(&self) -> Measurement {
        let (pid, is_over) = (self.child.id(), Arc::<AtomicBool>::default());
        let ends = is_over.clone();
        let measuring = std::thread::spawn(move || {
            let mut highest = Usage::default();
            while !ends.load(Ordering::Relaxed) {
                if let Some(now) = usage(pid) {
                    highest = Usage {
                        rss_mb: highest.rss_mb.max(now.rss_mb),
                        descriptors: highest.descriptors.max(now.descriptors),
                    };
                }
                std::thread::sleep(MEASURE_EVERY);
            }
            highest
        });
        Measurement { is_over, measuring }
    }
}

impl Drop for Gateway {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        let log = self.log();
        for line in log.lines().filter(|line| line.contains("panicked") || line.contains("ERROR")).take(5) {
            eprintln!("the gateway's log: {line}");
        }
        if std::thread::panicking() {
            let lines: Vec<_> = log.lines().collect();
            eprintln!("--- the end of the gateway's log ---\n{}", lines[lines.len().saturating_sub(20)..].join("\n"));
        }
        remove_files();
    }
}

/// Arguments for two devices with WSG ports and Modbus.
fn serving(g: &Device, h: &Device) -> [String; 5] {
    [
        format!("--gripper=g=tcp://{}", g.address),
        format!("--gripper=h=tcp://{}", h.address),
        "--wsg-port=g=127.0.0.1:0".to_owned(),
        "--wsg-port=h=127.0.0.1:0".to_owned(),
        "--modbus=127.0.0.1:0".to_owned(),
    ]
}

/// Path of a file of this process's gateway.
fn file(what: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(format!("{}-attacked-{what}", std::process::id()))
}

fn remove_files() {
    for what in ["out", "log", "config", "journal", "journal-wal", "journal-shm", "journal-lock"] {
        let _ = std::fs::remove_file(file(what));
    }
}

/// Memory and file descriptors of a process.
#[derive(Debug, Clone, Copy, Default)]
pub struct Usage {
    pub rss_mb: usize,
    pub descriptors: usize,
}

fn usage(pid: u32) -> Option<Usage> {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let rss_kb: usize = line.trim().trim_end_matches(" kB").parse().ok()?;
    let descriptors = std::fs::read_dir(format!("/proc/{pid}/fd")).ok()?.count();
    Some(Usage { rss_mb: rss_kb / 1024, descriptors })
}

/// A running measurement.
#[derive(Debug)]
pub struct Measurement {
    is_over: Arc<AtomicBool>,
    measuring: JoinHandle<Usage>,
}

impl Measurement {
    /// Ends the measurement, and returns the highest values.
    pub fn end(self) -> Usage {
        self.is_over.store(true, Ordering::Relaxed);
        self.measuring.join().unwrap()
    }
}
