//! Draining, the orderly disconnect: new commands are rejected, a running one finishes or is stopped, the disconnect is
//! announced, and the link is closed. A drain ends the gripper, releases the device to another program, or precedes a new
//! configuration.

use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::super::Now;
use super::super::automatic_updates;
use super::super::handle::ResultSender;
use super::Actor;
use super::link::{Close, OwnStop, Purpose};
use model::error::{Conflict, Failure, Rejection};
use model::{Client, LeaseToken, ServoEnd};
use wsg::{Command, SystemState};

/// Time limit for the device to stop, and again for its reply to the announcement.
const ANSWERED_WITHIN: Duration = Duration::from_millis(500);

/// A drain under way.
#[derive(Debug)]
pub(super) struct Drain {
    stage: Stage,
    until: Instant,
    /// Whether 07h was handed out.
    has_announced: bool,
    /// Whether a Stop was one of the last requests.
    has_stopped: bool,
    ending: Ending,
}

/// Object that a drain ends, with the callers to answer.
#[derive(Debug)]
enum Ending {
    /// The gripper, and the callers that wait for its end.
    Gripper(Vec<oneshot::Sender<()>>),
    /// The link only, and the client that releases the device.
    Link(ResultSender<()>),
    /// The link only, before a new configuration.
    Configuration,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// A running command has time to finish.
    Finishing,
    /// The command did not finish, and is being stopped.
    Stopping,
    /// The last requests wait to be written, or for their replies.
    Leaving,
    /// 07h was written, and nothing may follow.
    Announced,
    /// The link can be closed.
    Over,
}

impl Drain {
    /// Whether the announcement was written.
    pub(super) fn is_announced(&self) -> bool {
        matches!(self.stage, Stage::Announced | Stage::Over)
    }

    pub(super) fn announced(&mut self) {
        self.has_announced = true;
        self.stage = Stage::Announced;
    }

    pub(super) fn next_timeout(&self) -> Option<Instant> {
        (self.stage != Stage::Over).then_some(self.until)
    }
}

impl Actor {
    pub(super) fn start_drain(&mut self, now: Now, answer: oneshot::Sender<()>) {
        match &mut self.drain {
            Some(Drain { ending: Ending::Gripper(answers), .. }) => answers.push(answer),
            Some(Drain { ending, .. }) => {
                if let Ending::Link(client) = std::mem::replace(ending, Ending::Gripper(vec![answer])) {
                    self.answers.add(client, Err(Failure::Draining.into()));
                }
            }
            None => self.begin_drain(now, Ending::Gripper(vec![answer])),
        }
    }

    pub(super) fn start_reconfiguration_drain(&mut self, now: Now) {
        if self.drain.is_none() {
            self.begin_drain(now, Ending::Configuration);
        }
    }

    fn begin_drain(&mut self, now: Now, ending: Ending) {
        tracing::info!(gripper = %self.config.name, "draining");
        self.stop_servo(now, ServoEnd::Link);
        let until = now.instant + self.config.rules.shared.drain;
        self.drain = Some(Drain { stage: Stage::Finishing, until, has_announced: false, has_stopped: false, ending });
    }

    /// Releases the device to another program. The client is answered once the link is closed and no attempt to
    /// connect is under way.
    pub(super) fn disconnect(
        &mut self,
        now: Now,
        client: &Client,
        lease: Option<&LeaseToken>,
        answer: ResultSender<()>,
    ) {
        if let Err(rejection) = self.check_disconnect(now, client, lease) {
            self.answers.add(answer, Err(rejection));
            return;
        }
        tracing::info!(gripper = %self.config.name, by = %client.subject, "releasing the device");
        self.link.release(client);
        if self.link.is_down() && !self.link.is_connecting {
            self.answers.add(answer, Ok(()));
        } else {
            self.begin_drain(now, Ending::Link(answer));
        }
    }

    fn check_disconnect(&self, now: Now, client: &Client, lease: Option<&LeaseToken>) -> Result<(), Rejection> {
        self.check_claim(now, client, lease)?;
        match self.motion.id() {
            _ if self.drain.is_some() => Err(Failure::Draining.into()),
            _ if self.link.is_released() => Ok(()),
            Some(id) => Err(Conflict::AlreadyRunning { id }.into()),
            // The gateway repeats a FAST STOP only while it is connected, so it must not leave before the confirmation.
            None if self.latch.is_unconfirmed() => {
                self.latch.id().map_or(Ok(()), |id| Err(Conflict::FastStopUnconfirmed { id }.into()))
            }
            None if self.link.is_down() && self.motion.may_move(now.instant) => Err(Conflict::FingersMove.into()),
            None if !self.link.is_down() && self.is_moving(now.instant) => Err(Conflict::FingersMove.into()),
            None => Ok(()),
        }
    }

    /// Lets the gateway connect to a released device again.
    pub(super) fn connect(&mut self, now: Now, client: &Client, lease: Option<&LeaseToken>, answer: ResultSender<()>) {
        let result = match self.check_claim(now, client, lease) {
            Ok(()) if self.drain.is_some() => Err(Failure::Draining.into()),
            allowed => allowed.map_err(Rejection::from),
        };
        if result.is_ok() && self.link.reclaim() {
            tracing::info!(gripper = %self.config.name, by = %client.subject, "reclaiming the device");
        }
        self.answers.add(answer, result);
    }

    /// Whether the device is released to another program, so that the gateway must not connect.
    #[must_use]
    pub fn is_released(&self) -> bool {
        self.link.is_released()
    }

    /// Ends a drain of the link alone, once the link is down. Returns the client to answer.
    pub(super) fn end_link_drain(&mut self) -> Option<ResultSender<()>> {
        match self.drain.take_if(|drain| !matches!(drain.ending, Ending::Gripper(_)))?.ending {
            Ending::Link(answer) => Some(answer),
            Ending::Gripper(_) | Ending::Configuration => None,
        }
    }

    /// Begins a drain without a caller, after the last handle is gone.
    pub fn abandon(&mut self, now: Now) {
        let (answer, _) = oneshot::channel();
        self.start_drain(now, answer);
        self.after_input(now);
    }

    /// Whether the gripper is ending, so that the gateway must not connect again.
    #[must_use]
    pub fn is_draining(&self) -> bool {
        self.drain.as_ref().is_some_and(|drain| matches!(drain.ending, Ending::Gripper(_)))
    }

    /// Whether a disconnect was announced to the device.
    #[must_use]
    pub fn has_announced(&self) -> bool {
        self.drain.as_ref().is_some_and(|drain| drain.has_announced)
    }

    /// Records what is pending, and answers the callers that wait for the drain.
    pub fn drained(&mut self, now: Now) {
        self.recording.finish(now);
        self.streaming.write(now, &mut self.recording);
        if let Some(Drain { ending: Ending::Gripper(answers), .. }) = self.drain.take() {
            for answer in answers {
                let _ = answer.send(());
            }
        }
    }

    pub(super) fn continue_drain(&mut self, now: Now) {
        let Some(drain) = &mut self.drain else { return };
        // During setup, the requests in flight are not clients' requests, and need not be waited for.
        let is_busy = self.link.is_up() && self.link.session.as_ref().is_some_and(|session| !session.is_idle());
        let is_unconfirmed = self.latch.is_unconfirmed();
        let idle = self.motion.running.is_none() && !is_unconfirmed && !is_busy;
        let is_answered = !self.link.purposes.values().any(|purpose| matches!(purpose, Purpose::LastRequest));
        let late = drain.until <= now.instant;
        match drain.stage {
            Stage::Finishing if idle => self.leave(now),
            Stage::Finishing if late => {
                drain.stage = Stage::Stopping;
                drain.until = now.instant + ANSWERED_WITHIN;
                if self.motion.running.is_some() {
                    self.withdraw_waiting_motion(now);
                    self.link.send_stop(now, OwnStop::new(self.motion.id()));
                }
            }
            Stage::Stopping if idle || late => self.leave(now),
            Stage::Leaving | Stage::Announced if late => drain.stage = Stage::Over,
            Stage::Announced if is_answered => drain.stage = Stage::Over,
            // Fingers can have begun to move meanwhile, and a FAST STOP can have been sent.
            Stage::Leaving if is_answered && !is_unconfirmed => {
                if !self.stop_before_leaving(now)
                    && let Some(drain) = &mut self.drain
                {
                    drain.stage = Stage::Over;
                }
            }
            _ => {}
        }
        if self.drain.as_ref().is_some_and(|drain| drain.stage == Stage::Over) {
            self.link.close = Some(Close::Drained);
        }
    }

    /// Sends the last requests. On a transport with connections, that is 07h. On others, it is a Stop if the fingers
    /// move, then the requests that switch the updates off, because the device would go on sending them.
    fn leave(&mut self, now: Now) {
        let mut is_sent = false;
        if !self.link.is_down() {
            if self.link.properties.connection_oriented {
                is_sent = self.submit_last(now, Command::DisconnectAnnouncement);
            } else {
                is_sent = self.stop_before_leaving(now);
                for command in automatic_updates::switch_off_all() {
                    is_sent |= self.submit_last(now, command);
                }
            }
        }
        if let Some(drain) = &mut self.drain {
            drain.stage = if is_sent { Stage::Leaving } else { Stage::Over };
            // Longer than the session's own deadlines for writing and for the reply.
            drain.until = now.instant + 3 * ANSWERED_WITHIN;
        }
    }

    fn submit_last(&mut self, now: Now, command: Command) -> bool {
        self.link.submit_within(now, command, Purpose::LastRequest, ANSWERED_WITHIN, ANSWERED_WITHIN).is_ok()
    }

    /// Sends one Stop if the fingers move, on a transport without connections. Returns whether it was sent now.
    fn stop_before_leaving(&mut self, now: Now) -> bool {
        let moves = self.observed.has(SystemState::MOVING) && !self.link.properties.connection_oriented;
        if !moves || self.drain.as_ref().is_none_or(|drain| drain.has_stopped) {
            return false;
        }
        let is_sent = self.submit_last(now, Command::Stop);
        if let Some(drain) = &mut self.drain {
            drain.has_stopped = is_sent;
        }
        is_sent
    }
}
