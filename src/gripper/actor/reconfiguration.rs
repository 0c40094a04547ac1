//! A new configuration for a running gripper, whose latch, lease and commands stay.

use std::sync::Arc;

use tokio::sync::oneshot;

use super::super::Now;
use super::super::connector::Connector;
use super::super::handle::Reconfiguration;
use super::super::observed::Observed;
use super::Actor;

/// A new configuration that waits for the end of the link.
#[derive(Debug)]
pub(super) struct Pending {
    change: Box<Reconfiguration>,
    answer: oneshot::Sender<()>,
}

impl Actor {
    /// Applies a new configuration, at once if the link can stay.
    pub(super) fn reconfigure(&mut self, now: Now, change: Box<Reconfiguration>, answer: oneshot::Sender<()>) {
        let keeps_link = change.connector.is_none() && change.config.rules.updates == self.config.rules.updates;
        let has_no_link = self.link.is_down() && !self.link.is_connecting;
        self.pending = Some(Pending { change, answer });
        if keeps_link || has_no_link {
            self.finish_reconfiguration();
        } else {
            self.start_reconfiguration_drain(now);
        }
    }

    /// Applies the waiting configuration, if there is one.
    pub(super) fn finish_reconfiguration(&mut self) {
        let Some(Pending { change, answer }) = self.pending.take() else { return };
        let Reconfiguration { config, connector } = *change;
        self.publication.reconfigure(&config, connector.is_some());
        self.motion.set_pause(config.rules.motion_pause);
        self.recording.set_on_failure(config.rules.shared.on_journal_failure);
        if let Some(connector) = connector {
            self.observed = Observed::new(config.rules.updates, config.properties.bytes_per_second);
            self.link.url.clone_from(&config.url);
            self.link.properties = config.properties;
            self.link.unannounced = false;
            self.link.owed_stop = None;
            self.motion.forget_unseen();
            self.connector = Some(connector);
        } else {
            self.observed.set_rules(config.rules.updates, config.properties.bytes_per_second);
        }
        self.config = config;
        self.answers.add(answer, ());
    }

    /// Whether a new configuration waits for the end of the link, so that the gateway must not connect.
    #[must_use]
    pub fn is_reconfiguring(&self) -> bool {
        self.pending.is_some()
    }

    /// Returns the new device of the last configuration, once.
    pub fn take_connector(&mut self) -> Option<Arc<dyn Connector>> {
        self.connector.take()
    }
}
