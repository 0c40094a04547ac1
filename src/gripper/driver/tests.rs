use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use tokio::io::ReadBuf;

use super::*;
use crate::actor::tests::{TCP, client, config};
use crate::recorder::NullRecorder;
use model::Link;
use sim::{Device, DeviceConfig, Interface};
use transport::LinkProperties;

struct Datagrams(VecDeque<io::Result<&'static [u8]>>);

impl AsyncRead for Datagrams {
    fn poll_read(mut self: Pin<&mut Self>, _: &mut Context<'_>, out: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        match self.0.pop_front() {
            Some(read) => Poll::Ready(read.map(|bytes| out.put_slice(bytes))),
            None => Poll::Pending,
        }
    }
}

#[tokio::test]
async fn available_bytes_are_read_at_once_and_errors_come_after_them() {
    let refused = Err(io::ErrorKind::ConnectionRefused.into());
    let mut reader = Datagrams([Ok(&b"first"[..]), Ok(&b"second"[..]), refused].into());
    let (mut incoming, mut failed) = (vec![0; 64], None);
    assert_eq!(read_all(&mut reader, &mut incoming, &mut failed).await.unwrap(), 11);
    assert_eq!(&incoming[..11], b"firstsecond");
    let error = read_all(&mut reader, &mut incoming, &mut failed).await.unwrap_err();
    assert_eq!(error.kind(), io::ErrorKind::ConnectionRefused);
}

/// A device whose connection takes forever, and whether an attempt is under way.
#[derive(Default)]
struct Distant(Arc<AtomicBool>);

struct Attempt(Arc<AtomicBool>);

impl Drop for Attempt {
    fn drop(&mut self) {
        self.0.store(false, Ordering::Relaxed);
    }
}

impl Connector for Distant {
    fn url(&self) -> String {
        "test://distant".to_owned()
    }

    fn properties(&self) -> LinkProperties {
        TCP
    }

    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>> {
        self.0.store(true, Ordering::Relaxed);
        let attempt = Attempt(self.0.clone());
        Box::pin(async move {
            let _attempt = attempt;
            std::future::pending().await
        })
    }
}

#[tokio::test(start_paused = true)]
async fn disconnect_is_answered_after_the_attempt_to_connect() {
    let distant = Distant::default();
    let is_connecting = distant.0.clone();
    let handle = spawn(config(TCP), Arc::new(distant), Arc::new(NullRecorder), RestoredState::default());
    tokio::task::yield_now().await;
    assert!(is_connecting.load(Ordering::Relaxed));
    handle.disconnect(client(), None).await.unwrap();
    assert!(!is_connecting.load(Ordering::Relaxed), "nothing can open a connection any more");
    assert_eq!(handle.state().link, Link::Released);
}

/// A device that refuses all connections, and the times of the attempts.
#[derive(Default)]
struct Absent(Arc<Mutex<Vec<tokio::time::Instant>>>);

impl Connector for Absent {
    fn url(&self) -> String {
        "test://absent".to_owned()
    }

    fn properties(&self) -> LinkProperties {
        TCP
    }

    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>> {
        self.0.lock().unwrap().push(tokio::time::Instant::now());
        Box::pin(std::future::ready(Err(io::ErrorKind::ConnectionRefused.into())))
    }
}

#[tokio::test(start_paused = true)]
async fn pauses_between_attempts_double_up_to_two_seconds() {
    let absent = Absent::default();
    let attempts = absent.0.clone();
    let _handle = spawn(config(TCP), Arc::new(absent), Arc::new(NullRecorder), RestoredState::default());
    tokio::time::sleep(Duration::from_secs(12)).await;
    let attempts = attempts.lock().unwrap();
    let pauses: Vec<_> = attempts.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let longest = [100, 200, 400, 800, 1600, 2000, 2000, 2000].map(Duration::from_millis);
    assert!(pauses.len() >= longest.len(), "{pauses:?}");
    for (pause, longest) in pauses.iter().zip(longest) {
        // A timer fires up to a millisecond late.
        assert!(longest.mul_f64(0.75) <= *pause && *pause <= longest + Duration::from_millis(1), "{pauses:?}");
    }
}

/// A device that is set up, and drops each connection after a time.
struct Dropping {
    held_for: Duration,
    attempts: Arc<Mutex<Vec<tokio::time::Instant>>>,
}

impl Connector for Dropping {
    fn url(&self) -> String {
        "test://dropping".to_owned()
    }

    fn properties(&self) -> LinkProperties {
        TCP
    }

    fn connect(&self) -> Pin<Box<dyn Future<Output = io::Result<Pipe>> + Send + '_>> {
        self.attempts.lock().unwrap().push(tokio::time::Instant::now());
        let (ours, theirs) = tokio::io::duplex(4096);
        tokio::spawn(tokio::time::timeout(self.held_for, serve_simulated(theirs)));
        let (reader, writer) = tokio::io::split(ours);
        Box::pin(std::future::ready(Ok(Pipe::new(reader, writer))))
    }
}

async fn serve_simulated(mut stream: tokio::io::DuplexStream) {
    let mut device = Device::new(DeviceConfig::wsg50(), Now::read().instant);
    assert!(device.connect(Now::read().instant, Interface::Tcp));
    let mut buffer = [0; 1024];
    while let Ok(bytes) = stream.read(&mut buffer).await {
        device.receive(Now::read().instant, &buffer[..bytes]);
        let mut replies = Vec::new();
        while device.poll_transmit(&mut replies) {}
        stream.write_all(&replies).await.unwrap();
    }
}

/// Returns the pauses after links that last for this time.
async fn pauses_after_links_of(held_for: Duration) -> Vec<Duration> {
    let attempts: Arc<Mutex<Vec<_>>> = Arc::default();
    let dropping = Dropping { held_for, attempts: attempts.clone() };
    let _handle = spawn(config(TCP), Arc::new(dropping), Arc::new(NullRecorder), RestoredState::default());
    tokio::time::sleep(held_for * 6 + Duration::from_secs(4)).await;
    let attempts = attempts.lock().unwrap();
    attempts.windows(2).map(|pair| pair[1] - (pair[0] + held_for)).collect()
}

#[tokio::test(start_paused = true)]
async fn pauses_start_anew_only_after_a_link_that_has_lasted() {
    let short = pauses_after_links_of(Duration::from_secs(1)).await;
    for (pause, longest) in short.iter().zip([100, 200, 400, 800, 1600]) {
        let longest = Duration::from_millis(longest);
        assert!(longest.mul_f64(0.75) <= *pause && *pause <= longest + Duration::from_millis(2), "{short:?}");
    }
    let long = pauses_after_links_of(Duration::from_secs(11)).await;
    assert!(short.len() >= 5 && long.len() >= 5, "{short:?} {long:?}");
    assert!(long.iter().all(|pause| *pause <= Duration::from_millis(102)), "{long:?}");
}

#[tokio::test(start_paused = true)]
async fn owed_fast_stop_makes_the_pauses_short() {
    let absent = Absent::default();
    let attempts = absent.0.clone();
    let handle = spawn(config(TCP), Arc::new(absent), Arc::new(NullRecorder), RestoredState::default());
    tokio::time::sleep(Duration::from_secs(12)).await;
    let newest = *attempts.lock().unwrap().last().unwrap();
    // In the middle of a pause of 1.5 s or more.
    tokio::time::sleep_until(newest + Duration::from_millis(700)).await;
    attempts.lock().unwrap().clear();
    let requested = tokio::time::Instant::now();
    for _ in 0..20 {
        let reason = model::Reason::truncated("");
        handle.fast_stop(model::FastStopId::generate(), client(), reason).await;
    }
    let attempts = attempts.lock().unwrap().clone();
    assert!(attempts[0] <= requested + Duration::from_millis(2), "{:?}", attempts[0] - requested);
    assert!(attempts.len() >= 20, "{attempts:?}");
    for pair in attempts.windows(2) {
        let pause = pair[1] - pair[0];
        assert!((75..=102).contains(&pause.as_millis()), "neither longer nor a storm: {pause:?}");
    }
}

#[tokio::test]
async fn unread_replies_come_before_a_deadline_eight_times() {
    let (recorder, restored) = (Arc::new(NullRecorder), RestoredState::default());
    let (mut driver, _handle) = Driver::new(config(TCP), Arc::new(Absent::default()), recorder, restored);
    let pipe = Pipe::new(tokio::io::repeat(0), tokio::io::sink());
    let (mut link, passed) = (LinkIo::new(pipe), Some(Now::read().instant));
    for _ in 0..8 {
        assert!(matches!(driver.next_input(Some(&mut link), passed).await, Input::Read(Ok(_))));
    }
    assert!(matches!(driver.next_input(Some(&mut link), passed).await, Input::Deadline));
}
