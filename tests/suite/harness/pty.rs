//! Tests whose device is on a pty. A worker of the kernel moves a pty's bytes, and on a busy machine it can be kept
//! waiting for seconds.

use std::future::Future;
use std::panic::resume_unwind;
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::runtime::Builder;
use tokio::sync::oneshot;
use tokio::task::spawn_blocking;
use tokio::time::{sleep, timeout};
use tokio_serial::SerialStream;

/// Delay of a byte that can make a test fail: the longest gap within a frame.
const LATE: Duration = Duration::from_millis(100);

/// Interval of the bytes that measure the delay.
const MEASURED_EVERY: Duration = Duration::from_millis(5);

/// Maximum number of runs of a test.
const RUNS: usize = 5;

/// Number of consecutive bytes that must be in time before the next run.
const IN_TIME: usize = 200;

/// Longest wait for these bytes. After this time, the next run begins in any case.
const CALM_WITHIN: Duration = Duration::from_mins(1);

/// Runs a test. If it fails while bytes of another pty are late, waits until they are in time (see `calm`), and runs it
/// again. Each run has a runtime of its own.
pub async fn on_pty<T: Future<Output = ()>>(test: impl Fn() -> T + Copy + Send + 'static) {
    for run in 1..=RUNS {
        let (stop, is_over) = oneshot::channel();
        // On a thread and a runtime that the tested gateway cannot delay.
        let slowest = std::thread::spawn(move || {
            Builder::new_current_thread().enable_all().build().unwrap().block_on(slowest(is_over))
        });
        let runtime = Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
        let ended = spawn_blocking(move || runtime.block_on(test())).await;
        drop(stop);
        let slowest = slowest.join().unwrap();
        match ended {
            Ok(()) => return,
            Err(failed) if run == RUNS || slowest < LATE => resume_unwind(failed.into_panic()),
            Err(_) => println!("running again, because a byte of another pty took {slowest:?}"),
        }
        calm().await;
    }
}

/// Waits until bytes are in time again, for at most `CALM_WITHIN`.
async fn calm() {
    let (mut near, mut far) = SerialStream::pair().unwrap();
    let _ = timeout(CALM_WITHIN, async {
        let mut in_time = 0;
        while in_time < IN_TIME {
            in_time = if delivery(&mut near, &mut far).await < LATE { in_time + 1 } else { 0 };
            sleep(MEASURED_EVERY).await;
        }
    })
    .await;
}

/// Returns the slowest delivery of a byte until the sender of `is_over` is dropped.
async fn slowest(mut is_over: oneshot::Receiver<()>) -> Duration {
    let (mut near, mut far) = SerialStream::pair().unwrap();
    let mut slowest = Duration::ZERO;
    loop {
        let sent = Instant::now();
        tokio::select! {
            _ = &mut is_over => return slowest.max(sent.elapsed()),
            took = delivery(&mut near, &mut far) => slowest = slowest.max(took),
        }
        sleep(MEASURED_EVERY).await;
    }
}

/// Sends a byte from one side of a pty to the other, and returns how long it took.
async fn delivery(near: &mut SerialStream, far: &mut SerialStream) -> Duration {
    let sent = Instant::now();
    near.write_all(b"?").await.unwrap();
    far.read_u8().await.unwrap();
    sent.elapsed()
}
