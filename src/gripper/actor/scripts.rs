//! Scripts: requests on the WSG port whose ids the manual does not define.
//!
//! A script can read values or move the fingers, and only the fingers show which. The request of a script is refused
//! while another client holds the lease or a FAST STOP is latched. The request waits for nothing, and has no command
//! record. Once the fingers begin to move after the request, its client takes the lease if the lease is free.

use std::time::{Duration, Instant};

use super::super::Now;
use super::super::error::Rejection;
use super::super::model::{Client, LeaseToken, TakeLease};
use super::Actor;
use super::link::Purpose;
use crate::wsg::session::Token;

/// Longest time from a script's request or reply to the motion that it causes.
const MOVES_WITHIN: Duration = Duration::from_millis(200);

/// The newest use of a script by one client.
#[derive(Debug, Clone)]
struct ScriptUse {
    client: Client,
    token: LeaseToken,
    at: Instant,
}

impl ScriptUse {
    fn can_move(&self, now: Instant) -> bool {
        now < self.at + MOVES_WITHIN
    }
}

#[derive(Debug, Default)]
pub(super) struct Scripts {
    newest: Option<ScriptUse>,
    /// Script of a lost client; `at` is the time of the loss.
    lost: Option<ScriptUse>,
}

impl Scripts {
    fn used(&mut self, now: Instant, client: &Client, token: &LeaseToken) {
        self.newest = Some(ScriptUse { client: client.clone(), token: token.clone(), at: now });
    }

    /// Notes the reply to a script of this client.
    pub(super) fn replied(&mut self, now: Instant, client: &Client) {
        if let Some(newest) = self.newest.as_mut().filter(|newest| newest.client == *client) {
            newest.at = now;
        }
    }

    /// Forgets the script of a client that announced its end.
    pub(super) fn released(&mut self, token: Option<&LeaseToken>) {
        self.newest.take_if(|newest| Some(&newest.token) == token);
    }

    /// Keeps the script of a lost client, if the script can still move the fingers.
    fn client_lost(&mut self, now: Instant, token: &LeaseToken, is_running: bool) {
        let newest = self.newest.take_if(|newest| newest.token == *token);
        if let Some(script) = newest.filter(|newest| is_running || newest.can_move(now)) {
            self.lost = Some(ScriptUse { at: now, ..script });
        }
    }
}

impl Actor {
    /// Notes the request of a script.
    pub(super) fn note_script(&mut self, now: Now, client: &Client, token: Option<&LeaseToken>) {
        if let Some(token) = token {
            self.scripts.used(now.instant, client, token);
        }
    }

    pub(super) fn script_client_lost(&mut self, now: Now, token: &LeaseToken) {
        let is_running = self.running_scripts().next().is_some();
        self.scripts.client_lost(now.instant, token, is_running);
    }

    /// Gives a free lease to the client whose script has begun to move the fingers. If that client is lost, its lease
    /// is lost at once. Returns `false` if no script explains the motion, or if the lease is not free.
    pub(super) fn script_moves(&mut self, now: Now) -> bool {
        let is_running = self.running_scripts().next().is_some();
        let lost = self.scripts.lost.take().filter(|lost| lost.can_move(now.instant));
        let is_lost = lost.is_some();
        let newest = || self.scripts.newest.clone().filter(|newest| is_running || newest.can_move(now.instant));
        let Some(ScriptUse { client, token, .. }) = lost.or_else(newest) else { return false };
        if self.lease.token() == Some(&token) {
            return true;
        }
        let is_free = self.lease.is_free_for(&client);
        if is_free && self.try_take_lease(now, &TakeLease::by(client), token.clone()).is_ok() && is_lost {
            self.lose_lease(now, &token, None);
        }
        is_free
    }

    /// Withdraws the requests of scripts that are not written yet.
    pub(super) fn withdraw_scripts(&mut self, rejection: &Rejection) {
        let running: Vec<_> = self.running_scripts().collect();
        for token in running {
            if self.link.session.as_mut().is_some_and(|session| session.withdraw(token))
                && let Some(Purpose::Exchange(exchange)) = self.link.purposes.remove(&token)
            {
                // The caller may be gone.
                let _ = exchange.answer.send(Err(rejection.clone()));
            }
        }
    }

    fn running_scripts(&self) -> impl Iterator<Item = Token> {
        let is_script =
            |purpose: &Purpose| matches!(purpose, Purpose::Exchange(exchange) if self.is_script(&exchange.command));
        self.link.purposes.iter().filter(move |(_, purpose)| is_script(purpose)).map(|(token, _)| *token)
    }
}
