//! The pace of one connection's requests.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::{Instant, sleep_until};

/// Time of one request: a thousand a second are ten times what a 10 ms cycle needs.
const INTERVAL: Duration = Duration::from_millis(1);

/// How many requests may come at once before the pace counts: a page with all its parts, and a burst of a script.
const BURST: u32 = 128;

/// Delays the requests of a client that sends them faster than the pace, so that it takes its turn with the others. This
/// is the generic cell rate algorithm, which needs one instant.
#[derive(Debug, Default)]
pub struct RequestPace(Mutex<State>);

/// Time of one FAST STOP of a connection, and how many may come at once. Each stops all that it names, so more are of no
/// use.
const FAST_STOP_INTERVAL: Duration = Duration::from_millis(10);
const FAST_STOP_BURST: u32 = 16;

#[derive(Debug, Default)]
struct State {
    /// The same for FAST STOPs.
    fast_stop_arrival: Option<Instant>,
    /// When the requests that have come would have ended at the pace.
    arrival: Option<Instant>,
    /// Before this time only urgent requests are served.
    delayed_until: Option<Instant>,
}

impl RequestPace {
    /// Waits until the next request may be served. Always yields, so that other connections get a turn.
    pub async fn next(&self, is_urgent: bool) {
        match self.due(Instant::now(), is_urgent) {
            Some(at) => sleep_until(at).await,
            None => tokio::task::yield_now().await,
        }
    }

    /// The same for a FAST STOP.
    pub async fn next_fast_stop(&self) {
        let due = advance(&mut self.state().fast_stop_arrival, Instant::now(), FAST_STOP_INTERVAL, FAST_STOP_BURST);
        if let Some(at) = due {
            sleep_until(at).await;
        }
    }

    /// Delays the next request of this connection, unless it is urgent.
    pub fn delay(&self, time: Duration) {
        self.state().delayed_until = Some(Instant::now() + time);
    }

    /// When the request that has come now may be served; `None` where it may be served at once.
    pub fn due(&self, now: Instant, is_urgent: bool) -> Option<Instant> {
        let mut state = self.state();
        let at_pace = advance(&mut state.arrival, now, INTERVAL, BURST);
        at_pace.max(state.delayed_until.filter(|at| !is_urgent && *at > now))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Counts one more request, and returns when it may be served, if not at once.
fn advance(arrival: &mut Option<Instant>, now: Instant, interval: Duration, burst: u32) -> Option<Instant> {
    let next = arrival.map_or(now, |at| at.max(now)) + interval;
    *arrival = Some(next);
    next.checked_sub(interval * burst).filter(|at| *at > now)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn burst_passes_and_flood_is_paced() {
        let (pace, start) = (RequestPace::default(), Instant::now());
        for _ in 0..BURST {
            pace.next(false).await;
        }
        assert_eq!(start.elapsed(), Duration::ZERO);
        for _ in 0..500 {
            pace.next(false).await;
        }
        assert_eq!(start.elapsed(), INTERVAL * 500);
        tokio::time::advance(Duration::from_secs(1)).await;
        pace.delay(Duration::from_secs(3));
        let delayed = Instant::now();
        pace.next(true).await;
        assert_eq!(delayed.elapsed(), Duration::ZERO, "an urgent request is never delayed");
        pace.next(false).await;
        assert_eq!(delayed.elapsed(), Duration::from_secs(3));
        tokio::time::advance(Duration::from_secs(1)).await;
        let later = Instant::now();
        pace.next(false).await;
        assert_eq!(later.elapsed(), Duration::ZERO);
    }
}
