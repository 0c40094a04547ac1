//! Settings whose requests were written and not answered: they may have taken effect, or take effect late. They are read
//! back once the device answers again.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::Now;
use crate::actor::Actor;
use crate::actor::link::Purpose;
use crate::setup::Setting;
use model::Client;
use wsg::session::End;
use wsg::{Command, Reply, Status};

/// Period of the attempts to read a setting back.
const READ_EVERY: Duration = Duration::from_secs(1);

/// Settings to be read back, each with the client that requested it.
#[derive(Debug, Default)]
pub(in crate::actor) struct Unconfirmed {
    settings: BTreeMap<Setting, Client>,
    read_at: Option<Instant>,
}

impl Unconfirmed {
    pub(in crate::actor) fn add(&mut self, now: Instant, setting: Setting, client: Client) {
        self.settings.insert(setting, client);
        self.read_at.get_or_insert(now);
    }

    /// Forgets everything, because the setup of a link compares all settings.
    pub(in crate::actor) fn forget(&mut self) {
        *self = Self::default();
    }

    pub(in crate::actor) fn next_timeout(&self) -> Option<Instant> {
        self.read_at
    }
}

impl Actor {
    /// Notes a setting whose request was written and not answered.
    pub(in crate::actor) fn note_unanswered(&mut self, now: Now, command: &Command, client: &Client, end: &End) {
        let was_written = matches!(end, End::Unanswered { written: true, .. } | End::NoResult { .. });
        let is_setter = !command.is_read();
        if let Some(setting) = Setting::of(command.id()).filter(|_| was_written && is_setter) {
            self.unconfirmed.add(now.instant, setting, client.clone());
        }
    }

    pub(in crate::actor) fn unconfirmed_due(&self) -> Option<Instant> {
        self.unconfirmed.next_timeout().filter(|_| self.is_in_use())
    }

    pub(in crate::actor) fn read_unconfirmed(&mut self, now: Now) {
        let settings: Vec<_> = self.unconfirmed.settings.keys().copied().collect();
        self.unconfirmed.read_at = (!settings.is_empty()).then_some(now.instant + READ_EVERY);
        for setting in settings {
            let getter = match setting {
                Setting::Acceleration => Command::GetAcceleration,
                Setting::ForceLimit => Command::GetForceLimit,
                Setting::SoftLimits => Command::GetSoftLimits,
            };
            // A full queue counts as no reply.
            let _ = self.link.submit(now, getter, Purpose::Unconfirmed(setting));
        }
    }

    /// Takes a setting that was read back.
    pub(in crate::actor) fn unconfirmed_ended(&mut self, now: Now, setting: Setting, end: End) {
        let End::Reply(reply) = end else { return };
        let Some(client) = self.unconfirmed.settings.remove(&setting) else { return };
        self.reads.forget();
        let wanted_before = self.settings.wanted;
        match reply {
            Reply::Success(data) => {
                self.note_setting(&data);
                if self.settings.wanted != wanted_before {
                    self.recording.set(now, &client, &data);
                }
            }
            Reply::Status(Status::E_NOT_AVAILABLE) if setting == Setting::SoftLimits => {
                self.settings.note_no_soft_limits();
                self.persist_settings();
            }
            Reply::Status(_) => {}
        }
    }
}
