//! The latch: a FAST STOP that stays until it is acknowledged by its id.
//!
//! A requested FAST STOP is sent again until the device's flags confirm it. A FAST STOP that the gateway did not cause
//! becomes a latch too, confirmed from the start. If the device leaves its FAST STOP without an acknowledgement by the
//! latch's id, the latch stays; if a client requested the FAST STOP, it is sent again. Nothing is acknowledged
//! automatically.

use std::time::{Duration, Instant};

use super::Now;
use super::handle::{FastStopRequest, ResultSender};
use model::error::{Conflict, Invalid, Rejection};
use model::{Client, Door, FastStopCause, FastStopId, IdSource, Latch, Reason};
use wsg::SystemState;
use wsg::session::Token;

/// Period at which a FAST STOP is repeated until it is confirmed.
pub(super) const REPEAT_EVERY: Duration = Duration::from_millis(100);

/// Time for which the flags can still show FAST STOP after the device has acknowledged. `fw4-en 3.2.5` names no status
/// for a cause that persists, so the flag decides.
const CLEARS_WITHIN: Duration = Duration::from_millis(500);

/// Time for which a sent acknowledgement can still take effect: longer than the wait for its reply.
const ACKNOWLEDGE_LASTS: Duration = Duration::from_secs(2);

/// Longest time from a flag to the FAST STOP that the flag explains. A device sets both at once, but on a slow line
/// they can arrive at different times.
const EXPLAINS_WITHIN: Duration = Duration::from_millis(500);

/// Flags that can be set for hours without a FAST STOP. They explain a FAST STOP only if they are set at the same time.
/// A temperature, power or current fault, however, stops the gripper for as long as it lasts.
const STANDING: SystemState =
    SystemState::FINGER_FAULT.union(SystemState::SOFT_LIMIT_MINUS).union(SystemState::SOFT_LIMIT_PLUS);

/// Subject of a FAST STOP that no client requested.
const BY_DEVICE: &str = "device";

/// The FAST STOP of one gripper, its frames and its acknowledge.
#[derive(Debug, Default)]
pub(super) struct LatchState {
    latch: Option<Latch>,
    /// Number of FAST STOPs, also across restarts. It gives their order, since the wall clock behind an id can jump.
    epoch: u64,
    /// The 23h in flight.
    sent: Option<Token>,
    /// Whether the device has answered a 23h that was sent for this latch.
    answered: bool,
    /// Time from which the flags alone confirm the latch. Until then a pending acknowledgement could clear the FAST
    /// STOP that they show.
    flags_count_from: Option<Instant>,
    repeat_at: Option<Instant>,
    acknowledging: Option<Acknowledging>,
    /// Newest flags of [`STANDING`].
    flags: Option<SystemState>,
    /// Flags of [`STANDING`] that were set most recently, with the time.
    newest_flags: Option<(Instant, SystemState)>,
    /// Ended acknowledgements whose clients have not been answered yet.
    unanswered: Vec<EndedAcknowledge>,
}

/// An acknowledgement that has ended.
#[derive(Debug)]
pub(super) struct EndedAcknowledge {
    /// `None` for a fault of the device without a latch.
    pub id: Option<FastStopId>,
    pub client: Client,
    pub answer: ResultSender<()>,
    pub result: Result<(), Rejection>,
}

#[derive(Debug)]
struct Acknowledging {
    id: Option<FastStopId>,
    client: Client,
    answer: ResultSender<()>,
    progress: Progress,
}

#[derive(Debug)]
enum Progress {
    /// The flags are read before a fault is acknowledged, since the FAST STOP behind it may not have been seen yet.
    Checking(Token),
    Sent(Token),
    /// The device reported success, and its flags have until `until` to show it.
    Watching {
        until: Instant,
        shown: Shown,
    },
}

/// Flags seen since the device reported success.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shown {
    /// No flags have arrived.
    Nothing,
    FastStop,
}

/// Ids and cause for the latch of a FAST STOP that no client requested.
#[derive(Debug)]
pub(super) struct Origin<'a> {
    pub ids: &'a mut IdSource,
    /// Whether the gateway's last connection ended without an announcement.
    pub unannounced: bool,
}

/// Change of the latch after an update of the flags.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum LatchChange {
    /// The device is in a FAST STOP that no client requested. The pending acknowledgement of a fault must not reach the
    /// device any more.
    Seen { overtaken: Option<Token> },
    /// The flags confirm the latch.
    Confirmed,
    /// The acknowledgement has cleared the latch.
    Cleared,
    /// The device has left a FAST STOP that a client requested, and nobody has acknowledged it here. Another program can
    /// have done so, or the reply to the gateway's acknowledgement was lost.
    Forgotten,
}

impl LatchState {
    pub(super) fn current(&self) -> Option<&Latch> {
        self.latch.as_ref()
    }

    /// Number of the newest FAST STOP.
    pub(super) fn epoch(&self) -> u64 {
        self.epoch
    }

    pub(super) fn id(&self) -> Option<FastStopId> {
        self.latch.as_ref().map(|latch| latch.id)
    }

    /// Whether a FAST STOP is latched that the device has not confirmed.
    pub(super) fn is_unconfirmed(&self) -> bool {
        self.latch.as_ref().is_some_and(|latch| !latch.confirmed)
    }

    /// Restores the newest epoch after a restart of the gateway, and the latch if there was one. The latch is
    /// unconfirmed again, since the device may have forgotten its FAST STOP.
    pub(super) fn restore(&mut self, now: Instant, epoch: u64, latch: Option<Latch>) {
        self.epoch = epoch;
        self.latch = latch.map(|latch| Latch { confirmed: false, ..latch });
        self.flags_count_from = Some(now);
    }

    /// Takes the flags of a link that was set up. A device without a FAST STOP has forgotten it, so the latch is
    /// unconfirmed again, and 23h is sent.
    pub(super) fn link_set_up(&mut self, now: Instant, flags: Option<SystemState>) {
        // While an acknowledgement is under way, the flags may show its success.
        let is_forgotten =
            self.acknowledging.is_none() && flags.is_some_and(|flags| !flags.contains(SystemState::FAST_STOP));
        if is_forgotten && self.latch.as_ref().is_some_and(|latch| latch.confirmed) {
            self.forgotten(now);
        }
    }

    /// Notes that the device has left its FAST STOP without the gateway's acknowledgement, so that 23h is sent again.
    fn forgotten(&mut self, now: Instant) {
        if let Some(latch) = &mut self.latch {
            latch.confirmed = false;
        }
        self.answered = false;
        self.flags_count_from = Some(now);
        self.repeat_at = Some(now);
    }

    /// Latches a client's FAST STOP. Returns a pending acknowledgement, which must not reach the device afterwards.
    pub(super) fn request(&mut self, now: Now, request: FastStopRequest) -> Option<Token> {
        let was_acknowledging = self.acknowledging.is_some();
        let overtaken = self.overtake(request.id);
        self.epoch += 1;
        let earlier = self.latch.take().filter(|earlier| outlives(earlier, &request));
        let latch = Latch {
            id: request.id,
            by: request.client.subject,
            cause: request.cause,
            reason: request.reason,
            at: now.wall,
            confirmed: false,
        };
        self.latch = Some(match earlier {
            Some(Latch { by, cause, reason, .. }) => Latch { by, cause, reason, ..latch },
            None => latch,
        });
        self.sent = None;
        self.answered = false;
        self.repeat_at = Some(now.instant);
        self.flags_count_from = Some(now.instant + if was_acknowledging { ACKNOWLEDGE_LASTS } else { Duration::ZERO });
        overtaken
    }

    /// Ends a pending acknowledgement because of a newer FAST STOP. Returns its request.
    fn overtake(&mut self, current: FastStopId) -> Option<Token> {
        let Acknowledging { id, client, answer, progress } = self.acknowledging.take()?;
        let conflict = match id {
            Some(given) => Conflict::StaleFastStop { given, current: Some(current) },
            None => Conflict::FastStop { id: current },
        };
        self.unanswered.push(EndedAcknowledge { id, client, answer, result: Err(conflict.into()) });
        match progress {
            Progress::Checking(token) | Progress::Sent(token) => Some(token),
            Progress::Watching { .. } => None,
        }
    }

    /// Whether a 23h has to be sent now.
    pub(super) fn is_due(&self, now: Instant) -> bool {
        self.is_unconfirmed() && self.sent.is_none() && self.repeat_at.is_none_or(|at| at <= now)
    }

    pub(super) fn sent(&mut self, now: Instant, token: Option<Token>) {
        self.sent = token;
        self.repeat_at = Some(now + REPEAT_EVERY);
    }

    /// Ends a 23h, with or without a reply.
    pub(super) fn ended(&mut self, token: Token, answered: bool) {
        if self.sent == Some(token) {
            self.sent = None;
            self.answered |= answered;
        }
    }

    /// Takes in the device's flags.
    pub(super) fn take_flags(&mut self, now: Now, flags: SystemState, origin: &mut Origin<'_>) -> Option<LatchChange> {
        let stopped = flags.contains(SystemState::FAST_STOP);
        let watching = self.is_watching();
        let fresh = self.fresh_flags(now.instant, flags);
        let flags_count = self.flags_count_from.is_some_and(|from| from <= now.instant);
        match (&mut self.latch, stopped) {
            (None, true) => {
                let id = origin.ids.fast_stop_id(now.wall);
                self.epoch += 1;
                self.latch = Some(Latch {
                    id,
                    by: BY_DEVICE.into(),
                    cause: cause_of(flags, fresh, origin.unannounced),
                    reason: Reason::truncated(""),
                    at: now.wall,
                    confirmed: true,
                });
                Some(LatchChange::Seen { overtaken: self.overtake(id) })
            }
            (Some(latch), true) if !latch.confirmed && (self.answered || flags_count) => {
                latch.confirmed = true;
                Some(LatchChange::Confirmed)
            }
            (Some(_), false) if watching => {
                self.latch = None;
                self.finish_acknowledge(Ok(()));
                Some(LatchChange::Cleared)
            }
            (Some(latch), false) if latch.confirmed && self.acknowledging.is_none() && &*latch.by != BY_DEVICE => {
                self.forgotten(now.instant);
                Some(LatchChange::Forgotten)
            }
            (Some(_), true) => {
                if let Some(Acknowledging { progress: Progress::Watching { shown, .. }, .. }) = &mut self.acknowledging
                {
                    *shown = Shown::FastStop;
                }
                None
            }
            _ => None,
        }
    }

    /// Notes the flags, and returns those of [`STANDING`] that were set recently. Flags found on the first connect can
    /// be old.
    fn fresh_flags(&mut self, now: Instant, flags: SystemState) -> SystemState {
        let flags = flags.intersection(STANDING);
        let set = self.flags.replace(flags).map_or(SystemState::empty(), |before| flags.difference(before));
        if !set.is_empty() {
            self.newest_flags = Some((now, set));
        }
        let newest = self.newest_flags.filter(|(at, _)| now < *at + EXPLAINS_WITHIN);
        newest.map_or(SystemState::empty(), |(_, set)| set)
    }

    /// Whether an acknowledgement of this id can be sent.
    pub(super) fn check_acknowledge(&self, id: FastStopId) -> Result<(), Conflict> {
        match &self.latch {
            Some(latch) if latch.id != id => Err(Conflict::StaleFastStop { given: id, current: Some(latch.id) }),
            None => Err(Conflict::StaleFastStop { given: id, current: None }),
            Some(latch) if !latch.confirmed => Err(Conflict::FastStopUnconfirmed { id }),
            Some(_) if self.acknowledging.is_some() => Err(Conflict::Acknowledging { id: Some(id) }),
            Some(_) => Ok(()),
        }
    }

    /// Whether an acknowledgement of a fault without a latch can be sent. A latch needs its id.
    pub(super) fn check_acknowledge_fault(&self, is_faulty: bool) -> Result<(), Rejection> {
        let detail = match self.id() {
            Some(id) => format!("missing; FAST STOP {id} is latched, and can only be acknowledged by this id"),
            None if !is_faulty => "missing; the device shows no fault to acknowledge without an id".to_owned(),
            None if self.acknowledging.is_some() => return Err(Conflict::Acknowledging { id: None }.into()),
            None => return Ok(()),
        };
        Err(Invalid::Malformed { field: "fast_stop_id", detail }.into())
    }

    /// Notes an acknowledgement whose first request was sent: the 24h of a FAST STOP, or the check of a fault.
    pub(super) fn acknowledge_begun(
        &mut self,
        id: Option<FastStopId>,
        client: Client,
        token: Token,
        answer: ResultSender<()>,
    ) {
        let progress = if id.is_some() { Progress::Sent(token) } else { Progress::Checking(token) };
        self.acknowledging = Some(Acknowledging { id, client, answer, progress });
    }

    /// Whether a fault is to be acknowledged once this read of the flags has ended.
    pub(super) fn is_checking(&self, token: Token) -> bool {
        let Some(acknowledging) = &self.acknowledging else { return false };
        matches!(acknowledging.progress, Progress::Checking(current) if current == token)
    }

    /// Takes the 24h of a fault whose check has shown no FAST STOP, or the reason that it was not sent.
    pub(super) fn checked(&mut self, sent: Result<Token, Rejection>) {
        match (sent, &mut self.acknowledging) {
            (Ok(token), Some(acknowledging)) => acknowledging.progress = Progress::Sent(token),
            (Ok(_), None) => {}
            (Err(rejection), _) => self.finish_acknowledge(Err(rejection)),
        }
    }

    /// Takes the result of the 24h.
    pub(super) fn acknowledge_ended(&mut self, now: Instant, token: Token, result: Result<(), Rejection>) {
        let Some(acknowledging) = &mut self.acknowledging else { return };
        if !matches!(acknowledging.progress, Progress::Sent(sent) if sent == token) {
            return;
        }
        match result {
            Ok(()) if acknowledging.id.is_some() => {
                acknowledging.progress = Progress::Watching { until: now + CLEARS_WITHIN, shown: Shown::Nothing };
            }
            result => self.finish_acknowledge(result),
        }
    }

    /// Fails an acknowledgement whose FAST STOP flag stays set. Flags from before its reply do not count.
    pub(super) fn handle_timeout(&mut self, now: Instant, flags: Option<SystemState>) {
        let Some(Acknowledging { id: Some(id), .. }) = &self.acknowledging else { return };
        if self.clears_at().is_some_and(|at| at <= now) {
            let names: Vec<_> = flags.unwrap_or_default().names().collect();
            let persists = Conflict::FastStopPersists { id: *id, flags: names.join(", ") };
            self.finish_acknowledge(Err(persists.into()));
        }
    }

    /// Drops all pending requests, because the link is lost.
    pub(super) fn link_lost(&mut self, rejection: &Rejection) {
        self.sent = None;
        self.answered = false;
        self.repeat_at = None;
        self.finish_acknowledge(Err(rejection.clone()));
    }

    /// Time of the next 23h.
    pub(super) fn repeats_at(&self) -> Option<Instant> {
        self.repeat_at.filter(|_| self.is_unconfirmed() && self.sent.is_none())
    }

    /// Time until which the flags can still show an acknowledged FAST STOP.
    pub(super) fn clears_at(&self) -> Option<Instant> {
        match self.acknowledging.as_ref()?.progress {
            Progress::Watching { until, shown: Shown::FastStop } => Some(until),
            _ => None,
        }
    }

    /// Whether flags are awaited that show the end of an acknowledged FAST STOP.
    fn is_watching(&self) -> bool {
        matches!(self.acknowledging, Some(Acknowledging { progress: Progress::Watching { .. }, .. }))
    }

    fn finish_acknowledge(&mut self, result: Result<(), Rejection>) {
        if let Some(Acknowledging { id, client, answer, .. }) = self.acknowledging.take() {
            self.unanswered.push(EndedAcknowledge { id, client, answer, result });
        }
    }

    /// Takes the ended acknowledgements, to answer their clients after the state was published.
    pub(super) fn take_acknowledged(&mut self) -> Vec<EndedAcknowledge> {
        std::mem::take(&mut self.unanswered)
    }
}

/// Whether an earlier FAST STOP keeps its client, cause and reason when another one follows. A client on the WSG port
/// may acknowledge a FAST STOP that it caused itself. So neither its FAST STOP nor its loss replaces the cause that
/// another client gave.
fn outlives(earlier: &Latch, request: &FastStopRequest) -> bool {
    match request.cause {
        FastStopCause::ClientLost => earlier.cause != FastStopCause::ClientLost,
        _ => request.client.door == Door::Wsg && earlier.by != request.client.subject,
    }
}

/// Cause of a FAST STOP, as the flags show it. `fresh` has the flags of [`STANDING`] that were set recently.
fn cause_of(flags: SystemState, fresh: SystemState, unannounced: bool) -> FastStopCause {
    let flags = flags.difference(STANDING).union(flags.intersection(fresh));
    let causes = [
        (SystemState::TEMP_FAULT, FastStopCause::TemperatureFault),
        (SystemState::POWER_FAULT, FastStopCause::PowerFault),
        (SystemState::CURR_FAULT, FastStopCause::CurrentFault),
        (SystemState::FINGER_FAULT, FastStopCause::FingerFault),
        (SystemState::SOFT_LIMIT_MINUS, FastStopCause::SoftLimit),
        (SystemState::SOFT_LIMIT_PLUS, FastStopCause::SoftLimit),
    ];
    let named = causes.into_iter().find(|(flag, _)| flags.contains(*flag)).map(|(_, cause)| cause);
    let otherwise = if unannounced { FastStopCause::UnannouncedDisconnect } else { FastStopCause::Unknown };
    named.unwrap_or(otherwise)
}

#[cfg(test)]
mod tests;
