//! A gripper without a device, for tests of the interfaces: a handle, and an actor that follows a script.

#![allow(clippy::unwrap_used, clippy::missing_panics_doc, reason = "only tests use this")]

use std::collections::HashMap;
use std::sync::Arc;

use jiff::Timestamp;
use tokio::sync::{broadcast, mpsc, watch};

use super::handle::{AcquiredLease, ActorRequest, FastStopRequest, Handle, Ticket};
use super::info::Info;
use super::lease::LeaseState;
use super::lease_terms::Terms;
use model::clock;
use model::error::{Conflict, Invalid, Rejection};
use model::{
    CommandId, CommandReport, CustomIds, FastStopCause, FastStopId, LatchFields, LeaseRules, LeaseToken, Name, Outcome,
    Phase, Reason, RequestId, State, Submission, TakeLease,
};
use wsg::{self, Data};

/// Id of a custom command that only reads.
pub const READ_ID: u8 = 0xB0;

/// A request that the actor received.
#[derive(Debug)]
pub enum Seen {
    Submission(Submission),
    Exchange(wsg::Command),
    FastStop(Reason),
    Acknowledge(FastStopId),
}

/// Result of a submitted command.
#[derive(Debug, Clone)]
pub enum Fate {
    /// Not admitted.
    Rejected(Rejection),
    /// Admitted, and refused by the device.
    Refused(Rejection),
    /// Runs until it is cancelled.
    Runs,
    /// Ends at once.
    Ends(Outcome),
}

/// Replies of the actor.
pub struct FakeScript {
    pub fate: Fate,
    pub exchange: fn(&wsg::Command) -> Result<Data, Rejection>,
    /// Whether the device's flags show a FAST STOP.
    pub confirms: bool,
    pub acknowledge: Result<(), Rejection>,
}

impl Default for FakeScript {
    fn default() -> Self {
        Self { fate: Fate::Ends(Outcome::Success), exchange: |_| Ok(Data::None), confirms: true, acknowledge: Ok(()) }
    }
}

/// The handle of a gripper that follows a script, and the requests that it receives.
#[must_use]
pub fn gripper(name: &str, script: FakeScript) -> (Handle, mpsc::UnboundedReceiver<Seen>) {
    let name: Name = name.parse().unwrap();
    let (requests, asked) = mpsc::channel(64);
    let (fast_stops, stopped) = mpsc::channel(64);
    let (states, state) = watch::channel(Arc::new(unheard(name.clone())));
    let info = Info::unknown(name.clone(), "sim://wsg50".to_owned(), "sim", false);
    let (seen, looked_at) = mpsc::unbounded_channel();
    let commands = HashMap::new();
    let request_ids = HashMap::new();
    let actor = Actor { name: name.clone(), script, seen, states, commands, request_ids, lease: LeaseState::default() };
    tokio::spawn(actor.run(asked, stopped));
    let custom_ids = Arc::new(CustomIds { read: [READ_ID].into(), ..CustomIds::default() });
    let info = watch::channel(Arc::new(Info { custom_ids, update_period_ms: 10, ..info })).1;
    let frames = broadcast::Sender::new(1);
    let handle = Handle { name, requests, fast_stops, state, info, frames };
    (handle, looked_at)
}

struct Actor {
    name: Name,
    script: FakeScript,
    seen: mpsc::UnboundedSender<Seen>,
    states: watch::Sender<Arc<State>>,
    commands: HashMap<CommandId, watch::Sender<Arc<CommandReport>>>,
    request_ids: HashMap<(Arc<str>, RequestId), CommandId>,
    lease: LeaseState,
}

impl Actor {
    async fn run(mut self, mut asked: mpsc::Receiver<ActorRequest>, mut stopped: mpsc::Receiver<FastStopRequest>) {
        let closed = self.lease.closed();
        loop {
            tokio::select! {
                biased;
                Some(stop) = stopped.recv() => self.latch(stop),
                () = closed.notified() => self.lease.request_closed(clock::instant()),
                request = asked.recv() => match request {
                    Some(request) => self.answer(request),
                    None => break,
                },
            }
        }
    }

    fn see(&self, seen: Seen) {
        // A test that does not look has dropped the receiver.
        let _ = self.seen.send(seen);
    }

    fn latch(&self, mut stop: FastStopRequest) {
        let epoch = self.states.borrow().latch.as_ref().map_or(0, |latch| latch.epoch) + 1;
        let _ = stop.epoch.take().map(|caller| caller.send(epoch));
        let latch = LatchFields {
            fast_stop_id: stop.id,
            fast_stop_by: stop.client.subject,
            fast_stop_cause: FastStopCause::Requested,
            fast_stop_reason: stop.reason.clone(),
            fast_stop_at: Timestamp::UNIX_EPOCH,
            fast_stop_confirmed: self.script.confirms,
            epoch,
        };
        self.states.send_modify(|state| {
            let seq = state.seq + 1;
            let update = state.update + 1;
            *state = Arc::new(State { latch: Some(latch), seq, update, ..State::clone(state) });
        });
        self.see(Seen::FastStop(stop.reason));
    }

    fn answer(&mut self, request: ActorRequest) {
        match request {
            ActorRequest::Submit { submission, id, answer } => {
                let _ = answer.send(self.submit(&submission, id));
                self.see(Seen::Submission(submission));
            }
            ActorRequest::Find { id, answer } => {
                let _ = answer.send(self.ticket(id));
            }
            ActorRequest::FindRequest { subject, request_id, answer } => {
                let id = self.request_ids.get(&(subject, request_id)).copied();
                let _ = answer.send(id.and_then(|id| self.ticket(id)));
            }
            ActorRequest::Cancel { id, answer, .. } => {
                if let Some(command) = self.commands.get(&id) {
                    command.send_modify(|command| end(Arc::make_mut(command), Outcome::Aborted));
                }
                let _ = answer.send(self.ticket(id));
            }
            ActorRequest::Exchange { command, lease, answer: (_, answer), .. } => {
                // Each use renews the lease, if it is the current one.
                let _ = self.lease.renew(clock::instant(), lease.as_ref());
                let _ = answer.send((self.script.exchange)(&command));
                self.see(Seen::Exchange(command));
            }
            ActorRequest::Acknowledge { id, answer, .. } => {
                let _ = answer.send(self.script.acknowledge.clone());
                self.see(Seen::Acknowledge(id));
            }
            ActorRequest::Disconnect { answer, .. } | ActorRequest::Connect { answer, .. } => {
                let _ = answer.send(Ok(()));
            }
            ActorRequest::AcknowledgeFault { answer, .. } => {
                let detail = "missing".to_owned();
                let _ = answer.send(Err(Invalid::Malformed { field: "fast_stop_id", detail }.into()));
            }
            ActorRequest::Steer { answer, .. } => {
                let _ = answer.send(Err(Conflict::NoServo { ended: None }.into()));
            }
            ActorRequest::Lease { answer } => {
                let _ = answer.send(self.lease.view(clock::instant(), None));
            }
            ActorRequest::TakeLease { take, token, answer } => {
                let _ = answer.send(self.take(&take, token));
            }
            ActorRequest::UseLease { token, answer } => {
                let _ = answer.send(self.lease.keep(clock::instant(), Some(&token)));
            }
            ActorRequest::RenewLease { token, answer } => {
                let renewed = self.lease.renew(clock::instant(), token.as_ref());
                let _ = answer
                    .send(renewed.map(|()| self.lease.view(clock::instant(), token.as_ref())).map_err(Into::into));
            }
            ActorRequest::HandOver { token, to, new, answer } => {
                let given = self.lease.hand_over(clock::instant(), token.as_ref(), &to, new);
                let _ = answer.send(given.map(|_| self.lease.view(clock::instant(), None)));
            }
            ActorRequest::ReleaseLease { token, answer } => {
                self.lease.end(token.as_ref());
                let _ = answer.send(self.lease.view(clock::instant(), None));
            }
            ActorRequest::LoseLease { token, times_taken, .. } => {
                self.lease.lose(&token, times_taken);
            }
            ActorRequest::Drain { answer } | ActorRequest::Reconfigure { answer, .. } => {
                let _ = answer.send(());
            }
        }
    }

    fn take(&mut self, take: &TakeLease, token: LeaseToken) -> Result<AcquiredLease, Rejection> {
        let terms = Terms::of(take, &LeaseRules::default())?;
        self.lease.take(clock::instant(), take, terms, token, true)?;
        let times_taken = self.lease.times_taken();
        Ok(AcquiredLease { lease: self.lease.view(clock::instant(), self.lease.token()), times_taken, keep: None })
    }

    fn submit(&mut self, submission: &Submission, id: CommandId) -> Result<Ticket, Rejection> {
        let mut command = running(self.name.clone(), id, submission);
        match self.script.fate.clone() {
            Fate::Rejected(rejection) => return Err(rejection),
            Fate::Refused(rejection) => {
                end(&mut command, Outcome::Refused);
                command.explain(rejection.code(), &rejection);
                command.rejection = Some(rejection);
            }
            Fate::Runs => {}
            Fate::Ends(outcome) => end(&mut command, outcome),
        }
        command.recorded = true;
        let (record, newest) = watch::channel(Arc::new(command));
        self.commands.insert(id, record);
        if let Some(request_id) = &submission.request_id {
            self.request_ids.insert((submission.client.subject.clone(), request_id.clone()), id);
        }
        self.states.send_modify(|state| Arc::make_mut(state).last_command_id = Some(id));
        Ok(Ticket { record: newest, replayed: false, _keep: None })
    }

    fn ticket(&self, id: CommandId) -> Option<Ticket> {
        let record = self.commands.get(&id)?;
        Some(Ticket { record: record.subscribe(), replayed: false, _keep: None })
    }
}

fn end(command: &mut CommandReport, outcome: Outcome) {
    command.phase = Phase::Done;
    command.set_outcome(outcome);
    command.set_status(wsg::Status::E_SUCCESS);
}

fn running(gripper: Name, id: CommandId, submission: &Submission) -> CommandReport {
    CommandReport::admitted(id, gripper, submission, Timestamp::UNIX_EPOCH)
}

fn unheard(gripper: Name) -> State {
    State { link_cause: Some("not reached yet".to_owned()), ..State::unknown(gripper) }
}
