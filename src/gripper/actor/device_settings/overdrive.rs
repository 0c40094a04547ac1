//! Overdrive Mode. The device's flags, not its reply, show whether the mode was switched.

use std::time::{Duration, Instant};

use crate::handle::ResultSender;
use model::error::{Failure, Rejection};
use wsg::{Data, SystemState};

/// Time limit for the flags to show that Overdrive Mode was switched.
const FLAGS_WITHIN: Duration = Duration::from_millis(500);

#[derive(Debug, Default)]
pub(in crate::actor) struct Overdrive {
    is_wanted: bool,
    /// Requests that wait for the flags, each with the end of its wait.
    waiting: Vec<(Instant, ResultSender<Data>)>,
}

impl Overdrive {
    /// Waits for the flags, after the device has accepted a request to switch.
    pub(in crate::actor) fn requested(&mut self, now: Instant, on: bool, answer: ResultSender<Data>) {
        self.is_wanted = on;
        self.waiting.push((now + FLAGS_WITHIN, answer));
    }

    /// Leaves Overdrive Mode off after a restart of the device. Returns whether a client had switched it on.
    pub(in crate::actor) fn give_up(&mut self) -> bool {
        std::mem::take(&mut self.is_wanted)
    }

    /// Answers the requests that the flags show as done. A caller that has gone gets no reply.
    pub(in crate::actor) fn answer(&mut self, flags: Option<SystemState>) {
        if let Some(flags) = flags.filter(|flags| flags.contains(SystemState::OVERDRIVE_MODE) == self.is_wanted) {
            for (_, answer) in self.waiting.drain(..) {
                let _ = answer.send(Ok(Data::SystemState(flags)));
            }
        }
    }

    pub(in crate::actor) fn reject_all(&mut self, rejection: &Rejection) {
        for (_, answer) in self.waiting.drain(..) {
            let _ = answer.send(Err(rejection.clone()));
        }
    }

    pub(in crate::actor) fn expire(&mut self, now: Instant) {
        for (_, answer) in self.waiting.extract_if(.., |(until, _)| *until <= now) {
            let detail = "the flags do not show that Overdrive Mode was switched".to_owned();
            let _ = answer.send(Err(Failure::DeviceProtocol { command: "OverdriveMode", detail }.into()));
        }
    }

    pub(in crate::actor) fn next_timeout(&self) -> Option<Instant> {
        self.waiting.iter().map(|(until, _)| *until).min()
    }
}
