//! Rate limit of one connection's requests.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::{Instant, sleep_until};

/// Interval of requests: a thousand a second are ten times the need of a 10 ms cycle.
const INTERVAL: Duration = Duration::from_millis(1);

/// Requests that can arrive at once before the limit applies: a page with all its assets, and a script's burst.
const BURST: u32 = 128;

/// Delays the requests of a client that exceeds the rate limit, so that others get their turn. Uses the generic cell
/// rate algorithm, which stores one instant.
#[derive(Debug, Default)]
pub struct RequestPace(Mutex<State>);

/// Interval and burst of a connection's FAST STOPs. Each one stops all grippers that it names, so more have no effect.
const FAST_STOP_INTERVAL: Duration = Duration::from_millis(10);
const FAST_STOP_BURST: u32 = 16;

#[derive(Debug, Default)]
struct State {
    /// Like `arrival`, for FAST STOPs.
    fast_stop_arrival: Option<Instant>,
    /// Time by which all requests so far would have been served at the limit.
    arrival: Option<Instant>,
    /// Time before which only urgent requests are served.
    delayed_until: Option<Instant>,
}

impl RequestPace {
    /// Waits until the next request is due. Always yields, so that other connections get a turn.
    pub async fn next(&self, is_urgent: bool) {
        match self.due(Instant::now(), is_urgent) {
            Some(at) => sleep_until(at).await,
            None => tokio::task::yield_now().await,
        }
    }

    /// Waits until the next FAST STOP is due.
    pub async fn next_fast_stop(&self) {
        if let Some(at) = self.fast_stop_due(Instant::now()) {
            sleep_until(at).await;
        }
    }

    /// Counts a FAST STOP and returns when it is due, or `None` if it is due at once.
    pub fn fast_stop_due(&self, now: Instant) -> Option<Instant> {
        advance(&mut self.state().fast_stop_arrival, now, FAST_STOP_INTERVAL, FAST_STOP_BURST)
    }

    /// Delays the next request of this connection, unless it is urgent.
    pub fn delay(&self, time: Duration) {
        self.state().delayed_until = Some(Instant::now() + time);
    }

    /// Counts a request and returns when it is due, or `None` if it is due at once.
    pub fn due(&self, now: Instant, is_urgent: bool) -> Option<Instant> {
        let mut state = self.state();
        let at_pace = advance(&mut state.arrival, now, INTERVAL, BURST);
        at_pace.max(state.delayed_until.filter(|at| !is_urgent && *at > now))
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Counts one more request and returns when it is due, or `None` if it is due at once.
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
