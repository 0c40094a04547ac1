//! The lease of one gripper: its holder, its time to live and the client that requests it. The actor decides what a
//! change of the lease means for the fingers.

use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use tokio::sync::Notify;

use super::lease_terms::Terms;
use model::error::{Conflict, Invalid, Rejection};
use model::{Client, Door, Lease, LeaseToken, TakeLease};

/// Time for which a request for the lease counts without being repeated.
const REQUEST_LASTS: Duration = Duration::from_mins(1);

/// Maximum number of clients that can request the lease at the same time. A gripper has few clients, so a greater
/// number would be a fault.
const MAX_ASKING: usize = 16;

/// A client that holds, held or requests a lease.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Holder {
    pub name: Arc<str>,
    #[serde(flatten)]
    pub client: Client,
}

impl Holder {
    fn of(wish: &TakeLease) -> Self {
        let name = wish.holder.as_ref().map_or_else(|| wish.client.subject.clone(), |name| name.as_str().into());
        Self { name, client: wish.client.clone() }
    }

    /// Whether both have the same name and subject.
    fn is(&self, other: &Self) -> bool {
        self.name == other.name && self.client.subject == other.client.subject
    }
}

/// A lease that is held, or was.
#[derive(Debug)]
pub(super) struct HeldLease {
    pub holder: Holder,
    pub terms: Terms,
    token: LeaseToken,
    /// Number of times that this lease was taken. The end of an earlier connection does not lose the lease.
    times_taken: u64,
    expires_at: Instant,
    /// Shared with each open request of the holder.
    open: Arc<()>,
    /// Shared with the connection that the lease is bound to, if there is one.
    connection: Arc<()>,
    usage: Usage,
    /// Whether a stall of the gateway has extended the lease since its last use.
    is_extended: bool,
}

/// Use of a lease by its holder's requests.
#[derive(Debug, PartialEq, Eq)]
enum Usage {
    /// The lease was handed over, and its new holder has not fetched the token yet.
    HandedOver,
    /// No request was open at the last check.
    Idle,
    /// A request was open at the last check.
    Open,
}

impl HeldLease {
    fn is_open(&self) -> bool {
        Arc::strong_count(&self.open) > 1 || self.is_bound()
    }

    /// Whether a connection keeps the lease alive.
    fn is_bound(&self) -> bool {
        Arc::strong_count(&self.connection) > 1
    }

    fn used(&mut self, now: Instant) {
        self.expires_at = now + self.terms.ttl;
        self.is_extended = false;
    }

    /// Whether this request comes from the holder, which has lost its token. Only a named holder over HTTP is
    /// recognised, and only after it has not used the lease for half of its time to live.
    fn is_left_by(&self, now: Instant, wish: &TakeLease) -> bool {
        let is_silent = !self.is_open() && self.expires_in(now) <= self.terms.ttl / 2;
        is_silent && wish.holder.is_some() && wish.client.door == Door::Http && self.holder.is(&Holder::of(wish))
    }

    fn expires_in(&self, now: Instant) -> Duration {
        if self.is_open() { self.terms.ttl } else { self.expires_at.saturating_duration_since(now) }
    }
}

/// Guard that keeps a lease from running out until dropped: for an open request, or a connection that responds.
#[derive(Debug)]
pub struct LeaseKeepAlive {
    open: Option<Arc<()>>,
    closed: Arc<Notify>,
}

impl Drop for LeaseKeepAlive {
    fn drop(&mut self) {
        // Comes first, so that the notified task sees the request closed.
        self.open = None;
        self.closed.notify_one();
    }
}

#[derive(Debug)]
struct Asking {
    holder: Holder,
    terms: Terms,
    at: Instant,
}

/// The lease of one gripper.
#[derive(Debug, Default)]
pub(super) struct LeaseState {
    epoch: u64,
    held: Option<HeldLease>,
    /// Clients that request the lease, in the order of their first requests.
    asking: Vec<Asking>,
    /// Holder that was lost while a part was held or a motion continued. Others need `force` to take the lease.
    reserved: Option<Holder>,
    /// Notified when a request of the holder ends.
    closed: Arc<Notify>,
}

/// Result of a request for the lease.
#[derive(Debug)]
pub(super) enum AcquireOutcome {
    /// The lease was free.
    Free,
    /// The lease was taken from its holder by force.
    Forced,
    /// The lease was handed over to this client before.
    HandedOver,
    /// The client holds the lease already.
    Again,
    /// The client took its own lease again, without the token.
    Returned,
}

impl LeaseState {
    /// Restores the epoch of the newest lease before a restart. A former holder gets a reservation.
    pub(super) fn restore(&mut self, epoch: u64, holder: Option<Holder>) {
        self.epoch = epoch;
        self.reserved = holder;
    }

    pub(super) fn epoch(&self) -> u64 {
        self.epoch
    }

    pub(super) fn holder(&self) -> Option<&Holder> {
        self.held.as_ref().map(|held| &held.holder)
    }

    /// Terms of the current lease.
    pub(super) fn terms(&self) -> Option<Terms> {
        self.held.as_ref().map(|held| held.terms)
    }

    /// The holder, if this is its token.
    pub(super) fn holder_by(&self, token: Option<&LeaseToken>) -> Option<&Holder> {
        self.held.as_ref().filter(|held| Some(&held.token) == token).map(|held| &held.holder)
    }

    pub(super) fn reserved(&self) -> Option<&Holder> {
        self.reserved.as_ref()
    }

    /// Notified when a request of the holder ends; [`LeaseState::request_closed`] has to be called then.
    pub(super) fn closed(&self) -> Arc<Notify> {
        self.closed.clone()
    }

    /// Whether a request of `client` with this token, or without one, may move the gripper.
    pub(super) fn check(&self, now: Instant, client: &Client, token: Option<&LeaseToken>) -> Result<(), Conflict> {
        match (&self.held, token) {
            (Some(held), Some(token)) if held.token == *token => Ok(()),
            (_, Some(_)) => Err(self.stale()),
            (Some(held), None) => {
                let Holder { name, client: Client { subject, .. } } = held.holder.clone();
                let expires_in_ms = held.expires_in(now).as_millis() as u64;
                Err(if subject == client.subject && held.usage != Usage::HandedOver {
                    Conflict::LeaseTokenMissing { holder: name, subject, expires_in_ms }
                } else if held.is_bound() {
                    Conflict::LeaseBound { holder: name, ttl_ms: expires_in_ms }
                } else {
                    Conflict::LeaseHeld { holder: name, expires_in_ms }
                })
            }
            (None, None) => match &self.reserved {
                Some(holder) => Err(Conflict::Reserved { holder: holder.name.clone() }),
                None => Ok(()),
            },
        }
    }

    /// Whether this client can take the lease without a hand-over or force.
    pub(super) fn is_free_for(&self, client: &Client) -> bool {
        let holder = Holder { name: client.subject.clone(), client: client.clone() };
        self.held.is_none() && self.reserved.as_ref().is_none_or(|reserved| reserved.is(&holder))
    }

    pub(super) fn stale(&self) -> Conflict {
        Conflict::StaleLease { epoch: self.epoch, holder: self.holder().map(|holder| holder.name.clone()) }
    }

    /// Renews the lease of this token and keeps it while the guard lives. `None` if the token has no lease.
    pub(super) fn keep(&mut self, now: Instant, token: Option<&LeaseToken>) -> Option<LeaseKeepAlive> {
        self.keep_while(now, token, |held| &held.open)
    }

    /// Binds the lease of this token to a connection, which keeps the lease while the guard lives.
    pub(super) fn bind(&mut self, now: Instant, token: Option<&LeaseToken>) -> Option<LeaseKeepAlive> {
        self.keep_while(now, token, |held| &held.connection)
    }

    fn keep_while(
        &mut self,
        now: Instant,
        token: Option<&LeaseToken>,
        count: impl FnOnce(&HeldLease) -> &Arc<()>,
    ) -> Option<LeaseKeepAlive> {
        let closed = self.closed.clone();
        let held = self.held.as_mut().filter(|held| Some(&held.token) == token)?;
        held.used(now);
        held.usage = Usage::Open;
        Some(LeaseKeepAlive { open: Some(count(held).clone()), closed })
    }

    /// Starts the time to live when the holder's last open request has ended.
    pub(super) fn request_closed(&mut self, now: Instant) {
        if let Some(held) = self.held.as_mut().filter(|held| held.usage == Usage::Open && !held.is_open()) {
            held.usage = Usage::Idle;
            held.used(now);
        }
    }

    /// Takes the lease for a client. A new lease gets `token`. With `may_return`, a client that has lost its token, for
    /// example in a restart, can take its own lease again. It cannot while a request or a connection of the holder is
    /// open.
    pub(super) fn take(
        &mut self,
        now: Instant,
        wish: &TakeLease,
        terms: Terms,
        token: LeaseToken,
        may_return: bool,
    ) -> Result<AcquireOutcome, Conflict> {
        self.request_closed(now);
        let holder = Holder::of(wish);
        let outcome = match &mut self.held {
            Some(held) if Some(&held.token) == wish.token.as_ref() => {
                held.terms = terms;
                held.times_taken += 1;
                held.used(now);
                return Ok(AcquireOutcome::Again);
            }
            Some(held) if held.usage == Usage::HandedOver && held.holder.is(&holder) => {
                held.usage = Usage::Idle;
                held.terms = terms;
                held.used(now);
                return Ok(AcquireOutcome::HandedOver);
            }
            _ if wish.token.is_some() => return Err(self.stale()),
            Some(_) if wish.force => AcquireOutcome::Forced,
            Some(held) if may_return && held.is_left_by(now, wish) => AcquireOutcome::Returned,
            None if wish.force || self.reserved.as_ref().is_none_or(|reserved| reserved.is(&holder)) => {
                AcquireOutcome::Free
            }
            held => {
                let current = held.as_ref().map(|held| held.holder.name.clone());
                if let Some(current) = current.filter(|_| wish.request)
                    && let Some(place) = self.ask(now, holder, terms)
                {
                    return Err(Conflict::LeaseRequested { holder: current, place });
                }
                return self.check(now, &wish.client, None).map(|()| AcquireOutcome::Free);
            }
        };
        self.give(now, holder, terms, token, Usage::Idle);
        Ok(outcome)
    }

    fn give(&mut self, now: Instant, holder: Holder, terms: Terms, token: LeaseToken, usage: Usage) {
        self.epoch += 1;
        self.reserved = None;
        self.asking.retain(|asking| !asking.holder.is(&holder));
        self.held = Some(HeldLease {
            holder,
            terms,
            token,
            times_taken: 1,
            expires_at: now + terms.ttl,
            open: Arc::new(()),
            connection: Arc::new(()),
            usage,
            is_extended: false,
        });
    }

    /// Notes a client that requests the lease, for as long as the client repeats its request. Returns the client's
    /// place in the queue, or `None` if too many clients wait. The holder sees only the first client.
    fn ask(&mut self, now: Instant, holder: Holder, terms: Terms) -> Option<usize> {
        self.asking.retain(|asking| now < asking.at + REQUEST_LASTS);
        let known = self.asking.iter().position(|asking| asking.holder.is(&holder));
        let place = known.unwrap_or(self.asking.len());
        let asking = Asking { holder, terms, at: now };
        match self.asking.get_mut(place) {
            Some(earlier) => *earlier = asking,
            None if place < MAX_ASKING => self.asking.push(asking),
            None => return None,
        }
        Some(place + 1)
    }

    /// Renews the lease of this token.
    pub(super) fn renew(&mut self, now: Instant, token: Option<&LeaseToken>) -> Result<(), Conflict> {
        match self.held.as_mut().filter(|held| Some(&held.token) == token) {
            Some(held) => {
                held.used(now);
                Ok(())
            }
            None => Err(self.stale()),
        }
    }

    /// Gives the lease of this token to the client that requested it, which has to fetch its own token.
    pub(super) fn hand_over(
        &mut self,
        now: Instant,
        token: Option<&LeaseToken>,
        to: &str,
        new: LeaseToken,
    ) -> Result<Holder, Rejection> {
        self.renew(now, token)?;
        let asking = self.asking_now(now);
        let Some(Asking { holder, terms, .. }) = asking.filter(|asking| &*asking.holder.name == to) else {
            let asks = asking.map_or("nobody".to_owned(), |asking| format!("{:?}", asking.holder.name));
            let detail = format!("{to:?} has not requested the lease (requested by: {asks})");
            return Err(Invalid::Malformed { field: "to", detail }.into());
        };
        let holder = holder.clone();
        let terms = *terms;
        self.give(now, holder.clone(), terms, new, Usage::HandedOver);
        Ok(holder)
    }

    /// Ends the lease of this token, if it is current. A held part does not reserve the gripper then.
    pub(super) fn end(&mut self, token: Option<&LeaseToken>) -> Option<HeldLease> {
        let ended = self.held.take_if(|held| Some(&held.token) == token);
        if ended.is_some() {
            self.asking.clear();
        }
        ended
    }

    /// Number of times that the current lease was taken.
    pub(super) fn times_taken(&self) -> u64 {
        self.held.as_ref().map_or(0, |held| held.times_taken)
    }

    /// Ends the lease of this token; with `times_taken`, only if the lease was not taken again since.
    pub(super) fn lose(&mut self, token: &LeaseToken, times_taken: Option<u64>) -> Option<HeldLease> {
        let is_newest = times_taken.is_none_or(|times_taken| times_taken == self.times_taken());
        is_newest.then(|| self.end(Some(token))).flatten()
    }

    /// Extends the lease once after a stall, because keep-alives could not be processed.
    pub(super) fn extend(&mut self, until: Instant) {
        if let Some(held) = self.held.as_mut().filter(|held| !held.is_extended && held.expires_at < until) {
            (held.expires_at, held.is_extended) = (until, true);
        }
    }

    /// Ends the lease that has run out.
    pub(super) fn expire(&mut self, now: Instant) -> Option<HeldLease> {
        // The last open request may have ended just now, and its notice may still be on its way.
        self.request_closed(now);
        let ended = self.held.take_if(|held| !held.is_open() && held.expires_at <= now);
        if ended.is_some() {
            self.asking.clear();
        }
        ended
    }

    /// Reserves the gripper for a holder that was lost.
    pub(super) fn reserve(&mut self, holder: Holder) {
        self.reserved = Some(holder);
    }

    /// Ends the reservation once no part is held.
    pub(super) fn unreserve(&mut self) -> Option<Holder> {
        self.reserved.take()
    }

    pub(super) fn next_timeout(&self) -> Option<Instant> {
        self.held.as_ref().filter(|held| !held.is_open()).map(|held| held.expires_at)
    }

    /// The lease as clients see it. It includes the token only if `token` matches.
    pub(super) fn view(&self, now: Instant, token: Option<&LeaseToken>) -> Lease {
        let held = self.held.as_ref();
        Lease {
            held: held.is_some(),
            holder: held.map(|held| held.holder.name.clone()),
            epoch: self.epoch,
            token: held.map(|held| &held.token).filter(|held| Some(*held) == token).cloned(),
            ttl_ms: held.map(|held| held.terms.ttl.as_millis() as u64),
            expires_in_ms: held.map(|held| held.expires_in(now).as_millis() as u64),
            bound: held.map(HeldLease::is_bound),
            on_loss_moving: held.map(|held| held.terms.on_loss_moving),
            on_loss_holding: held.map(|held| held.terms.on_loss_holding),
            requested_by: self.asking_now(now).map(|asking| asking.holder.name.clone()),
            place: None,
            reserved_for: self.reserved.as_ref().map(|holder| holder.name.clone()),
        }
    }

    pub(super) fn token(&self) -> Option<&LeaseToken> {
        self.held.as_ref().map(|held| &held.token)
    }

    /// The client that requests a hand-over.
    pub(super) fn asking(&self, now: Instant) -> Option<&Holder> {
        self.asking_now(now).map(|asking| &asking.holder)
    }

    fn asking_now(&self, now: Instant) -> Option<&Asking> {
        self.asking.iter().find(|asking| now < asking.at + REQUEST_LASTS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use model::LeaseRules;
    use model::lease::DEFAULT_TTL;

    #[test]
    fn refusal_says_whether_a_connection_keeps_the_lease() {
        let (mut lease, now, token) = (LeaseState::default(), Instant::now(), LeaseToken::from("a"));
        let client = |subject: &str| Client::new(subject, Door::Wsg);
        let (wish, other) = (TakeLease::by(client("wsg:10.0.0.1")), client("wsg:10.0.0.2"));
        let terms = Terms::of(&wish, &LeaseRules::default()).unwrap();
        lease.take(now, &wish, terms, token.clone(), false).unwrap();
        let request = lease.keep(now, Some(&token)).unwrap();
        assert!(matches!(lease.check(now, &other, None), Err(Conflict::LeaseHeld { expires_in_ms: 3000, .. })));
        drop(request);
        let connection = lease.bind(now, Some(&token)).unwrap();
        let refusal = lease.check(now + DEFAULT_TTL * 2, &other, None).unwrap_err();
        assert_eq!(refusal, Conflict::LeaseBound { holder: "wsg:10.0.0.1".into(), ttl_ms: 3000 });
        assert!(refusal.to_string().contains("until it disconnects"), "{refusal}");
        let view = lease.view(now + DEFAULT_TTL * 2, None);
        assert_eq!((view.bound, view.expires_in_ms), (Some(true), Some(3000)));
        drop(connection);
        assert_eq!(lease.view(now, None).bound, Some(false));
        assert!(matches!(lease.check(now, &other, None), Err(Conflict::LeaseHeld { .. })));
    }
}
