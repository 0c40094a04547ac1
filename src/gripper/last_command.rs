//! The newest motion of a gripper, with its result and its number. Polling clients recognise their commands by number.

use serde::{Deserialize, Serialize};

use model::{CommandId, Outcome};

/// The newest motion, also across restarts of the gateway. Stops and streamed commands do not count.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct LastCommand {
    /// Number of the motion: grows with each motion. 1 follows 4294967295; 0 stands for none so far.
    number: u32,
    id: Option<CommandId>,
    /// Result of the motion; `None` while it runs.
    outcome: Option<Outcome>,
    /// Count of numbers that the next motion skips.
    #[serde(default)]
    skipped: u32,
}

impl LastCommand {
    /// Restores the motion after a restart. A motion that was running has ended as `UNKNOWN`. Up to `skipped` further
    /// numbers may have been used without being persisted.
    pub(super) fn restored(self, skipped: u32) -> Self {
        let outcome = self.id.map(|_| self.outcome.unwrap_or(Outcome::Unknown));
        Self { outcome, skipped: self.skipped.saturating_add(skipped), ..self }
    }

    /// Notes an admitted motion, and returns its number.
    pub(super) fn admitted(&mut self, id: CommandId) -> u32 {
        let next = self.number.checked_add(self.skipped).and_then(|number| number.checked_add(1));
        let number = next.unwrap_or(1);
        *self = Self { number, id: Some(id), outcome: None, skipped: 0 };
        number
    }

    pub(super) fn ended(&mut self, id: CommandId, outcome: Option<Outcome>) {
        if self.id == Some(id) {
            self.outcome = outcome;
        }
    }

    pub(super) fn number(&self) -> u32 {
        self.number
    }

    /// Number of the motion with this id, if it is the newest.
    pub(super) fn number_of(&self, id: CommandId) -> Option<u32> {
        (self.id == Some(id)).then_some(self.number)
    }

    pub(super) fn id(&self) -> Option<CommandId> {
        self.id
    }

    pub(super) fn outcome(&self) -> Option<Outcome> {
        self.outcome
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn number_is_never_zero_after_a_motion() {
        let newest = LastCommand { number: u32::MAX, ..LastCommand::default() };
        for mut newest in [newest.clone(), newest.restored(1000)] {
            assert_eq!(newest.admitted(CommandId::generate()), 1);
        }
    }

    #[test]
    fn motion_that_ran_at_a_restart_is_unknown() {
        let mut motion = LastCommand::default();
        assert_eq!(motion.admitted(CommandId::generate()), 1);
        let mut restored = motion.restored(1000);
        assert_eq!((restored.number(), restored.outcome()), (1, Some(Outcome::Unknown)));
        assert_eq!(restored.admitted(CommandId::generate()), 1002);
        assert_eq!(LastCommand::default().restored(0), LastCommand::default());
    }

    #[test]
    fn skipped_numbers_outlive_a_restart_without_a_motion() {
        let mut motion = LastCommand::default();
        motion.admitted(CommandId::generate());
        let persisted = serde_json::to_string(&motion.restored(1000)).unwrap();
        let mut again = serde_json::from_str::<LastCommand>(&persisted).unwrap().restored(0);
        assert_eq!(again.admitted(CommandId::generate()), 1002);
    }
}
