//! Commands, rebuilt from their records.

use std::sync::Arc;

use jiff::Timestamp;
use serde::Deserialize;

use crate::model::{CommandEvent, CommandId, CommandReport, Done, Door, Name, Phase, RequestedValues};

/// The parts of a `command` event that describe the command.
#[derive(Debug, Deserialize)]
pub(in crate::journal) struct CommandBody {
    pub(in crate::journal) at: Timestamp,
    pub(in crate::journal) gripper: Name,
    pub(in crate::journal) subject: Arc<str>,
    pub(in crate::journal) door: Option<Door>,
    pub(in crate::journal) command_id: CommandId,
    #[serde(flatten)]
    pub(in crate::journal) event: CommandEvent,
}

impl CommandBody {
    pub(in crate::journal) fn command(self) -> CommandReport {
        let kind = match &self.event {
            CommandEvent::Admitted(admitted) => admitted.command,
            CommandEvent::Done(done) => done.command,
        };
        let running = CommandReport {
            recorded: true,
            accepted: true,
            ..CommandReport::running(self.command_id, self.gripper, kind, self.subject, self.at)
        };
        match self.event {
            CommandEvent::Admitted(admitted) => {
                let holder = admitted.holder;
                let request_id = admitted.request_id;
                let requested = RequestedValues { holder, request_id, ..RequestedValues::from(&admitted.parameters) };
                CommandReport { requested, ..running }
            }
            CommandEvent::Done(done) => ended(running, *done),
        }
    }
}

fn ended(running: CommandReport, done: Done) -> CommandReport {
    CommandReport {
        phase: Phase::Done,
        outcome: Some(done.outcome),
        outcome_code: done.outcome.code(),
        status: done.status,
        status_code: done.status_code,
        reached_goal: done.reached_goal,
        stalled: done.stalled,
        width_mm: done.width_mm,
        force_n: done.force_n,
        contact_width_mm: done.contact_width_mm,
        started_at: done.started_at,
        duration_ms: done.duration_ms,
        fast_stop_id: done.fast_stop_id,
        code: done.code,
        detail: done.cause,
        requested: done.requested,
        ..running
    }
}

/// Returns the command of a `command` event: running after the first record, with its outcome after the second.
/// Returns `None` for any other body.
#[must_use]
pub fn command_of(body: &str) -> Option<CommandReport> {
    serde_json::from_str(body).ok().map(CommandBody::command)
}
