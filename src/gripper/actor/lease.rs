//! Effects of lease changes on the fingers, the journal and the callers.

use std::time::Instant;

use super::super::Now;
use super::super::handle::{AcquiredLease, FastStopRequest, ResultSender};
use super::super::lease::{AcquireOutcome, HeldLease, Holder};
use super::super::lease_terms::Terms;
use super::Actor;
use super::link::OwnStop;
use model::error::{Conflict, Failure, Rejection};
use model::{
    Client, FastStopCause, Lease, LeaseEvent, LeaseStep, LeaseToken, Link, LossCause, LossEffect, OnLossHolding,
    OnLossMoving, Reason, ServoEnd, TakeLease,
};
use wsg::SystemState;

impl Actor {
    /// Checks that a request with this token, or without one, can make changes.
    pub(super) fn check_claim(&self, now: Now, client: &Client, token: Option<&LeaseToken>) -> Result<(), Conflict> {
        if !client.door.takes_lease_by_motion() {
            return self.lease.check(now.instant, client, token);
        }
        // The client has its connection's own token, which is never stale.
        let is_holder = token.is_some() && self.lease.token() == token;
        if is_holder || self.lease.is_free_for(client) { Ok(()) } else { self.lease.check(now.instant, client, None) }
    }

    /// Takes a free lease for a client that moves the fingers, if motions from its interface take a free lease.
    pub(super) fn claim(&mut self, now: Now, client: &Client, token: Option<&LeaseToken>) -> Result<(), Rejection> {
        match token {
            Some(token) if client.door.takes_lease_by_motion() && self.lease.is_free_for(client) => {
                self.try_take_lease(now, &TakeLease::by(client.clone()), token.clone())
            }
            _ => Ok(()),
        }
    }

    /// Takes the end of a holder's request, as notified by [`Actor::lease_requests`].
    pub fn lease_request_closed(&mut self, now: Now) {
        self.lease.request_closed(now.instant);
        self.after_input(now);
    }

    pub(super) fn lease_now(&self, now: Now) -> Lease {
        self.lease.view(now.instant, None)
    }

    pub(super) fn take_lease(
        &mut self,
        now: Now,
        wish: &TakeLease,
        token: LeaseToken,
        answer: ResultSender<AcquiredLease>,
    ) {
        let granted = self.try_take_lease(now, wish, token).map(|()| {
            let token = self.lease.token().cloned();
            let keep = self.lease.bind(now.instant, token.as_ref());
            let times_taken = self.lease.times_taken();
            // The caller decides whether its connection keeps the lease.
            let lease = Lease { bound: None, ..self.lease.view(now.instant, token.as_ref()) };
            AcquiredLease { lease, times_taken, keep }
        });
        // If the caller is gone, the lease runs out.
        self.answers.add(answer, granted);
    }

    pub(super) fn try_take_lease(&mut self, now: Now, wish: &TakeLease, token: LeaseToken) -> Result<(), Rejection> {
        if self.drain.is_some() {
            return Err(Failure::Draining.into());
        }
        let terms = Terms::of(wish, &self.config.rules.lease)?;
        let asked_before = self.lease.asking(now.instant).cloned();
        // A returning client must not bypass the `on_loss` terms of its lease.
        let effect = self.lease.terms().map(|terms| self.loss_effect(terms, now.instant));
        let may_return = matches!(effect, Some(LossEffect::None | LossEffect::Keep));
        let result = self.lease.take(now.instant, wish, terms, token, may_return);
        let asking = self.lease.asking(now.instant).cloned();
        if let Some(asking) = asking.filter(|asking| asked_before.as_ref() != Some(asking)) {
            self.record_lease(now, LeaseStep::Requested, &asking, None);
        }
        let Some(holder) = self.lease.holder().cloned() else { return result.map(drop).map_err(Into::into) };
        let outcome = result?;
        match outcome {
            AcquireOutcome::Free | AcquireOutcome::Returned => self.record_lease(now, LeaseStep::Taken, &holder, None),
            AcquireOutcome::Forced => self.record_lease(now, LeaseStep::Forced, &holder, None),
            // The new holder was recorded when the lease was handed over.
            AcquireOutcome::HandedOver | AcquireOutcome::Again => {}
        }
        self.withdraw_stale_scripts();
        if !matches!(outcome, AcquireOutcome::Again) && !self.has_motion_of(&wish.client) {
            // A motion that has not started would start under another client's lease.
            self.withdraw_waiting_motion(now);
        }
        if wish.force && !matches!(outcome, AcquireOutcome::Again) {
            // The motion may also belong to a lost holder, or to one that has handed over.
            self.stop_motion(now, None);
        }
        self.end_servo_without_lease(now);
        Ok(())
    }

    /// Whether the current motion was requested with this client's subject.
    fn has_motion_of(&self, client: &Client) -> bool {
        let mover = self.motion.id().and_then(|id| self.commands.client(id));
        mover.is_some_and(|mover| mover.subject == client.subject)
    }

    pub(super) fn renew_lease(&mut self, now: Now, token: Option<&LeaseToken>) -> Result<Lease, Rejection> {
        self.lease.renew(now.instant, token)?;
        Ok(self.lease.view(now.instant, token))
    }

    pub(super) fn hand_over(
        &mut self,
        now: Now,
        token: Option<&LeaseToken>,
        to: &str,
        new: LeaseToken,
    ) -> Result<Lease, Rejection> {
        let holder = self.lease.hand_over(now.instant, token, to, new)?;
        self.record_lease(now, LeaseStep::HandedOver, &holder, None);
        // A running motion continues. A motion that has not started would start under another client's lease.
        self.withdraw_waiting_motion(now);
        self.withdraw_stale_scripts();
        self.end_servo_without_lease(now);
        Ok(self.lease_now(now))
    }

    /// Releases a lease. A running motion stops, and nothing is latched.
    pub(super) fn release_lease(&mut self, now: Now, token: Option<&LeaseToken>) -> Lease {
        if let Some(held) = self.lease.end(token) {
            self.record_lease(now, LeaseStep::Released, &held.holder, None);
            self.stop_motion(now, None);
            self.withdraw_stale_scripts();
            self.end_servo_without_lease(now);
        }
        self.script_client_left(now, token);
        self.lease_now(now)
    }

    /// Takes the loss of the holder, without a release.
    pub(super) fn lose_lease(&mut self, now: Now, token: &LeaseToken, times_taken: Option<u64>, cause: LossCause) {
        self.script_client_lost(now, token);
        if let Some(held) = self.lease.lose(token, times_taken) {
            self.holder_lost(now, &held, cause);
        }
    }

    /// Ends a lease that has run out, and a reservation that no longer protects a part.
    pub(super) fn expire_lease(&mut self, now: Now) {
        if let Some(held) = self.lease.expire(now.instant) {
            self.holder_lost(now, &held, LossCause::Expired);
        }
        let holds_nothing = self.observed.values.state(now.instant).is_some() && !self.observed.part.is_held;
        if holds_nothing && self.motion.running.is_none() && self.link.is_up() {
            self.lease.unreserve();
        }
    }

    /// Effect of the loss of a holder with these terms. It depends on whether the fingers moved at `last_heard`, and on
    /// whether a part is held. A Stop can't wait for a lost link, or be repeated on it, but a FAST STOP can.
    fn loss_effect(&self, terms: Terms, last_heard: Instant) -> LossEffect {
        match (self.is_moving(last_heard), self.observed.part.is_held) {
            (true, _) => match terms.on_loss_moving {
                OnLossMoving::FastStop => LossEffect::FastStop,
                OnLossMoving::Stop if self.link.status() != Link::Connected => LossEffect::FastStop,
                OnLossMoving::Stop => LossEffect::Stop,
                OnLossMoving::Finish => LossEffect::Finish,
            },
            (false, true) => match terms.on_loss_holding {
                OnLossHolding::Keep => LossEffect::Keep,
                OnLossHolding::FastStop => LossEffect::FastStop,
            },
            (false, false) => LossEffect::None,
        }
    }

    fn holder_lost(&mut self, now: Now, held: &HeldLease, cause: LossCause) {
        let last_heard = match cause {
            LossCause::Expired => now.instant.checked_sub(held.terms.ttl).unwrap_or(now.instant),
            LossCause::Disconnected | LossCause::Forbidden => now.instant,
        };
        let effect = self.loss_effect(held.terms, last_heard);
        if effect == LossEffect::Finish {
            // The motion may go on, also one whose result a lost link has made unknown.
            self.link.owed_stop.take_if(|stop| stop.lost.is_none());
            self.motion.forget_late();
        }
        let name = &held.holder.name;
        tracing::warn!(gripper = %self.config.name, holder = %name, %cause, %effect, "lease holder lost");
        self.record_lease(now, LeaseStep::Lost, &held.holder, Some((effect, cause)));
        self.withdraw_stale_scripts();
        match effect {
            LossEffect::FastStop => self.fast_stop_for_lost(now, &held.holder),
            LossEffect::Stop => self.stop_motion(now, Some(&held.holder)),
            LossEffect::Finish | LossEffect::Keep => {
                // A motion that was not sent yet does not begin without its holder.
                self.withdraw_waiting_motion(now);
                // A motion under way can end with a held part.
                self.lease.reserve(held.holder.clone());
            }
            LossEffect::None => {}
        }
        self.streaming.stopped(now.instant);
        // Also with `finish`: a steered motion has no end of its own.
        self.stop_servo(now, ServoEnd::Lease);
    }

    /// Latches a FAST STOP because this holder was lost.
    pub(super) fn fast_stop_for_lost(&mut self, now: Now, holder: &Holder) {
        let request = FastStopRequest {
            id: self.ids.fast_stop_id(now.wall),
            client: holder.client.clone(),
            cause: FastStopCause::ClientLost,
            reason: Reason::truncated(&format!("lease holder {} lost", holder.name)),
            at: now.instant,
            epoch: None,
        };
        self.latch(now, request);
    }

    /// Whether the fingers are known to move or to be about to, a stream was active at `at`, a servo session is open, or a
    /// motion whose result is unknown may still be running.
    pub(super) fn is_moving(&self, at: Instant) -> bool {
        let is_known = self.motion.mover(at).is_some() || self.observed.has(SystemState::MOVING);
        is_known || self.is_streaming(at) || self.is_steered()
    }

    /// Withdraws a waiting motion, and sends a Stop if the fingers move.
    fn stop_motion(&mut self, now: Now, lost: Option<&Holder>) {
        if !self.is_moving(now.instant) {
            return;
        }
        self.withdraw_waiting_motion(now);
        if self.is_moving(now.instant) {
            let stop = OwnStop::new(self.motion.mover(now.instant)).for_lost(lost.cloned());
            self.link.send_stop(now, stop);
        }
        self.streaming.stopped(now.instant);
    }

    fn record_lease(&mut self, now: Now, event: LeaseStep, holder: &Holder, lost: Option<(LossEffect, LossCause)>) {
        let (effect, cause) = lost.unzip();
        let lease = LeaseEvent { event, holder: holder.name.clone(), epoch: self.lease.epoch(), effect, cause };
        self.recording.lease(now, lease, &holder.client);
    }
}
