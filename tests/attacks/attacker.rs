//! The attackers: a separate process, so that they take no time from the probe's threads, with a lower priority
//! (`nice`). It is this test program again, with the attack in an environment variable. It ends with its parent, or
//! after [`LASTS_AT_MOST`].

use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{IpAddr, SocketAddr};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};
use tokio::sync::Mutex;
use tokio::time::{Interval, MissedTickBehavior, interval, sleep, timeout};

use crate::{every_run, long};

/// Time limit of an attack, besides the time of a soak.
const LASTS_AT_MOST: Duration = Duration::from_secs(400);

/// Time for a crowd to connect before the probe starts anyway.
const GETS_IN_WITHIN: Duration = Duration::from_secs(8);

/// Pause before a closed connection is reopened.
const AGAIN_AFTER: Duration = Duration::from_millis(50);

/// Minimum time between two connections of a crowd, so that the attack is not a flood of connections.
const OPENS_EVERY: Duration = Duration::from_millis(1);

/// Polling interval of a crowd.
const LOOK_EVERY: Duration = Duration::from_millis(5);

const CONNECTS_WITHIN: Duration = Duration::from_secs(5);

/// Prefix of output lines that do not come from the test harness.
const MARK: &str = "ATTACK ";

/// Separator between the name of an attack and the address that its members connect from, as in `idle@127.0.0.2`.
const FROM: char = '@';

/// Environment variable that makes this program an attacker.
const ATTACK: &str = "WSG_ATTACK";

/// An attacker process, seen from its parent.
#[derive(Debug)]
pub struct Attacker {
    child: Child,
    asks: ChildStdin,
    says: BufReader<ChildStdout>,
}

/// Counters of a crowd.
#[derive(Debug, Clone, Copy)]
pub struct Done {
    /// Connections open now.
    pub inside: usize,
    /// Connections opened so far.
    pub opened: usize,
    /// Requests sent, if the attack counts them.
    pub sent: usize,
}

impl Attacker {
    /// Starts an attack with `count` members, and waits until they are connected.
    pub fn start(attack: &str, count: usize, address: SocketAddr) -> Self {
        Self::with_niceness("10", attack, count, address)
    }

    /// Like [`Attacker::start`], but at normal priority.
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

    /// Reads the current counters.
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

/// Members of one attack, in the attacker's process.
#[derive(Debug)]
pub struct Crowd {
    pub address: SocketAddr,
    /// Address that the members connect from, if it is not the usual one.
    from: Option<IpAddr>,
    /// Target number of members.
    pub count: usize,
    inside: AtomicUsize,
    opened: AtomicUsize,
    sent: AtomicUsize,
    /// Ticks at which connections are opened.
    pace: Mutex<Interval>,
}

/// A member that is in place, until it is dropped.
#[derive(Debug)]
pub struct Inside<'a>(&'a Crowd);

impl Drop for Inside<'_> {
    fn drop(&mut self) {
        self.0.inside.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Crowd {
    /// Counts a member that is in place.
    pub fn inside(&self) -> Inside<'_> {
        self.inside.fetch_add(1, Ordering::Relaxed);
        Inside(self)
    }

    pub fn sent(&self, requests: usize) {
        self.sent.fetch_add(requests, Ordering::Relaxed);
    }

    pub fn opened(&self) {
        self.opened.fetch_add(1, Ordering::Relaxed);
    }

    /// Sends the beginning of a request, and waits for the end of the connection.
    pub async fn send_unfinished(&self, mut stream: TcpStream, beginning: &str) -> std::io::Result<()> {
        stream.write_all(beginning.as_bytes()).await?;
        let _inside = self.inside();
        let mut buffer = [0; 512];
        while stream.read(&mut buffer).await? > 0 {}
        Ok(())
    }

    /// Opens `count` connections, and reopens each when its member ends.
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
                    if let Ok(Ok(stream)) = timeout(CONNECTS_WITHIN, crowd.connect()).await {
                        crowd.opened();
                        // Retry however the member ended.
                        let _ = member(crowd.clone(), index, stream).await;
                    }
                    sleep(AGAIN_AFTER).await;
                }
            });
        }
    }

    /// Like [`Crowd::each`], but opens and reopens connections as fast as possible.
    pub fn each_at_once<F, M>(self: &Arc<Self>, count: usize, member: M)
    where
        F: Future<Output = std::io::Result<()>> + Send,
        M: Fn(Arc<Self>, usize, TcpStream) -> F + Clone + Send + Sync + 'static,
    {
        for index in 0..count {
            let (crowd, member) = (self.clone(), member.clone());
            tokio::spawn(async move {
                loop {
                    if let Ok(Ok(stream)) = timeout(CONNECTS_WITHIN, crowd.connect()).await {
                        crowd.opened();
                        // Closed by a reset, which leaves no port in TIME_WAIT.
                        let _ = stream.set_zero_linger();
                        let _ = member(crowd.clone(), index, stream).await;
                    } else {
                        sleep(AGAIN_AFTER).await;
                    }
                }
            });
        }
    }

    async fn connect(&self) -> std::io::Result<TcpStream> {
        let Some(from) = self.from else { return TcpStream::connect(self.address).await };
        let socket = TcpSocket::new_v4()?;
        socket.bind((from, 0).into())?;
        socket.connect(self.address).await
    }

    fn tell(&self) {
        let count = |counter: &AtomicUsize| counter.load(Ordering::Relaxed);
        println!("{MARK}{} {} {}", count(&self.inside), count(&self.opened), count(&self.sent));
    }
}

/// Body of the attacker process; does nothing without [`ATTACK`].
#[test]
fn role() {
    let Ok(attack) = std::env::var(ATTACK) else { return };
    let [name, count, address] = attack.split(' ').collect::<Vec<_>>()[..] else { panic!("{attack}") };
    let hard = getrlimit(Resource::Nofile).maximum;
    setrlimit(Resource::Nofile, Rlimit { current: hard, maximum: hard }).unwrap();
    let (count, address) = (count.parse().unwrap(), address.parse().unwrap());
    let (name, from) = name.split_once(FROM).map_or((name, None), |(name, from)| (name, from.parse().ok()));
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let _entered = runtime.enter();
    let mut pace = interval(OPENS_EVERY);
    pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let (inside, opened, sent) = <(AtomicUsize, AtomicUsize, AtomicUsize)>::default();
    let crowd = Arc::new(Crowd { address, from, count, inside, opened, sent, pace: Mutex::new(pace) });
    std::thread::spawn(|| {
        std::thread::sleep(LASTS_AT_MOST + long::soak_time());
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
