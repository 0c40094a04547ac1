//! Scripts: requests on the WSG port whose ids the manual does not define.
//!
//! A script can read values or move the fingers, and only the fingers show which. The request of a script is refused
//! while another client holds the lease or a FAST STOP is latched. The request waits for nothing, and has no command
//! record. Once the fingers begin to move after the request, its client takes the lease if the lease is free. A request
//! without a reply counts for as long as its late reply is awaited.

use std::time::{Duration, Instant};

use super::super::Now;
use super::Actor;
use super::link::{Exchange, Purpose};
use model::error::Rejection;
use model::{Client, LeaseToken, LossCause, TakeLease};
use wsg::session::{End, SCRIPT_REPLIES_WITHIN, Token};
use wsg::{GripperState, SystemState};

/// Longest time from a script's request or reply to the motion that it causes. The flags show the motion up to one
/// period of the updates later.
const MOVES_WITHIN: Duration = Duration::from_millis(200);

/// How a client of a script ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ClientEnd {
    /// Announced with 07h.
    Announced,
    Lost,
}

/// The newest use of a script by one client.
#[derive(Debug, Clone)]
struct ScriptUse {
    client: Client,
    token: LeaseToken,
    /// Time of the newest request or reply, or of the client's end.
    at: Instant,
    /// Time until which a request without a reply can move the fingers.
    unanswered_until: Option<Instant>,
    end: Option<ClientEnd>,
    /// Whether this script is one of several that can have begun the current motion.
    is_suspect: bool,
}

/// Scripts that can move the fingers: one for each client with a recent, running or unanswered script request.
#[derive(Debug, Default)]
pub(super) struct Scripts {
    uses: Vec<ScriptUse>,
}

impl ScriptUse {
    fn can_move(&self, now: Instant, period: Duration) -> bool {
        let until = self.at + MOVES_WITHIN + period;
        self.is_suspect || now < until || self.unanswered_until.is_some_and(|until| now < until)
    }
}

impl Scripts {
    fn get_mut(&mut self, token: Option<&LeaseToken>) -> Option<&mut ScriptUse> {
        self.uses.iter_mut().find(|script| Some(&script.token) == token && script.end.is_none())
    }

    /// Notes the end of a script's request. The client can be gone.
    pub(super) fn request_ended(&mut self, now: Instant, token: Option<&LeaseToken>, end: &End) {
        let Some(script) = self.uses.iter_mut().find(|script| Some(&script.token) == token) else { return };
        match end {
            End::Reply(_) | End::Invalid(_) => script.at = now,
            End::Unanswered { written: true, .. } | End::NoResult { .. } => {
                script.unanswered_until = Some(now + SCRIPT_REPLIES_WITHIN);
            }
            End::Unanswered { written: false, .. } => {}
        }
    }

    /// Notes that the fingers stand still.
    pub(super) fn rested(&mut self) {
        for script in &mut self.uses {
            script.is_suspect = false;
        }
    }
}

impl Actor {
    /// Notes the request of a script.
    pub(super) fn note_script(&mut self, now: Now, client: &Client, token: Option<&LeaseToken>) {
        let Some(token) = token else { return };
        self.forget_old_scripts(now.instant);
        if let Some(script) = self.scripts.get_mut(Some(token)) {
            script.at = now.instant;
            return;
        }
        self.scripts.uses.retain(|script| script.token != *token);
        let client = client.clone();
        let token = token.clone();
        let script = ScriptUse { client, token, at: now.instant, unanswered_until: None, end: None, is_suspect: false };
        self.scripts.uses.push(script);
    }

    /// Forgets the scripts that can no longer move the fingers.
    fn forget_old_scripts(&mut self, now: Instant) {
        let running: Vec<_> = self.running_scripts().filter_map(|(_, script)| script.lease.clone()).collect();
        self.scripts
            .uses
            .retain(|script| running.contains(&script.token) || script.can_move(now, self.observed.period));
    }

    /// Takes the announced end of a client. A motion that its script then begins is stopped.
    pub(super) fn script_client_left(&mut self, now: Now, token: Option<&LeaseToken>) {
        self.end_script(now, token, ClientEnd::Announced);
    }

    /// Takes the loss of a script's client. If the script moves the fingers, now or soon after, its client is given the
    /// free lease and loses it at once, so that `on_loss_moving` decides what happens.
    pub(super) fn script_client_lost(&mut self, now: Now, token: &LeaseToken) {
        let Some(script) = self.end_script(now, Some(token), ClientEnd::Lost) else { return };
        let is_stopping = self.latch.id().is_some();
        let moves = self.observed.has(SystemState::MOVING) && !self.is_part_lost() && !self.motion.is_under_way();
        if moves && !is_stopping {
            self.give_script_the_lease(now, script);
        }
    }

    fn end_script(&mut self, now: Now, token: Option<&LeaseToken>, end: ClientEnd) -> Option<ScriptUse> {
        self.withdraw_scripts(&self.lease.stale().into(), |script| script.lease.as_ref() == token);
        self.forget_old_scripts(now.instant);
        let script = self.scripts.get_mut(token)?;
        (script.at, script.end, script.is_suspect) = (now.instant, Some(end), false);
        Some(script.clone())
    }

    /// Takes the beginning of a motion. If only one client's script explains it, that client takes the free lease. If
    /// several do, nobody takes it, unless one of the clients is lost. Returns `false` if no script explains the motion,
    /// or if nobody can take the lease.
    pub(super) fn script_moves(&mut self, now: Now) -> bool {
        self.forget_old_scripts(now.instant);
        let scripts = &mut self.scripts.uses;
        if scripts.iter().any(|script| Some(&script.token) == self.lease.token()) {
            return true;
        }
        let lost = scripts.iter().find(|script| script.end == Some(ClientEnd::Lost));
        let only = scripts.first().filter(|_| scripts.len() == 1);
        if let Some(script) = lost.or(only).cloned() {
            return self.give_script_the_lease(now, script);
        }
        for script in scripts {
            script.is_suspect = script.end.is_none();
        }
        false
    }

    /// Gives a free lease to the client of a script. If that client is gone, its lease ends at once. Returns whether the
    /// lease was free.
    fn give_script_the_lease(&mut self, now: Now, script: ScriptUse) -> bool {
        let ScriptUse { client, token, end, .. } = script;
        if !self.lease.is_free_for(&client) {
            return false;
        }
        if end.is_some() {
            self.scripts.uses.retain(|script| script.token != token);
        }
        let is_taken = self.try_take_lease(now, &TakeLease::by(client), token.clone()).is_ok();
        match end {
            Some(ClientEnd::Lost) if is_taken => self.lose_lease(now, &token, None, LossCause::Disconnected),
            Some(ClientEnd::Announced) if is_taken => drop(self.release_lease(now, Some(&token))),
            _ => {}
        }
        true
    }

    /// Whether the gripper has lost a part. The fingers then close further, without a command.
    pub(super) fn is_part_lost(&self) -> bool {
        self.observed.last_state() == Some(GripperState::PartLost)
    }

    /// Withdraws the requests of all scripts that are not written yet, except those of the lease's holder.
    pub(super) fn withdraw_stale_scripts(&mut self) {
        let holder = self.lease.token().cloned();
        self.withdraw_scripts(&self.lease.stale().into(), |script| script.lease != holder);
    }

    /// Withdraws the requests of these scripts that are not written yet.
    pub(super) fn withdraw_scripts(&mut self, rejection: &Rejection, which: impl Fn(&Exchange) -> bool) {
        let chosen: Vec<_> =
            self.running_scripts().filter(|(_, script)| which(script)).map(|(token, _)| token).collect();
        for token in chosen {
            if self.link.session.as_mut().is_some_and(|session| session.withdraw(token))
                && let Some(Purpose::Exchange(exchange)) = self.link.purposes.remove(&token)
            {
                // The caller may be gone.
                self.answers.add(exchange.answer, Err(rejection.clone()));
            }
        }
    }

    fn running_scripts(&self) -> impl Iterator<Item = (Token, &Exchange)> {
        self.link.purposes.iter().filter_map(|(token, purpose)| match purpose {
            Purpose::Exchange(exchange) if self.is_script(&exchange.command) => Some((*token, exchange)),
            _ => None,
        })
    }
}
