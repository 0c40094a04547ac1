//! The actor: a pure state machine that alone owns one gripper. Its `driver` does the I/O.
//!
//! # Inputs and outputs
//!
//! - Inputs: [`Actor::link_up`], [`Actor::link_down`], [`Actor::receive`], [`Actor::request`], [`Actor::fast_stop`],
//!   [`Actor::handle_timeout`]. Each takes `now` and processes its input completely.
//! - Outputs, to be checked after each input: [`Actor::poll_transmit`] whenever the link can take a frame,
//!   [`Actor::wants_close`], and [`Actor::poll_timeout`], which says when to call [`Actor::handle_timeout`].
//!   Clients get replies through the channels in their requests, and the newest state through a watch channel.
//!
//! # Parts
//!
//! Each part is a struct whose methods take their inputs as arguments and return what the actor has to do. Decisions
//! that concern several parts are methods of [`Actor`].
//!
//! # Architecture invariants
//!
//! A motion frame is submitted to the session in one place, `start_motion`, once for each admitted command. While a
//! FAST STOP is latched, no motion frame is submitted, and unwritten ones are withdrawn. An acknowledgement is
//! submitted in one place, for a client that named the latch's id, or once newly read flags show no FAST STOP.

mod admission;
mod answers;
mod connection;
mod device_settings;
mod drain;
mod events;
mod journal;
mod lease;
mod link;
mod metering;
mod missing_values;
mod motion;
mod publish;
mod reads;
mod reconfiguration;
mod recording;
mod running;
mod scripts;
mod steering;
mod stream_limits;
mod streaming;
mod timers;

use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{Notify, broadcast, watch};

use super::Now;
use super::connector::Connector;
use super::handle::{ActorRequest, FastStopRequest};
use super::info::Info;
use super::latch::LatchState;
use super::lease::LeaseState;
use super::metrics::GripperMetrics;
use super::observed::Observed;
use super::registry::CommandRegistry;
use answers::Answers;
use device_settings::Settings;
use device_settings::unconfirmed::Unconfirmed;
use drain::Drain;
pub use link::Close;
use link::DeviceLink;
use link::pacing::Pacing;
use metering::Metering;
use model::{FastStopStep, GripperRules, IdSource, Name, State, WireRecord};
use publish::Publication;
use reads::Reads;
use recording::Recording;
use running::MotionState;
use scripts::Scripts;
use steering::ServoState;
use streaming::Streaming;
use transport::LinkProperties;
use wsg::{Command, id};

/// Time limit for the device's reply, after which a Loop checks whether the reply was lost.
const REPLY_WITHIN: Duration = Duration::from_secs(1);

/// Time limit for the result of a custom command or of a request without motion. A finger powers up in about 500 ms
/// (`fw4-en 3.6.3`), and a custom command can do anything.
const RESULT_WITHIN: Duration = Duration::from_secs(30);

#[derive(Debug, Clone)]
pub struct ActorConfig {
    /// Name of the gateway, for the records.
    pub gateway: Name,
    pub name: Name,
    pub url: String,
    pub properties: LinkProperties,
    pub rules: GripperRules,
    /// Seed for ids and nonces; fixed in tests.
    pub seed: u64,
    pub metrics: GripperMetrics,
}

/// One gripper.
pub struct Actor {
    config: ActorConfig,
    ids: IdSource,
    link: DeviceLink,
    settings: Settings,
    observed: Observed,
    latch: LatchState,
    lease: LeaseState,
    reads: Reads,
    commands: CommandRegistry,
    motion: MotionState,
    drain: Option<Drain>,
    recording: Recording,
    metering: Metering,
    streaming: Streaming,
    servo: ServoState,
    scripts: Scripts,
    pacing: Pacing,
    unconfirmed: Unconfirmed,
    publication: Publication,
    answers: Answers,
    /// A new configuration that waits for the end of the link.
    pending: Option<reconfiguration::Pending>,
    /// The new device, until the driver takes it.
    connector: Option<Arc<dyn Connector>>,
}

/// Receivers of an actor's publications.
#[derive(Debug)]
pub struct Watches {
    pub state: watch::Receiver<Arc<State>>,
    pub info: watch::Receiver<Arc<Info>>,
    /// Sender of the wire log, to subscribe to.
    pub frames: broadcast::Sender<Arc<WireRecord>>,
}

impl Actor {
    /// Creates an actor without a link.
    #[must_use]
    pub fn new(config: ActorConfig) -> (Self, Watches) {
        let publication = Publication::new(&config);
        let (state, info) = publication.watch();
        let link = DeviceLink::new(config.name.clone(), config.url.clone(), config.properties);
        let frames = link.frames();
        let actor = Self {
            ids: IdSource::new(config.seed),
            observed: Observed::new(config.rules.updates, config.properties.bytes_per_second),
            link,
            settings: Settings::default(),
            latch: LatchState::default(),
            lease: LeaseState::default(),
            reads: Reads::default(),
            commands: CommandRegistry::default(),
            motion: MotionState::new(config.rules.motion_pause),
            drain: None,
            recording: Recording::new(
                config.gateway.clone(),
                config.name.clone(),
                config.rules.shared.on_journal_failure,
            ),
            metering: Metering::new(config.metrics.clone()),
            streaming: Streaming::default(),
            servo: ServoState::default(),
            scripts: Scripts::default(),
            pacing: Pacing::default(),
            unconfirmed: Unconfirmed::default(),
            publication,
            answers: Answers::default(),
            pending: None,
            connector: None,
            config,
        };
        (actor, Watches { state, info, frames })
    }

    /// Takes bytes from the link.
    pub fn receive(&mut self, now: Now, bytes: &[u8]) {
        self.link.receive(now, bytes);
        self.after_input(now);
    }

    /// Takes a FAST STOP, which needs no lease and waits for nothing.
    pub fn fast_stop(&mut self, now: Now, request: FastStopRequest) {
        self.latch(now, request);
        self.after_input(now);
    }

    /// Latches a FAST STOP of a client, or on behalf of a holder that was lost.
    fn latch(&mut self, now: Now, mut request: FastStopRequest) {
        let id = request.id;
        let client = request.client.clone();
        let cause = request.cause;
        let reason = request.reason.clone();
        self.metering.fast_stop_requested(request.at);
        let caller = request.epoch.take();
        if let Some(token) = self.latch.request(now, request) {
            // An acknowledgement of an earlier FAST STOP must not be sent after this one.
            self.link.withdraw(token);
        }
        if let Some(caller) = caller {
            self.answers.add(caller, self.latch.epoch());
        }
        self.send_fast_stop_if_due(now);
        self.record_fast_stop(now, FastStopStep::Latched, Some(&client));
        self.abort_for_latch(now);
        tracing::warn!(gripper = %self.config.name, %id, by = %client.subject, cause = cause.name(), reason = reason.as_str(), "FAST STOP latched");
    }

    /// Takes any other request of a client.
    pub fn request(&mut self, now: Now, request: ActorRequest) {
        match request {
            ActorRequest::Submit { submission, id, answer } => {
                let admitted = self.admit(now, id, &submission);
                self.answers.add(answer, admitted);
            }
            ActorRequest::Find { id, answer } => self.answers.add(answer, self.commands.find(id)),
            ActorRequest::FindRequest { subject, request_id, answer } => {
                let found = self.commands.find_request(now.instant, &subject, &request_id);
                self.answers.add(answer, found);
            }
            ActorRequest::Cancel { id, client, answer } => {
                let ticket = self.commands.find(id);
                if ticket.is_some() {
                    tracing::info!(gripper = %self.config.name, command = %id, by = %client.subject,
                        "command cancelled");
                    self.cancel(now, id, &client);
                }
                self.answers.add(answer, ticket);
            }
            ActorRequest::Exchange { command, client, lease, answer } => {
                self.exchange(now, command, client, lease.as_ref(), answer);
            }
            ActorRequest::Acknowledge { id, client, answer } => self.acknowledge(now, id, client, answer),
            ActorRequest::AcknowledgeFault { client, lease, answer } => {
                self.acknowledge_fault(now, client, lease.as_ref(), answer);
            }
            ActorRequest::Lease { answer } => {
                let lease = self.lease_now(now);
                self.answers.add(answer, lease);
            }
            ActorRequest::TakeLease { take, token, answer } => self.take_lease(now, &take, token, answer),
            ActorRequest::UseLease { token, answer } => {
                // If the caller is gone, this counts as a single use.
                let keep = self.lease.keep(now.instant, Some(&token));
                self.answers.add(answer, keep);
            }
            ActorRequest::RenewLease { token, answer } => {
                let renewed = self.renew_lease(now, token.as_ref());
                self.answers.add(answer, renewed);
            }
            ActorRequest::HandOver { token, to, new, answer } => {
                let handed_over = self.hand_over(now, token.as_ref(), &to, new);
                self.answers.add(answer, handed_over);
            }
            ActorRequest::ReleaseLease { token, answer } => {
                let released = self.release_lease(now, token.as_ref());
                self.answers.add(answer, released);
            }
            ActorRequest::LoseLease { token, times_taken, cause } => self.lose_lease(now, &token, times_taken, cause),
            ActorRequest::Disconnect { client, lease, answer } => {
                self.disconnect(now, &client, lease.as_ref(), answer);
            }
            ActorRequest::Connect { client, lease, answer } => self.connect(now, &client, lease.as_ref(), answer),
            ActorRequest::Steer { request, client, lease, answer } => {
                self.steer(now, request, &client, lease.as_ref(), answer);
            }
            ActorRequest::Drain { answer } => self.start_drain(now, answer),
            ActorRequest::Reconfigure { change, answer } => self.reconfigure(now, change, answer),
        }
        self.after_input(now);
    }

    /// Appends the next frame to `out`, if there is one. Such a frame counts as written.
    pub fn poll_transmit(&mut self, now: Now, out: &mut Vec<u8>) -> bool {
        if self.drain.as_ref().is_some_and(Drain::is_announced) {
            // Nothing follows a disconnect announcement.
            return false;
        }
        let Some(id) = self.link.poll_transmit(now, out) else { return false };
        match (id, &mut self.drain) {
            (id::DISCONNECT_ANNOUNCEMENT, Some(drain)) => drain.announced(),
            (id::FAST_STOP, _) => self.metering.fast_stop_sent(now.instant),
            _ => {}
        }
        true
    }

    /// Notified when a request of the lease holder ends; [`Actor::lease_request_closed`] has to be called then.
    #[must_use]
    pub fn lease_requests(&self) -> Arc<Notify> {
        self.lease.closed()
    }

    /// Reason to close the link, if there is one. The driver closes it and calls [`Actor::link_down`].
    #[must_use]
    pub fn wants_close(&self) -> Option<Close> {
        self.link.close
    }

    /// Processes the consequences of an input: the session's events, then due timers, then the answers.
    fn after_input(&mut self, now: Now) {
        self.take_events(now);
        self.run_due_timers(now);
        self.take_events(now);
        if let Some(round_trip) = self.metering.session(self.link.session.as_mut()) {
            self.took_round_trip(now, round_trip);
        }
        self.publish(now);
        self.recording.persist_changes(&self.latch, &self.lease, self.observed.part.grip, &self.commands.last);
        self.commands.notify();
        self.send_acknowledge_results(now);
        self.settings.overdrive.answer(self.observed.values.flags(now.instant));
        self.answers.send();
    }
}

/// Name of a command for error messages.
fn name_of(command: &Command) -> &'static str {
    id::name(command.id()).unwrap_or("the custom command")
}

#[cfg(test)]
pub(super) mod tests;
