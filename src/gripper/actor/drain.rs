//! The orderly end: no new commands, a running one may finish or is stopped, the device is told, the link closed.

use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::super::Now;
use super::Actor;
use super::link::{Close, Purpose};
use crate::wsg::{Command, SystemState};

/// Time for the device to stop, and then again to acknowledge the announcement.
const ANSWERED_WITHIN: Duration = Duration::from_millis(500);

/// Giving a gripper up.
#[derive(Debug)]
pub(super) struct Drain {
    stage: Stage,
    until: Instant,
    /// Whether 07h was handed out.
    has_announced: bool,
    /// Callers that wait for the end.
    answers: Vec<oneshot::Sender<()>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Stage {
    /// A running command may finish.
    Finishing,
    /// The command did not finish, and is being stopped.
    Stopping,
    /// 07h waits to be written.
    Announcing,
    /// 07h was written: nothing follows it.
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

    /// The device has acknowledged the announcement, or refused it, or said nothing.
    pub(super) fn answered(&mut self) {
        self.stage = Stage::Over;
    }

    pub(super) fn next_timeout(&self) -> Option<Instant> {
        (self.stage != Stage::Over).then_some(self.until)
    }
}

impl Actor {
    /// Begins to give the gripper up.
    pub(super) fn start_drain(&mut self, now: Now, answer: oneshot::Sender<()>) {
        let until = now.instant + self.config.drain;
        let drain = self.drain.get_or_insert_with(|| {
            tracing::info!(gripper = %self.config.name, "giving up in order");
            Drain { stage: Stage::Finishing, until, has_announced: false, answers: Vec::new() }
        });
        drain.answers.push(answer);
    }

    /// Gives the gripper up after its last handle is gone, so that no caller waits.
    pub fn abandon(&mut self, now: Now) {
        let (answer, _) = oneshot::channel();
        self.start_drain(now, answer);
        self.after_input(now);
    }

    /// Whether the gripper is being given up, so that its link is not made again.
    #[must_use]
    pub fn is_draining(&self) -> bool {
        self.drain.is_some()
    }

    /// Whether the device was told that its connection ends.
    #[must_use]
    pub fn has_announced(&self) -> bool {
        self.drain.as_ref().is_some_and(|drain| drain.has_announced)
    }

    /// Answers the callers that wait: the gripper was given up.
    pub fn drained(&mut self, now: Now) {
        self.recording.finish(now);
        self.streaming.write(now, &mut self.recording);
        for answer in self.drain.take().into_iter().flat_map(|drain| drain.answers) {
            let _ = answer.send(());
        }
    }

    pub(super) fn continue_drain(&mut self, now: Now) {
        // No client loses by a request of the set-up.
        let asked = self.link.is_up() && self.link.session.as_ref().is_some_and(|session| !session.is_idle());
        let idle = self.motion.running.is_none() && !self.latch.is_unconfirmed() && !asked;
        let Some(drain) = &mut self.drain else { return };
        let late = drain.until <= now.instant;
        match drain.stage {
            Stage::Finishing if idle => self.leave(now),
            Stage::Finishing if late => {
                drain.stage = Stage::Stopping;
                drain.until = now.instant + ANSWERED_WITHIN;
                if self.motion.running.is_some() {
                    self.withdraw_waiting_motion(now);
                    let _ = self.link.submit(now, Command::Stop, Purpose::Stop(None));
                }
            }
            Stage::Stopping if idle || late => self.leave(now),
            Stage::Announcing | Stage::Announced if late => drain.stage = Stage::Over,
            _ => {}
        }
        if self.drain.as_ref().is_some_and(|drain| drain.stage == Stage::Over) {
            self.link.close = Some(Close::Drained);
        }
    }

    /// Sends the farewell: 07h where the device knows it, or else Stop if the fingers move.
    fn leave(&mut self, now: Now) {
        let connected = !self.link.is_down();
        let farewell = if self.link.properties.connection_oriented {
            Some((Command::DisconnectAnnouncement, Purpose::Announce))
        } else if self.observed.has(SystemState::MOVING) {
            Some((Command::Stop, Purpose::Announce))
        } else {
            None
        };
        let sent = farewell.filter(|_| connected).is_some_and(|(command, purpose)| {
            self.link.submit_within(now, command, purpose, ANSWERED_WITHIN, ANSWERED_WITHIN).is_ok()
        });
        if let Some(drain) = &mut self.drain {
            drain.stage = if sent { Stage::Announcing } else { Stage::Over };
            // The session's own deadlines come first: to be written, then to be answered.
            drain.until = now.instant + 3 * ANSWERED_WITHIN;
        }
    }
}
