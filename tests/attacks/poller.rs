//! A client that polls the state on one connection ten times a second, as a PLC does.

use std::io::Write as _;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::http;

const POLLS_EVERY: Duration = Duration::from_millis(100);

/// Results of the polls.
#[derive(Debug, Default)]
pub struct Polls {
    pub asked: usize,
    /// Polls without an answer, or with a status other than 200.
    pub lost: usize,
    pub slowest: Duration,
    pub first_loss: Option<String>,
}

/// A running poller.
#[derive(Debug)]
pub struct Poller {
    is_over: Arc<AtomicBool>,
    polling: JoinHandle<Polls>,
}

impl Poller {
    /// Starts polling the state of `g`.
    pub fn start(address: SocketAddr) -> Self {
        let is_over = Arc::<AtomicBool>::default();
        let ends = is_over.clone();
        Self { is_over, polling: std::thread::spawn(move || poll(address, &ends)) }
    }

    pub fn end(self) -> Polls {
        self.is_over.store(true, Ordering::Relaxed);
        self.polling.join().unwrap()
    }
}

fn poll(address: SocketAddr, is_over: &AtomicBool) -> Polls {
    let (mut polls, mut connection) = (Polls::default(), None);
    let request = http::request("GET", "/api/v1/grippers/g/state", "");
    while !is_over.load(Ordering::Relaxed) {
        let begun = Instant::now();
        polls.asked += 1;
        let loss = loop {
            let Some(open) = &mut connection else {
                match http::connect(address) {
                    Ok(fresh) => connection = Some(fresh),
                    Err(error) => break Some(format!("no connection: {error}")),
                }
                continue;
            };
            if let Err(error) = open.write_all(request.as_bytes()) {
                break Some(format!("the connection closed: {error}"));
            }
            break match http::read_answer(open) {
                Some(answer) if answer.status == 200 => None,
                Some(answer) => Some(format!("{} {}", answer.status, answer.body)),
                None => Some("the connection closed without an answer".to_owned()),
            };
        };
        polls.slowest = polls.slowest.max(begun.elapsed());
        if let Some(loss) = loss {
            connection = None;
            polls.lost += 1;
            polls.first_loss.get_or_insert(loss);
        }
        std::thread::sleep(POLLS_EVERY.saturating_sub(begun.elapsed()));
    }
    polls
}
