//! The timers: all work that becomes due by itself, in one table.

use std::time::{Duration, Instant};

use super::super::Now;
use super::super::observed;
use super::Actor;
use super::purpose::Purpose;
use crate::wsg::Command;
use crate::wsg::session::Session;

/// Period of reading the temperature, which has no automatic updates (`fw4-en 3.4.7`) and changes slowly.
const TEMPERATURE_EVERY: Duration = Duration::from_secs(5);

/// Time that the clients' requests may take through their interfaces after the gateway had no processor time.
const FRONTEND_GRACE: Duration = Duration::from_millis(200);

/// A deadline of the actor.
#[derive(Debug, Clone, Copy)]
enum Timer {
    Silence,
    FastStop,
    Acknowledge,
    Settling,
    Lease,
    Journal,
    Motion,
    Curve,
    Repeats,
    Flicker,
    Streaming,
    Overdrive,
    Drain,
    Updates,
    Temperature,
}

type Deadline = fn(&Actor) -> Option<Instant>;
type Run = fn(&mut Actor, Now);

/// When the work of a timer is done.
enum Work {
    /// Once its deadline has come.
    Due(Run),
    /// After each input too: it may be due for another reason than time, which it looks at itself.
    Always(Run),
}

impl Timer {
    /// All timers, in the order in which their work is done.
    const ALL: [Self; 15] = [
        Self::Silence,
        Self::FastStop,
        Self::Acknowledge,
        Self::Settling,
        Self::Lease,
        Self::Journal,
        Self::Motion,
        Self::Curve,
        Self::Repeats,
        Self::Flicker,
        Self::Streaming,
        Self::Overdrive,
        Self::Drain,
        Self::Updates,
        Self::Temperature,
    ];

    /// Deadline and work of the timer.
    fn entry(self) -> (Deadline, Work) {
        match self {
            Self::Silence => {
                (|actor| actor.link.silence_at().filter(|_| actor.drain.is_none()), Work::Always(Actor::supervise))
            }
            Self::FastStop => (Actor::fast_stop_at, Work::Always(Actor::send_fast_stop_if_due)),
            Self::Acknowledge => (
                |actor| actor.latch.clears_at(),
                Work::Due(|actor, now| actor.latch.handle_timeout(now.instant, actor.observed.flags)),
            ),
            Self::Settling => (|actor| actor.motion.settles_at(), Work::Always(Actor::end_settled_motion)),
            Self::Lease => (|actor| actor.lease.next_timeout(), Work::Always(Actor::keep_up_lease)),
            Self::Journal => (|actor| Some(actor.recording.oldest_wait()?.0), Work::Due(Actor::give_up_recording)),
            Self::Motion => (
                |actor| actor.motion.starts_at().filter(|_| actor.link.is_up()),
                Work::Always(Actor::start_waiting_motion),
            ),
            Self::Curve => {
                (|actor| actor.recording.curve_ends_at(), Work::Due(|actor, _| actor.recording.finish_measuring()))
            }
            Self::Repeats => {
                (|actor| actor.recording.repeats.next_timeout(), Work::Due(|actor, _| actor.recording.record_repeats()))
            }
            Self::Flicker => (
                |actor| actor.recording.flicker.next_timeout(),
                Work::Due(|actor, now| actor.recording.record_flicker(now)),
            ),
            Self::Streaming => (
                |actor| actor.streaming.next_timeout(),
                Work::Due(|actor, now| actor.streaming.write(now, &mut actor.recording)),
            ),
            Self::Overdrive => (
                |actor| actor.settings.overdrive.next_timeout(),
                Work::Due(|actor, now| actor.settings.overdrive.expire(now.instant)),
            ),
            Self::Drain => {
                (|actor| actor.drain.as_ref().and_then(super::Drain::next_timeout), Work::Always(Actor::continue_drain))
            }
            Self::Updates => {
                (|actor| actor.observed.next_silent().filter(|_| actor.is_in_use()), Work::Due(Actor::renew_updates))
            }
            Self::Temperature => (Actor::temperature_due, Work::Due(Actor::ask_temperature)),
        }
    }
}

impl Actor {
    /// To be called when [`Actor::poll_timeout`] has come.
    pub fn handle_timeout(&mut self, now: Now) {
        if let Some(session) = &mut self.link.session {
            session.handle_timeout(now.instant);
        }
        self.settle(now);
    }

    /// When [`Actor::handle_timeout`] has to be called next.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let timers = Timer::ALL.into_iter().filter_map(|timer| timer.entry().0(self));
        timers.chain(self.link.session.as_ref().and_then(Session::poll_timeout)).min()
    }

    /// Does all that is due.
    pub(super) fn run_due_timers(&mut self, now: Now) {
        for timer in Timer::ALL {
            match timer.entry() {
                (_, Work::Always(run)) => run(self, now),
                (deadline, Work::Due(run)) if deadline(self).is_some_and(|at| at <= now.instant) => run(self, now),
                (_, Work::Due(_)) => {}
            }
        }
    }

    /// To be called before the next input when a deadline was come to much too late: what clients have sent meanwhile
    /// is on its way, and no holder is lost because the gateway could not hear it.
    pub fn overslept(&mut self, now: Now) {
        tracing::debug!(gripper = %self.config.name, "the gateway had no processor time");
        self.lease.extend(now.instant + FRONTEND_GRACE);
    }

    /// Whether the link is up and the gripper is not being given up.
    fn is_in_use(&self) -> bool {
        self.link.is_up() && self.drain.is_none()
    }

    fn fast_stop_at(&self) -> Option<Instant> {
        self.latch.repeats_at().filter(|_| self.link.session.is_some())
    }

    fn temperature_due(&self) -> Option<Instant> {
        self.observed.temperature_at.filter(|_| self.settings.has_temperature() && self.is_in_use())
    }

    fn renew_updates(&mut self, now: Now) {
        let period_ms = observed::period_ms(self.link.properties.bytes_per_second);
        while let Some(id) = self.observed.silent(now.instant) {
            self.observed.asked(now.instant, id);
            if let Some(command) = observed::switch_on(id, period_ms) {
                // A full lane is as good as no answer: it is asked again later.
                let _ = self.link.submit(now, command, Purpose::Upkeep);
            }
        }
    }

    fn ask_temperature(&mut self, now: Now) {
        self.observed.temperature_at = Some(now.instant + TEMPERATURE_EVERY);
        let _ = self.link.submit(now, Command::GetTemperature, Purpose::Upkeep);
    }
}
