//! The timers: all work that becomes due with time, in one table.

use std::time::{Duration, Instant};

use super::super::Now;
use super::super::{automatic_updates, observed};
use super::Actor;
use super::link::Purpose;
use wsg::Command;
use wsg::session::Session;

/// Time for clients' requests to pass through their interfaces after a stall of the gateway.
const FRONTEND_GRACE: Duration = Duration::from_millis(200);

/// A deadline of the actor, and its work.
struct Timer {
    deadline: fn(&Actor) -> Option<Instant>,
    run: fn(&mut Actor, Now),
    /// Whether the work can be due for reasons other than time. Such work runs after each input, and checks for itself.
    always: bool,
}

/// Work that is due only at its deadline.
const fn due(deadline: fn(&Actor) -> Option<Instant>, run: fn(&mut Actor, Now)) -> Timer {
    Timer { deadline, run, always: false }
}

const fn always(deadline: fn(&Actor) -> Option<Instant>, run: fn(&mut Actor, Now)) -> Timer {
    Timer { deadline, run, always: true }
}

/// All timers, in the order in which their work is done.
const TIMERS: [Timer; 21] = [
    always(|actor| actor.observed.values.ends_at(), Actor::expire_values),
    always(Actor::silence_at, Actor::supervise),
    always(Actor::fast_stop_at, Actor::send_fast_stop_if_due),
    due(
        |actor| actor.latch.clears_at(),
        |actor, now| actor.latch.handle_timeout(now.instant, actor.observed.last_flags()),
    ),
    always(|actor| actor.motion.settles_at(&actor.observed), Actor::end_settled_motion),
    always(|actor| actor.lease.next_timeout(), Actor::expire_lease),
    due(|actor| Some(actor.recording.oldest_wait()?.0), Actor::give_up_recording),
    always(Actor::motion_starts_at, Actor::start_waiting_motion),
    due(|actor| actor.recording.curve_ends_at(), |actor, _| actor.recording.finish_measuring()),
    due(|actor| actor.recording.repeats.next_timeout(), |actor, _| actor.recording.record_repeats()),
    due(|actor| actor.recording.flicker.next_timeout(), |actor, now| actor.recording.record_flicker(now)),
    due(|actor| actor.streaming.next_timeout(), |actor, now| actor.streaming.write(now, &mut actor.recording)),
    due(Actor::stream_silent_at, Actor::stop_silent_stream),
    due(Actor::servo_silent_at, Actor::end_silent_servo),
    always(Actor::servo_sends_at, Actor::send_servo_target),
    due(|actor| actor.settings.overdrive.next_timeout(), |actor, now| actor.settings.overdrive.expire(now.instant)),
    always(|actor| actor.drain.as_ref()?.next_timeout(), Actor::continue_drain),
    due(Actor::updates_missed_at, Actor::renew_updates),
    due(Actor::temperature_due, Actor::ask_temperature),
    due(Actor::round_trip_due, Actor::measure_round_trip),
    due(Actor::unconfirmed_due, Actor::read_unconfirmed),
];

impl Actor {
    /// Runs due work. Has to be called at the time of [`Actor::poll_timeout`].
    pub fn handle_timeout(&mut self, now: Now) {
        if let Some(session) = &mut self.link.session {
            session.handle_timeout(now.instant);
        }
        self.after_input(now);
    }

    /// Time of the next call of [`Actor::handle_timeout`].
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        let session = self.link.session.as_ref().and_then(Session::poll_timeout);
        TIMERS.iter().filter_map(|timer| (timer.deadline)(self)).chain(session).min()
    }

    pub(super) fn run_due_timers(&mut self, now: Now) {
        for Timer { deadline, run, always } in TIMERS {
            if always || deadline(self).is_some_and(|at| at <= now.instant) {
                run(self, now);
            }
        }
    }

    /// Extends the lease after a stall. Has to be called before the next input if a deadline was missed by far.
    /// Requests from that time are still on their way, and a stall of the gateway must not lose a lease holder.
    pub fn after_stall(&mut self, now: Now) {
        tracing::debug!(gripper = %self.config.name, "gateway stalled: no processor time");
        self.lease.extend(now.instant + FRONTEND_GRACE);
    }

    /// Whether the link is up and no drain is under way.
    pub(super) fn is_in_use(&self) -> bool {
        self.link.is_up() && self.drain.is_none()
    }

    fn fast_stop_at(&self) -> Option<Instant> {
        self.latch.repeats_at().filter(|_| self.link.session.is_some())
    }

    fn motion_starts_at(&self) -> Option<Instant> {
        self.motion.starts_at().filter(|_| self.link.is_up())
    }

    fn updates_missed_at(&self) -> Option<Instant> {
        self.observed.next_silent().filter(|_| self.is_in_use())
    }

    fn temperature_due(&self) -> Option<Instant> {
        self.observed.temperature_at.filter(|_| self.is_in_use())
    }

    fn renew_updates(&mut self, now: Now) {
        let rules = self.update_rules();
        let line = self.link.properties.bytes_per_second;
        while let Some(id) = self.observed.silent(now.instant) {
            self.observed.requested(now.instant, id);
            if let Some(command) = automatic_updates::switch_on(id, rules, line) {
                // A full queue counts as no reply: the request is repeated later.
                let _ = self.link.submit(now, command, Purpose::Upkeep);
            }
        }
    }

    fn ask_temperature(&mut self, now: Now) {
        self.observed.temperature_at = Some(now.instant + observed::TEMPERATURE_EVERY);
        let _ = self.link.submit(now, Command::GetTemperature, Purpose::Temperature);
    }
}
