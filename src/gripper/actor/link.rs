//! The link to the device: its session, its state, and the requests in flight on it.

mod arrived_data;
pub(super) mod pacing;
mod wire_log;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio::sync::{broadcast, oneshot};

use super::super::Now;
use super::super::handle::ResultSender;
use super::super::lease::Holder;
use super::super::setup::{Setting, Setup, Step};
use super::{REPLY_WITHIN, RESULT_WITHIN, name_of};
use arrived_data::Arrived;
use model::error::{Failure, Rejection};
use model::{Client, CommandId, LeaseToken, Link, Name, WireRecord};
use transport::LinkProperties;
use wire_log::WireLog;
use wsg::session::{self, End, NotTaken, Session, SessionEvent, Token};
use wsg::{self, Command, Data, Force, id};

/// Silence after which a link is unresponsive, and motions are refused.
pub(super) const UNRESPONSIVE_AFTER: Duration = Duration::from_millis(1500);

/// Silence after which a link is closed.
const CLOSED_AFTER: Duration = Duration::from_millis(6500);

/// Reason to close the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Close {
    #[error("nothing was heard from the device for {0} ms")]
    Silent(u64),
    /// The device does not answer a request that every gripper must answer.
    #[error("the device does not answer {0}: {1}")]
    SetupFailed(&'static str, Arrived),
    /// The device has restarted and has to be set up again. Pending requests are lost.
    #[error("the device restarted and lost its reference")]
    Restarted,
    /// The gripper was drained. The disconnect was announced on a transport with connections.
    #[error("disconnected cleanly")]
    Drained,
}

/// Purpose of a request in flight.
#[derive(Debug)]
pub(super) enum Purpose {
    Setup,
    Upkeep,
    Temperature,
    /// Reads back a setting whose request was not answered.
    Unconfirmed(Setting),
    /// Reads the force limit after Overdrive Mode was switched.
    ForceLimit,
    FastStop,
    /// Reads the flags before the acknowledgement of a fault.
    FaultCheck,
    Acknowledge,
    /// Set Force Limit before a grip.
    Force(CommandId, Force),
    /// Set Force Limit of a servo session, for this client.
    ServoForce(Force, Client),
    Motion(CommandId),
    /// A client's Stop command.
    Stop(CommandId),
    OwnStop(OwnStop),
    Exchange(Exchange),
    /// A getter that several clients can wait for.
    Read(u8),
    /// One of the last requests before the link is closed.
    LastRequest,
}

impl Purpose {
    /// Whether the request reads or changes a setting for a client.
    fn concerns_setting(&self) -> bool {
        match self {
            Self::Force(..) | Self::ServoForce(..) => true,
            Self::Exchange(exchange) => Setting::of(exchange.command.id()).is_some(),
            _ => false,
        }
    }
}

/// A Stop of the gateway's own.
#[derive(Debug, Clone)]
pub(super) struct OwnStop {
    /// Motion that it should stop; `None` without one, for example while a script moves the fingers.
    pub motion: Option<CommandId>,
    /// The lost holder whose motion it should stop. If it fails, a FAST STOP follows, since nobody else would stop the
    /// fingers.
    pub lost: Option<Holder>,
    /// Number of Stops that may follow if this one fails.
    left: u8,
}

impl OwnStop {
    pub(super) fn new(motion: Option<CommandId>) -> Self {
        Self { motion, lost: None, left: REPEATED_STOPS }
    }

    pub(super) fn for_lost(self, lost: Option<Holder>) -> Self {
        Self { lost, ..self }
    }

    /// The Stop to send if this one has failed; `None` after the last.
    pub(super) fn again(self) -> Option<Self> {
        Some(Self { left: self.left.checked_sub(1)?, ..self })
    }
}

/// A pending request of a client that moves nothing.
#[derive(Debug)]
pub(super) struct Exchange {
    pub command: Command,
    pub answer: ResultSender<Data>,
    /// Signalled when the device has accepted the request.
    pub accepted: Option<oneshot::Sender<()>>,
    /// The setter whose value is being read back.
    pub setter: Option<Command>,
    pub client: Client,
    /// Token of a script's client.
    pub lease: Option<LeaseToken>,
}

/// Rejection of a request that the session did not accept, and the request's purpose.
pub(super) type NotSubmitted = Box<(Rejection, Purpose)>;

/// Number of Stops of the gateway's own after one that has failed.
const REPEATED_STOPS: u8 = 2;

#[derive(Debug)]
enum LinkState {
    Down,
    /// The device is set up again once the setters in flight have ended. Until then, the setup does not know which
    /// values clients want.
    SetupWaits,
    SettingUp(Box<Setup>),
    Up,
}

/// The link to one device.
#[derive(Debug)]
pub(super) struct DeviceLink {
    gripper: Name,
    /// Address of the device.
    pub url: String,
    pub properties: LinkProperties,
    state: LinkState,
    /// Session; present while the link is not down.
    pub session: Option<Session>,
    pub purposes: BTreeMap<Token, Purpose>,
    pub close: Option<Close>,
    /// Reason that the link is not up or is unresponsive.
    pub cause: Option<String>,
    /// Text that names the client that released the device to another program, and the remedy. The gateway does not
    /// connect while this is set.
    released: Option<String>,
    /// Whether an attempt to connect is under way.
    pub is_connecting: bool,
    /// Whether the link was ever up.
    pub was_up: bool,
    /// Whether the last connection-oriented link ended without an announcement.
    pub unannounced: bool,
    /// Stop of the gateway's own to send after the next setup: the device had not confirmed it when the link was lost,
    /// or it was requested without a link.
    pub owed_stop: Option<OwnStop>,
    wire_log: WireLog,
}

impl DeviceLink {
    pub(super) fn new(gripper: Name, url: String, properties: LinkProperties) -> Self {
        Self {
            wire_log: WireLog::new(gripper.clone()),
            gripper,
            url,
            properties,
            state: LinkState::Down,
            session: None,
            purposes: BTreeMap::new(),
            close: None,
            cause: None,
            released: None,
            is_connecting: false,
            was_up: false,
            unannounced: false,
            owed_stop: None,
        }
    }

    /// Sender of the wire log, to subscribe to.
    pub(super) fn frames(&self) -> broadcast::Sender<Arc<WireRecord>> {
        self.wire_log.listeners()
    }

    pub(super) fn is_up(&self) -> bool {
        matches!(self.state, LinkState::Up)
    }

    pub(super) fn is_down(&self) -> bool {
        matches!(self.state, LinkState::Down)
    }

    pub(super) fn is_released(&self) -> bool {
        self.released.is_some()
    }

    /// Notes that a client releases the device. The caller has to close an open link.
    pub(super) fn release(&mut self, client: &Client) {
        let cause = format!("by {}; a `connect` request restores the link", client.subject);
        if self.is_down() {
            self.cause = Some(cause.clone());
        }
        self.released = Some(cause);
    }

    /// Lets the gateway connect again. Returns whether the device was released.
    pub(super) fn reclaim(&mut self) -> bool {
        let was_released = self.released.take().is_some();
        if was_released && self.is_down() {
            self.cause = None;
            // Another program may have caused a FAST STOP meanwhile.
            self.unannounced = false;
        }
        was_released
    }

    /// Connection state as clients see it.
    pub(super) fn status(&self) -> Link {
        match (&self.state, self.was_up) {
            (LinkState::Up, _) if self.cause.is_some() => Link::Unresponsive,
            (LinkState::Up, _) => Link::Connected,
            (LinkState::Down, _) if self.is_released() => Link::Released,
            (_, true) => Link::Reconnecting,
            (_, false) => Link::Connecting,
        }
    }

    pub(super) fn failure(&self) -> Failure {
        Failure::LinkDown { link: self.status(), url: self.url.clone(), cause: self.cause.clone() }
    }

    /// Starts the session and the setup of a new link.
    pub(super) fn open(&mut self, now: Instant, nonce_seed: u64, setup: Setup) {
        let LinkProperties { bytes_per_second, frame_gap, may_duplicate, .. } = self.properties;
        let config = session::SessionConfig { bytes_per_second, frame_gap, may_duplicate, nonce_seed };
        self.session = Some(Session::new(config, now));
        self.is_connecting = false;
        self.close = None;
        self.wire_log.link_up();
        self.set_up(setup);
    }

    /// Takes the link down. Returns the pending requests, each with whether it was never written.
    pub(super) fn down(&mut self, cause: &str) -> Vec<(Purpose, bool)> {
        let mut session = self.session.take();
        self.is_connecting = false;
        if self.close == Some(Close::Drained) {
            tracing::info!(gripper = %self.gripper, "link closed");
            self.unannounced &= session.is_none();
        } else {
            if self.is_up() {
                tracing::warn!(gripper = %self.gripper, cause, "link lost");
            } else if self.cause.as_deref() != Some(cause) {
                tracing::warn!(gripper = %self.gripper, url = self.url, cause, "connection failed");
            }
            if session.is_some() {
                self.unannounced = self.properties.connection_oriented;
            }
        }
        self.state = LinkState::Down;
        self.cause = Some(self.released.clone().unwrap_or_else(|| cause.to_owned()));
        self.close = None;
        let mut requests = Vec::new();
        for (token, purpose) in std::mem::take(&mut self.purposes) {
            let is_unwritten = session.as_mut().is_some_and(|session| session.withdraw(token));
            requests.push((purpose, is_unwritten));
        }
        requests
    }

    /// Begins another setup, which waits for the setters in flight.
    pub(super) fn await_setters(&mut self) {
        self.state = LinkState::SetupWaits;
    }

    /// Whether a setup waits that can begin now.
    pub(super) fn can_set_up(&self) -> bool {
        matches!(self.state, LinkState::SetupWaits) && !self.purposes.values().any(Purpose::concerns_setting)
    }

    pub(super) fn set_up(&mut self, setup: Setup) {
        self.state = LinkState::SettingUp(Box::new(setup));
    }

    /// Sends the next request of the setup. Returns the setup when it is done.
    pub(super) fn continue_setup(&mut self, now: Now) -> Option<Box<Setup>> {
        loop {
            let LinkState::SettingUp(setup) = &mut self.state else { return None };
            match setup.next() {
                Step::Send(command) => {
                    let token = self.submit(now, command, Purpose::Setup).ok();
                    if let LinkState::SettingUp(setup) = &mut self.state {
                        setup.sent(token);
                    }
                    if token.is_some() {
                        return None;
                    }
                }
                Step::Done => {
                    let LinkState::SettingUp(setup) = std::mem::replace(&mut self.state, LinkState::Up) else {
                        return None;
                    };
                    return Some(setup);
                }
                Step::Failed(command) => {
                    let arrived = self.session.as_ref().map(Arrived::at).unwrap_or_default();
                    self.close = Some(Close::SetupFailed(command, arrived));
                    return None;
                }
            }
        }
    }

    /// Takes the result of a setup request. Returns whether it was the pending one, so that the setup can continue.
    pub(super) fn setup_ended(&mut self, token: Token, end: End) -> bool {
        let LinkState::SettingUp(setup) = &mut self.state else { return false };
        let is_current = setup.is_current(token);
        match end {
            End::Reply(reply) if is_current => setup.take(reply),
            End::Invalid(_) if is_current => setup.take_invalid(),
            _ => {}
        }
        is_current
    }

    /// Marks the link as connected after its setup.
    pub(super) fn ready(&mut self) {
        self.was_up = true;
        self.cause = None;
        self.unannounced = false;
    }

    /// Whether nothing at all has arrived for this long.
    pub(super) fn is_silent(&self, now: Instant, time: Duration) -> bool {
        self.session.as_ref().is_some_and(|session| now.saturating_duration_since(session.last_heard()) >= time)
    }

    /// Time at which continued silence, or that of the flags, makes the link unresponsive, or closes it.
    pub(super) fn silence_at(&self, flags_end_at: Option<Instant>) -> Option<Instant> {
        let session = self.session.as_ref().filter(|_| self.is_up())?;
        if self.cause.is_some() {
            return Some(session.last_heard() + CLOSED_AFTER);
        }
        [Some(session.last_heard() + UNRESPONSIVE_AFTER), flags_end_at].into_iter().flatten().min()
    }

    /// Handles silence of the device, or `unknown` flags. Returns whether the device is responsive again.
    pub(super) fn supervise(&mut self, now: Instant, unknown: Option<String>) -> bool {
        let Some(session) = self.session.as_ref().filter(|_| self.is_up()) else { return false };
        let silent_for = now.saturating_duration_since(session.last_heard());
        if silent_for >= CLOSED_AFTER {
            self.close = Some(Close::Silent(silent_for.as_millis() as u64));
            return false;
        }
        let cause = if silent_for >= UNRESPONSIVE_AFTER {
            format!("nothing heard from the device for {} ms", UNRESPONSIVE_AFTER.as_millis())
        } else if let Some(unknown) = unknown {
            unknown
        } else {
            return self.cause.take().is_some();
        };
        if self.cause.is_none() {
            tracing::warn!(gripper = %self.gripper, cause, "device unresponsive");
            self.cause = Some(cause);
        }
        false
    }

    pub(super) fn receive(&mut self, now: Now, bytes: &[u8]) {
        self.wire_log.received(now, bytes);
        if let Some(session) = &mut self.session {
            session.receive(now.instant, bytes);
        }
    }

    pub(super) fn poll_event(&mut self) -> Option<SessionEvent> {
        self.session.as_mut()?.poll_event()
    }

    /// Appends the next frame to `out`. Returns its id, if there is one.
    pub(super) fn poll_transmit(&mut self, now: Now, out: &mut Vec<u8>) -> Option<u8> {
        let start = out.len();
        if !self.session.as_mut()?.poll_transmit(now.instant, out) {
            return None;
        }
        let id = out[start + wsg::frame::PREAMBLE.len()];
        tracing::trace!(gripper = %self.gripper, id = id::name(id), frame = %hex::encode(&out[start..]), "frame sent");
        self.wire_log.sent(now, &out[start..]);
        Some(id)
    }

    /// Submits a request to the session.
    pub(super) fn submit(&mut self, now: Now, command: Command, purpose: Purpose) -> Result<Token, NotSubmitted> {
        self.submit_within(now, command, purpose, REPLY_WITHIN, RESULT_WITHIN)
    }

    pub(super) fn submit_within(
        &mut self,
        now: Now,
        command: Command,
        purpose: Purpose,
        reply_within: Duration,
        result_within: Duration,
    ) -> Result<Token, NotSubmitted> {
        let Some(session) = &mut self.session else { return Err(Box::new((self.failure().into(), purpose))) };
        let name = name_of(&command);
        let failure = match session.submit(now.instant, session::Request { command, reply_within, result_within }) {
            Ok(token) => {
                self.purposes.insert(token, purpose);
                return Ok(token);
            }
            Err(NotTaken::Unanswered) => Failure::NotSent { command: name },
            Err(NotTaken::Full { limit }) => Failure::Overloaded { limit },
            Err(NotTaken::LineTime { line_ms }) => {
                let max_ms = session::MAX_LINE_TIME_WHILE_MOVING.as_millis() as u64;
                Failure::LineTime { command: name, line_ms, max_ms }
            }
        };
        Err(Box::new((failure.into(), purpose)))
    }

    /// Withdraws a request. Returns `false` if its frame was written, in whole or in part.
    pub(super) fn withdraw(&mut self, token: Token) -> bool {
        let withdrawn = self.session.as_mut().is_some_and(|session| session.withdraw(token));
        if withdrawn {
            self.purposes.remove(&token);
        }
        withdrawn
    }

    /// Sends a Stop of the gateway's own, unless a Stop is waiting to be written. This keeps room in the queue for
    /// clients' Stops. Without a link, the Stop follows after the next setup.
    pub(super) fn send_stop(&mut self, now: Now, stop: OwnStop) {
        match &self.session {
            None => self.owed_stop = Some(stop),
            Some(session) if session.has_waiting(id::STOP) => {}
            Some(_) => drop(self.submit(now, Command::Stop, Purpose::OwnStop(stop))),
        }
    }

    /// The newest pending Stop of a client.
    pub(super) fn newest_stop(&self) -> Option<CommandId> {
        self.purposes.values().rev().find_map(|purpose| match purpose {
            Purpose::Stop(id) => Some(*id),
            _ => None,
        })
    }

    /// Expects any outstanding results of motions soon, because the device has stopped.
    pub(super) fn expect_aborts(&mut self, now: Now) {
        if let Some(session) = &mut self.session {
            session.expect_aborts(now.instant);
        }
    }
}
