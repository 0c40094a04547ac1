//! What is due by itself: repeating a FAST STOP, starting a motion after its pause, watching for silence, and keeping
//! the values fresh that have no updates.

use std::time::{Duration, Instant};

use super::super::Now;
use super::super::error::Failure;
use super::super::info::has_temperature;
use super::super::observed;
use super::link::{CLOSED_AFTER, UNRESPONSIVE_AFTER};
use super::{Actor, LinkState, Purpose};
use crate::wsg::Command;

/// The temperature has no automatic updates (`fw4-en 3.4.7`), and changes slowly.
const TEMPERATURE_EVERY: Duration = Duration::from_secs(5);

/// How long what clients have sent may take through their doors, after the gateway had no processor time.
const DOORS_TAKE: Duration = Duration::from_millis(200);

impl Actor {
    /// To be called before the next input when a deadline was come to much too late: what clients have sent meanwhile
    /// is on its way, and nobody is lost because nobody was there to hear.
    pub fn overslept(&mut self, now: Now) {
        tracing::debug!(gripper = %self.config.name, "the gateway had no processor time");
        self.lease.excuse(now.instant + DOORS_TAKE);
    }

    /// Does all that is due.
    pub(super) fn keep_up(&mut self, now: Now) {
        self.supervise(now);
        self.send_fast_stop_if_due(now);
        self.latch.handle_timeout(now.instant, self.observed.flags);
        self.end_settled_motion(now);
        self.keep_up_lease(now);
        self.give_up_recording(now);
        self.start_waiting_motion(now);
        self.finish_measuring_if_due(now);
        self.record_repeats_if_due(now);
        self.record_flicker_if_due(now);
        self.write_streamed_if_due(now);
        self.expire_awaiting_flags(now);
        if self.drain.is_some() {
            self.continue_drain(now);
        } else if matches!(self.link, LinkState::Up) {
            self.renew_updates(now);
            self.ask_temperature(now);
        }
    }

    /// When [`Actor::handle_timeout`] has to be called next.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let session = self.session.as_ref();
        let up = matches!(self.link, LinkState::Up) && self.drain.is_none();
        let silence = session.filter(|_| up).map(|session| {
            let after = if self.link_cause.is_some() { CLOSED_AFTER } else { UNRESPONSIVE_AFTER };
            session.last_heard() + after
        });
        let deadlines = [
            session.and_then(crate::wsg::session::Session::poll_timeout),
            silence,
            self.latch.next_timeout().filter(|_| session.is_some()),
            self.lease.next_timeout(),
            self.motion_due(),
            self.settles_at(),
            self.recording.next_timeout(),
            self.streaming.next_timeout(),
            self.awaiting_flags.iter().map(|(until, _)| *until).min(),
            self.observed.next_silent().filter(|_| up),
            self.temperature_at.filter(|_| up && self.reads_temperature()),
            self.drain.as_ref().and_then(super::Drain::next_timeout),
        ];
        deadlines.into_iter().flatten().min()
    }

    fn renew_updates(&mut self, now: Now) {
        let period_ms = observed::period_ms(self.config.traits.bytes_per_second);
        while let Some(id) = self.observed.silent(now.instant) {
            self.observed.asked(now.instant, id);
            if let Some(command) = observed::switch_on(id, period_ms) {
                // A full lane is as good as no answer: it is asked again later.
                let _ = self.submit(now, command, Purpose::Upkeep);
            }
        }
    }

    fn reads_temperature(&self) -> bool {
        self.system.as_ref().is_some_and(has_temperature)
    }

    fn ask_temperature(&mut self, now: Now) {
        if self.reads_temperature() && self.temperature_at.is_none_or(|at| at <= now.instant) {
            self.temperature_at = Some(now.instant + TEMPERATURE_EVERY);
            let _ = self.submit(now, Command::GetTemperature, Purpose::Upkeep);
        }
    }

    fn expire_awaiting_flags(&mut self, now: Now) {
        let (expired, waiting) =
            std::mem::take(&mut self.awaiting_flags).into_iter().partition(|(until, _)| *until <= now.instant);
        self.awaiting_flags = waiting;
        let expired: Vec<_> = expired;
        for (_, answer) in expired {
            let detail = "the flags do not show that Overdrive Mode was switched".to_owned();
            let _ = answer.send(Err(Failure::DeviceProtocol { command: "OverdriveMode", detail }.into()));
        }
    }
}
