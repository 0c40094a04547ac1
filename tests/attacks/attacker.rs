//! The attackers: a process of its own, so that they take no time from the probe's threads, which gives way to all
//! others (`nice`). It is this test program again, with the attack in its environment. It ends with its parent, at
//! the latest after [`LASTS_AT_MOST`].

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::SocketAddr;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::net::TcpStream;
use tokio::sync::Mutex;
use tokio::time::{Interval, MissedTickBehavior, interval, sleep, timeout};

use crate::{every_run, long};

/// The bound on an attack.
const LASTS_AT_MOST: Duration = Duration::from_secs(400);

/// The time that a crowd has to get in before the probe begins all the same.
const GETS_IN_WITHIN: Duration = Duration::from_secs(8);

/// The pause before a connection that has ended is opened again.
const AGAIN_AFTER: Duration = Duration::from_millis(50);

/// The least time between two connections of a crowd: it presses on, and is no flood of connections.
const OPENS_EVERY: Duration = Duration::from_millis(1);

/// The interval at which a crowd is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(5);

const CONNECTS_WITHIN: Duration = Duration::from_secs(5);

/// The lines of its standard output that are not of the test harness.
const MARK: &str = "ATTACK ";

/// The variable that makes this program an attacker.
const ATTACK: &str = "WSG_ATTACK";

/// The parent's side.
#[derive(Debug)]
pub struct Attacker {
    child: Child,
    asks: ChildStdin,
    says: BufReader<ChildStdout>,
}

/// The counters of a crowd.
#[derive(Debug, Clone, Copy)]
pub struct Done {
    /// The connections that are open now.
    pub inside: usize,
    /// The connections that were opened.
    pub opened: usize,
    /// The requests that were sent, where an attack counts them.
    pub sent: usize,
}

impl Attacker {
    /// Starts so many of an attack, and waits until they are connected.
    pub fn start(attack: &str, count: usize, address: SocketAddr) -> Self {
        Self::with_niceness("10", attack, count, address)
    }

    /// The same, with as much processor time as all others have.
    pub fn start_selfish(attack: &str, count: usize, address: SocketAddr) -> Self {
        Self::with_niceness("0", attack, count, address)
    }

    fn with_niceness(niceness: &str, attack: &str, count: usize, address: SocketAddr) -> Self {
        let mut command = Command::new("nice");
        command.args(["-n", niceness]).arg(std::env::current_exe().unwrap());
        command.args(["attacker::role", "--exact", "--nocapture", "--test-threads=1"]);
        command.env(ATTACK, format!("{attack} {count} {address}"));
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
        let (asks, says) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        let mut attacker = Self { child, asks, says };
        let done = attacker.line();
        println!("{attack}: {} of {count} connections are open", done.inside);
        attacker
    }

    /// Its counters now.
    pub fn done(&mut self) -> Done {
        writeln!(self.asks).unwrap();
        self.line()
    }

    fn line(&mut self) -> Done {
        loop {
            let mut line = String::new();
            assert!(self.says.read_line(&mut line).unwrap() > 0, "the attacker has ended");
            let Some((_, numbers)) = line.split_once(MARK) else { continue };
            let numbers: Vec<_> = numbers.split_whitespace().map(|number| number.parse().unwrap()).collect();
            return Done { inside: numbers[0], opened: numbers[1], sent: numbers[2] };
        }
    }
}

impl Drop for Attacker {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The members of one attack, in the attacker's process.
#[derive(Debug)]
pub struct Crowd {
    pub address: SocketAddr,
    /// How many they are to be.
    pub count: usize,
    inside: AtomicUsize,
    opened: AtomicUsize,
    sent: AtomicUsize,
    /// The ticks at which connections are opened.
    pace: Mutex<Interval>,
}

/// A member that has done its part, until it is dropped.
#[derive(Debug)]
pub struct Inside<'a>(&'a Crowd);

impl Drop for Inside<'_> {
    fn drop(&mut self) {
        self.0.inside.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Crowd {
    /// Counts a member that is where it wants to be.
    pub fn inside(&self) -> Inside<'_> {
        self.inside.fetch_add(1, Ordering::Relaxed);
        Inside(self)
    }

    /// Counts requests.
    pub fn sent(&self, requests: usize) {
        self.sent.fetch_add(requests, Ordering::Relaxed);
    }

    /// Counts a connection.
    pub fn opened(&self) {
        self.opened.fetch_add(1, Ordering::Relaxed);
    }

    /// Opens so many connections, and each of them again when its member is done with it.
    pub fn each<F, M>(self: &Arc<Self>, count: usize, member: M)
    where
        F: Future<Output = std::io::Result<()>> + Send,
        M: Fn(Arc<Self>, usize, TcpStream) -> F + Clone + Send + Sync + 'static,
    {
        for index in 0..count {
            let (crowd, member) = (self.clone(), member.clone());
            tokio::spawn(async move {
                loop {
                    crowd.pace.lock().await.tick().await;
                    if let Ok(Ok(stream)) = timeout(CONNECTS_WITHIN, TcpStream::connect(crowd.address)).await {
                        crowd.opened();
                        // However it ends, it is tried again.
                        let _ = member(crowd.clone(), index, stream).await;
                    }
                    sleep(AGAIN_AFTER).await;
                }
            });
        }
    }

    fn tell(&self) {
        let count = |counter: &AtomicUsize| counter.load(Ordering::Relaxed);
        println!("{MARK}{} {} {}", count(&self.inside), count(&self.opened), count(&self.sent));
    }
}

/// The attacker's side. Without an attack in the environment it does nothing.
#[test]
fn role() {
    let Ok(attack) = std::env::var(ATTACK) else { return };
    let [name, count, address] = attack.split(' ').collect::<Vec<_>>()[..] else { panic!("{attack}") };
    let hard = getrlimit(Resource::Nofile).maximum;
    setrlimit(Resource::Nofile, Rlimit { current: hard, maximum: hard }).unwrap();
    let (count, address) = (count.parse().unwrap(), address.parse().unwrap());
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let _entered = runtime.enter();
    let mut pace = interval(OPENS_EVERY);
    pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (inside, opened, sent) = <(AtomicUsize, AtomicUsize, AtomicUsize)>::default();
    let crowd = Arc::new(Crowd { address, count, inside, opened, sent, pace: Mutex::new(pace) });
    std::thread::spawn(|| {
        std::thread::sleep(LASTS_AT_MOST);
        std::process::exit(1);
    });
    runtime.block_on(async {
        every_run::attack(name, &crowd, count);
        long::attack(name, &crowd, count);
        let begun = Instant::now();
        while crowd.inside.load(Ordering::Relaxed) < count && begun.elapsed() < GETS_IN_WITHIN {
            sleep(LOOK_EVERY).await;
        }
    });
    crowd.tell();
    for line in std::io::stdin().lock().lines() {
        if line.is_err() {
            break;
        }
        crowd.tell();
    }
    std::process::exit(0);
}
