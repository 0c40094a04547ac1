//! Readiness, shutdown and watchdog messages for systemd (sd_notify(3)). Without systemd, they have no effect.

use std::time::Duration;

use sd_notify::NotifyState;
use tokio::time::{interval, timeout};

use crate::gripper::Grippers;

/// Checks per watchdog time-out, of which one has to succeed.
const CHECKS_PER_TIMEOUT: u32 = 4;

/// Reports that all interfaces listen.
pub(super) fn ready() {
    send(NotifyState::Ready);
}

/// Reports that a reload has begun, which [`ready`] ends.
pub(super) fn reloading() {
    match NotifyState::monotonic_usec_now() {
        Ok(now) => send_all(&[NotifyState::Reloading, now]),
        Err(error) => tracing::warn!(%error, "systemd not notified"),
    }
}

/// Reports that the shutdown has begun.
pub(super) fn stopping() {
    send(NotifyState::Stopping);
}

/// Feeds the watchdog while the actors of all grippers respond. Never returns.
pub(super) async fn feed_watchdog(grippers: &Grippers) {
    let Some(time_out) = sd_notify::watchdog_enabled() else { return std::future::pending().await };
    let period = time_out / CHECKS_PER_TIMEOUT;
    let mut ticks = interval(period.max(Duration::from_millis(1)));
    loop {
        ticks.tick().await;
        let grippers = grippers.all();
        let responses = grippers.iter().map(crate::gripper::Handle::responds);
        match timeout(period, futures_util::future::join_all(responses)).await {
            Ok(alive) if alive.iter().all(|is_alive| *is_alive) => send(NotifyState::Watchdog),
            _ => tracing::warn!("watchdog not fed: a gripper's task does not respond"),
        }
    }
}

fn send(message: NotifyState<'_>) {
    send_all(&[message]);
}

fn send_all(messages: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(messages) {
        tracing::warn!(%error, "systemd not notified");
    }
}
