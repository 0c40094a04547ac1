//! A servo session: the client's newest target, and when the device gets it.
//!
//! A session holds one target, or one series of targets. A newer one takes its place, so no target ever waits behind an
//! older one. The actor sends the targets and decides what ends a session.

use std::time::{Duration, Instant};

use jiff::Timestamp;

use super::Now;
use model::error::{Conflict, Invalid};
use model::{Client, CommandId, LeaseToken, ServoAdapter, ServoAim, ServoEnd, ServoReport, ServoTarget, ServoTerms};
use wsg::{Speed, Width};

/// Time between two targets that the gateway interpolates.
const INTERPOLATED_EVERY: Duration = Duration::from_millis(10);

/// Time after which a script that moves on with its last speed gets the same width again. It is longer than the time
/// between the targets of a client at 30 Hz, which then do not wait for repeated ones.
const REPEATED_EVERY: Duration = Duration::from_millis(50);

/// Longest time that one step of a ramp stands for: the fingers stood still before it.
const MAX_RAMP_STEP: Duration = Duration::from_millis(50);

/// Change of the target below which nothing is sent: it is beyond the resolution of any gripper.
const SAME_WIDTH_MM: f32 = 0.005;

/// Time for which a motion of the device goes on before a newer target ends it. Without it, fast targets would end each
/// motion before the fingers have moved.
const MOVES_FOR: Duration = Duration::from_millis(100);

/// Change of the target for which a motion of the device is ended early.
const ENDS_MOTION_MM: f32 = 0.5;

/// Time by which `at` may be ahead of the gateway's clock.
const AHEAD: Duration = Duration::from_secs(1);

/// A width that the fingers are to reach.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Aim {
    width_mm: f32,
    /// Time at which the gateway received the target.
    at: Instant,
}

/// The newest target of the client.
#[derive(Debug)]
struct Plan {
    aim: ServoAim,
    speed: Speed,
    received_at: Instant,
    /// Time of the first width.
    begins_at: Instant,
    is_sent: bool,
}

impl Plan {
    fn ends_at(&self) -> Instant {
        match &self.aim {
            ServoAim::Width(_) => self.received_at,
            ServoAim::Widths(widths, step) => self.begins_at + *step * (widths.len() as u32).saturating_sub(1),
        }
    }

    /// The width at a time, between two given ones if there are several.
    fn aim_at(&self, now: Instant) -> Aim {
        let ServoAim::Widths(widths, step) = &self.aim else {
            return Aim { width_mm: self.last_mm(), at: self.received_at };
        };
        let steps = now.saturating_duration_since(self.begins_at).as_secs_f32() / step.as_secs_f32();
        let index = (steps as usize).min(widths.len().saturating_sub(1));
        let from = widths.get(index).map_or_else(|| self.last_mm(), |width| width.mm());
        let to = widths.get(index + 1).map_or(from, |width| width.mm());
        let width_mm = from + (to - from) * (steps - index as f32).clamp(0.0, 1.0);
        Aim { width_mm, at: now.min(self.ends_at()).max(self.received_at) }
    }

    fn last_mm(&self) -> f32 {
        match &self.aim {
            ServoAim::Width(width) => width.mm(),
            ServoAim::Widths(widths, _) => widths.last().map_or(0.0, |width| width.mm()),
        }
    }
}

/// A target that the device has got.
#[derive(Debug, Clone, Copy)]
struct Sent {
    command: CommandId,
    aim: Aim,
    at: Instant,
    /// Time at which this width was sent for the first time.
    same_since: Instant,
    answered_at: Option<Instant>,
    /// Whether the motion was ended for a newer target.
    is_ended_early: bool,
}

/// A target to send now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct DueTarget {
    pub width: Width,
    pub speed: Speed,
}

/// An open session.
#[derive(Debug)]
pub(super) struct ServoSession {
    pub client: Client,
    pub token: Option<LeaseToken>,
    pub adapter: ServoAdapter,
    pub terms: ServoTerms,
    /// Whether the force limit is set, or need not be.
    pub is_ready: bool,
    began: Now,
    /// Time of the newest accepted target.
    heard_at: Instant,
    newest_at: Option<Timestamp>,
    plan: Option<Plan>,
    sent: Option<Sent>,
    report: ServoReport,
}

impl ServoSession {
    pub(super) fn begin(
        now: Now,
        client: Client,
        token: Option<LeaseToken>,
        adapter: ServoAdapter,
        terms: ServoTerms,
        rate_hz: Option<f32>,
    ) -> Self {
        let report = ServoReport {
            open: true,
            ended: None,
            by: client.subject.clone(),
            adapter,
            timeout_ms: terms.timeout.as_millis() as u64,
            max_speed_mm_s: terms.max_speed.mm_s(),
            started_at: now.wall,
            target_mm: None,
            applied_mm: None,
            applied_at: None,
            applied_age_ms: None,
            rate_hz,
            accepted: 0,
            superseded: 0,
            refused: 0,
            longest_gap_ms: 0,
            travel_mm: 0.0,
        };
        let is_ready = terms.force.is_none();
        let heard_at = now.instant;
        Self {
            client,
            token,
            adapter,
            terms,
            is_ready,
            began: now,
            heard_at,
            newest_at: None,
            plan: None,
            sent: None,
            report,
        }
    }

    /// Whether a request comes from the client that steers.
    pub(super) fn is_of(&self, client: &Client, token: Option<&LeaseToken>) -> bool {
        self.client.subject == client.subject && self.token.as_ref() == token
    }

    /// Time at which the session is over unless a newer target comes.
    pub(super) fn silent_at(&self) -> Instant {
        let plan_ends_at = self.plan.as_ref().map_or(self.heard_at, Plan::ends_at);
        self.heard_at.max(plan_ends_at) + self.terms.timeout
    }

    /// Checks the time of a target.
    pub(super) fn check_time(&self, now: Now, at: Option<Timestamp>) -> Result<(), Conflict> {
        let Some(at) = at else { return Ok(()) };
        let age = now.wall.duration_since(at);
        let timeout = jiff::SignedDuration::try_from(self.terms.timeout).unwrap_or(jiff::SignedDuration::MAX);
        let ahead = jiff::SignedDuration::try_from(AHEAD).unwrap_or(jiff::SignedDuration::MAX);
        let why = if self.newest_at.is_some_and(|newest| at <= newest) {
            "its `at` is not later than that of the newest target"
        } else if age > timeout {
            "its `at` is older than the session's time-out"
        } else if -age > ahead {
            "its `at` is more than 1 s ahead of the gateway's clock"
        } else {
            return Ok(());
        };
        Err(Conflict::StaleTarget { why })
    }

    /// Checks the speeds of a target, also those between the widths of a series.
    pub(super) fn check_speeds(&self, target: &ServoTarget) -> Result<(), Invalid> {
        let max = self.terms.max_speed.mm_s();
        if let Some(speed) = target.speed.filter(|speed| speed.mm_s() > max) {
            return Err(too_fast("speed_mm_s", speed.mm_s(), max));
        }
        if let ServoAim::Widths(widths, step) = &target.aim {
            let fastest = widths.windows(2).map(|pair| (pair[1].mm() - pair[0].mm()).abs()).fold(0.0, f32::max);
            let speed = fastest / step.as_secs_f32();
            if speed > max {
                return Err(too_fast("widths_mm", speed, max));
            }
        }
        Ok(())
    }

    /// Takes a target that was checked. It replaces the one before.
    pub(super) fn accept(&mut self, now: Now, target: ServoTarget) {
        let gap = now.instant.saturating_duration_since(self.heard_at).as_millis() as u64;
        if self.report.accepted > 0 {
            self.report.longest_gap_ms = self.report.longest_gap_ms.max(gap);
        }
        self.report.accepted += 1;
        if self.plan.as_ref().is_some_and(|plan| !plan.is_sent) {
            self.report.superseded += 1;
        }
        let begins_at = match target.aim {
            ServoAim::Width(_) => now.instant,
            ServoAim::Widths(..) => instant_of(now, target.at),
        };
        let plan = Plan {
            speed: target.speed.unwrap_or(self.terms.max_speed),
            aim: target.aim,
            received_at: now.instant,
            begins_at,
            is_sent: false,
        };
        self.report.target_mm = Some(plan.last_mm());
        self.plan = Some(plan);
        self.heard_at = now.instant;
        self.newest_at = target.at.or(self.newest_at);
    }

    pub(super) fn refuse(&mut self) {
        self.report.refused += 1;
    }

    /// Time at which the device can get the next target, if there is one.
    pub(super) fn sends_at(&self) -> Option<Instant> {
        let plan = self.plan.as_ref().filter(|_| self.is_ready)?;
        let Some(sent) = self.sent else { return Some(plan.begins_at) };
        if plan.is_sent && sent.at >= plan.ends_at() {
            let is_on_the_way = (sent.aim.width_mm - plan.last_mm()).abs() > SAME_WIDTH_MM;
            let pause = if is_on_the_way { INTERPOLATED_EVERY } else { REPEATED_EVERY };
            return self.is_ramped().then(|| sent.at + pause);
        }
        match plan.aim {
            ServoAim::Width(_) => Some(plan.begins_at),
            ServoAim::Widths(..) => {
                let begins_at = plan.begins_at.max(sent.at + INTERPOLATED_EVERY);
                // Until the series begins, a ramped script has to get the width that it has.
                Some(if self.is_ramped() { begins_at.min(sent.at + REPEATED_EVERY) } else { begins_at })
            }
        }
    }

    /// Whether the script does not limit the speed, so that the gateway has to.
    fn is_ramped(&self) -> bool {
        self.adapter == ServoAdapter::PositionPd
    }

    /// The target that the device gets now, with fingers at `width_mm`, if that is known.
    pub(super) fn due(&self, now: Instant, width_mm: Option<f32>) -> Option<DueTarget> {
        let plan = self.plan.as_ref().filter(|_| self.sends_at().is_some_and(|at| at <= now))?;
        let aim = self.aim(plan, now);
        let to_mm = if self.is_ramped() { self.ramped(now, aim.width_mm, plan.speed, width_mm) } else { aim.width_mm };
        let width = Width::new(to_mm).ok()?;
        Some(DueTarget { width, speed: plan.speed })
    }

    /// What the fingers are to reach now. Until a series begins, that is what they have to reach already.
    fn aim(&self, plan: &Plan, now: Instant) -> Aim {
        self.sent.filter(|_| now < plan.begins_at).map_or_else(|| plan.aim_at(now), |sent| sent.aim)
    }

    /// The width on the way to a target that the fingers may have reached by now.
    fn ramped(&self, now: Instant, target_mm: f32, speed: Speed, width_mm: Option<f32>) -> f32 {
        let from_mm = self.sent.map_or(width_mm.unwrap_or(target_mm), |sent| sent.aim.width_mm);
        let since = self.sent.map_or(INTERPOLATED_EVERY, |sent| now.saturating_duration_since(sent.at));
        let way_mm = speed.mm_s() * since.min(MAX_RAMP_STEP).as_secs_f32();
        from_mm + (target_mm - from_mm).clamp(-way_mm, way_mm)
    }

    /// Notes that the device gets the target that was due.
    pub(super) fn sent(&mut self, now: Instant, command: CommandId, target: DueTarget) {
        let due_at = self.sends_at();
        let same_since = self.same_since().filter(|_| self.has_target(target)).unwrap_or(now);
        let Some(plan) = &self.plan else { return };
        let aim = Aim { width_mm: target.width.mm(), ..self.aim(plan, now) };
        let has_begun = now >= plan.begins_at;
        if let Some(plan) = &mut self.plan {
            plan.is_sent |= has_begun;
        }
        if let Some(before) = self.sent.filter(|before| before.answered_at > due_at) {
            // The target has waited for the device.
            let interval = now.saturating_duration_since(before.at).as_secs_f32();
            self.report.rate_hz = Some(smoothed(self.report.rate_hz, 1.0 / interval.max(0.001)));
        }
        self.sent = Some(Sent { command, aim, at: now, same_since, answered_at: None, is_ended_early: false });
    }

    /// Whether the device is at this target already, or moves towards it.
    pub(super) fn has_target(&self, target: DueTarget) -> bool {
        let sent = self.sent.filter(|sent| !sent.is_ended_early);
        sent.is_some_and(|sent| (sent.aim.width_mm - target.width.mm()).abs() <= SAME_WIDTH_MM)
    }

    /// Leaves out a target that the device has got already.
    pub(super) fn leave_out(&mut self, now: Instant) {
        if let Some(plan) = &mut self.plan {
            plan.is_sent = true;
        }
        if let Some(sent) = &mut self.sent {
            sent.at = now;
        }
    }

    /// Time at which a motion of the device is ended for a newer target.
    pub(super) fn ends_motion_at(&self) -> Option<Instant> {
        let plan = self.plan.as_ref().filter(|_| self.adapter == ServoAdapter::Moves)?;
        let sent = self.sent.filter(|sent| sent.answered_at.is_none() && !sent.is_ended_early)?;
        let is_newer = (plan.last_mm() - sent.aim.width_mm).abs() > ENDS_MOTION_MM;
        is_newer.then(|| sent.at + MOVES_FOR)
    }

    pub(super) fn ended_motion_early(&mut self) {
        if let Some(sent) = &mut self.sent {
            sent.is_ended_early = true;
        }
    }

    /// Notes the answer of the device. Returns whether the command is the session's.
    pub(super) fn answered(&mut self, now: Now, command: CommandId) -> bool {
        let Some(sent) = self.sent.as_mut().filter(|sent| sent.command == command) else { return false };
        sent.answered_at = Some(now.instant);
        let age = now.instant.saturating_duration_since(sent.aim.at);
        self.report.applied_mm = Some(sent.aim.width_mm);
        self.report.applied_at = Some(now.wall);
        self.report.applied_age_ms = Some(age.as_secs_f64() * 1000.0);
        true
    }

    /// Time of the newest target that the device got.
    pub(super) fn last_sent_at(&self) -> Option<Instant> {
        self.sent.map(|sent| sent.at)
    }

    /// Time at which the device got the width of the newest target for the first time.
    pub(super) fn same_since(&self) -> Option<Instant> {
        self.sent.map(|sent| sent.same_since)
    }

    pub(super) fn travelled(&mut self, mm: f32) {
        self.report.travel_mm += f64::from(mm);
    }

    pub(super) fn report(&self) -> ServoReport {
        self.report.clone()
    }

    /// The report of the session when it ends.
    pub(super) fn end(mut self, why: ServoEnd) -> ServoReport {
        self.report.open = false;
        self.report.ended = Some(why);
        self.report
    }

    pub(super) fn lasted(&self, now: Now) -> Duration {
        now.instant.saturating_duration_since(self.began.instant)
    }
}

/// The time of a wall clock time, which is now if it is unknown.
fn instant_of(now: Now, at: Option<Timestamp>) -> Instant {
    let Some(at) = at else { return now.instant };
    if let Ok(ahead) = Duration::try_from(at.duration_since(now.wall)) {
        return now.instant + ahead;
    }
    let age = Duration::try_from(now.wall.duration_since(at)).unwrap_or_default();
    now.instant.checked_sub(age).unwrap_or(now.instant)
}

fn too_fast(field: &'static str, value: f32, max: f32) -> Invalid {
    Invalid::OutOfRange { field, value, min: 0.0, max, limit: "max_speed_mm_s of the servo session" }
}

/// The mean of recent rates.
fn smoothed(before: Option<f32>, rate: f32) -> f32 {
    before.map_or(rate, |before| before + (rate - before) / 8.0)
}
