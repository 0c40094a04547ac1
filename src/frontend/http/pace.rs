//! The pace of one connection's requests.

use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use tokio::time::{Instant, sleep_until};

/// Time of one request: a thousand a second are ten times what a 10 ms cycle needs.
const INTERVAL: Duration = Duration::from_millis(1);

/// How many requests may come at once before the pace counts: a page with all its parts, and a burst of a script.
const BURST: u32 = 128;

/// Delays the requests of a client that sends them faster than the pace, so that it takes its turn with the others. This
/// is the generic cell rate algorithm, which needs one instant.
#[derive(Debug, Default)]
pub struct RequestPace(Mutex<Option<Instant>>);

impl RequestPace {
    /// Waits until the next request may be served. Others are served meanwhile in any case.
    pub async fn next(&self) {
        match self.due(Instant::now()) {
            Some(at) => sleep_until(at).await,
            None => tokio::task::yield_now().await,
        }
    }

    /// Delays the next request of this connection, which asks for more than there is.
    pub fn delay(&self, time: Duration) {
        let mut arrival = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        *arrival = Some(Instant::now() + INTERVAL * BURST + time);
    }

    fn due(&self, now: Instant) -> Option<Instant> {
        let mut arrival = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let next = arrival.map_or(now, |at| at.max(now)) + INTERVAL;
        *arrival = Some(next);
        next.checked_sub(INTERVAL * BURST).filter(|at| *at > now)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn burst_passes_and_flood_is_paced() {
        let (pace, start) = (RequestPace::default(), Instant::now());
        for _ in 0..BURST {
            pace.next().await;
        }
        assert_eq!(start.elapsed(), Duration::ZERO);
        for _ in 0..500 {
            pace.next().await;
        }
        assert_eq!(start.elapsed(), INTERVAL * 500);
        tokio::time::advance(Duration::from_secs(1)).await;
        pace.delay(Duration::from_secs(3));
        let delayed = Instant::now();
        pace.next().await;
        assert_eq!(delayed.elapsed(), Duration::from_secs(3));
        tokio::time::advance(Duration::from_secs(1)).await;
        let later = Instant::now();
        pace.next().await;
        assert_eq!(later.elapsed(), Duration::ZERO);
    }
}
