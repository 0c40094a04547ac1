//! A journal that is slow, and sometimes fails to store a record.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use gripper::Record;
use gripper::actor::Actor;
use gripper::recorder::RestoredState;
use model::{CommandEvent, CommandId, Detail, DeviceEvent, Outcome, PersistedKey};
use rand::RngExt;

use super::client::{Admitted, is_streamed};
use super::leases::Leases;
use super::world::World;

/// Records of the actor.
#[derive(Default)]
pub struct Journal {
    /// Pending writes: when each ends, its command, and whether it succeeds.
    writing: Vec<(Instant, CommandId, bool)>,
    durable: BTreeSet<CommandId>,
    admitted: BTreeMap<CommandId, usize>,
    done: BTreeMap<CommandId, Vec<Outcome>>,
    pub grips: usize,
    pub foreign_motions: usize,
    /// Grip commands of lost parts.
    pub lost_parts: Vec<Option<CommandId>>,
    pub events: Vec<Detail>,
    memory: BTreeMap<PersistedKey, Option<String>>,
}

impl Journal {
    /// Returns the state that a restarted gateway restores.
    pub fn restored(&self) -> RestoredState {
        let remembered = |key| self.memory.get(&key).cloned().flatten();
        RestoredState {
            settings: remembered(PersistedKey::Settings),
            latch: remembered(PersistedKey::Latch),
            lease: remembered(PersistedKey::Lease),
            holding: remembered(PersistedKey::Holding),
            last_command: remembered(PersistedKey::LastCommand),
            requests: Vec::new(),
            unclean: false,
            unknown_past: None,
        }
    }

    pub fn due(&self) -> Option<Instant> {
        self.writing.iter().map(|(at, ..)| *at).min()
    }

    pub fn is_durable(&self, id: CommandId) -> bool {
        self.durable.contains(&id)
    }

    /// Outcomes in the final events of a command.
    pub fn ends_of(&self, id: CommandId) -> &[Outcome] {
        self.done.get(&id).map_or(&[], Vec::as_slice)
    }

    /// Takes the actor's records, and reports finished writes to the actor.
    pub fn keep(world: &mut World) {
        loop {
            while let Some((record, awaited_by)) = world.actor.poll_record() {
                world.count_step();
                if let Record::Event(event, _) = &record {
                    world.journal.events.push(event.detail.clone());
                    if let Detail::Lease(lease) = &event.detail {
                        Leases::recorded(world, lease);
                    }
                }
                world.journal.take(&record);
                if let Some(id) = awaited_by {
                    Self::write(world, id);
                }
            }
            let now = world.now;
            let Some(index) = world.journal.writing.iter().position(|(at, ..)| *at <= now) else { return };
            let (_, id, durable) = world.journal.writing.remove(index);
            if durable {
                world.journal.durable.insert(id);
            }
            let now = world.clock();
            world.actor.recorded(now, id, durable);
        }
    }

    fn write(world: &mut World, id: CommandId) {
        if !world.noisy {
            world.journal.writing.push((world.now, id, true));
            return;
        }
        let [fails, stalls] = [0.01, 0.01].map(|chance| world.rng.random_bool(chance));
        world.count("journal: a write failed", fails);
        world.count("journal: the disk stalled", stalls);
        let longest_ms = if stalls { 2000 } else { 10 };
        let time = Duration::from_millis(world.rng.random_range(0..longest_ms));
        world.journal.writing.push((world.now + time, id, !fails));
    }

    fn take(&mut self, record: &Record) {
        match record {
            Record::Event(event, _) => {
                if let Detail::Device(DeviceEvent::PartLost { .. }) = event.detail {
                    self.lost_parts.push(event.command_id);
                }
                if event.detail == Detail::Device(DeviceEvent::ForeignMotion) {
                    self.foreign_motions += 1;
                }
                let (Detail::Command(detail), Some(id)) = (&event.detail, event.command_id) else { return };
                match detail {
                    CommandEvent::Admitted(_) => *self.admitted.entry(id).or_default() += 1,
                    CommandEvent::Done(done) => self.done.entry(id).or_default().push(done.outcome),
                }
            }
            Record::Grip(_) => self.grips += 1,
            Record::Persisted(memory) => {
                self.memory.insert(memory.key, memory.value.clone());
            }
        }
    }

    /// Checks for two records per command, the second with the outcome that the client saw. Stream requests are counted
    /// instead.
    pub fn check(world: &World) {
        let has_records = |admitted: &&Admitted| !admitted.motion.as_ref().is_some_and(is_streamed);
        let (recorded, streamed): (Vec<_>, Vec<_>) = world.clients.admitted.iter().partition(has_records);
        for admitted in &recorded {
            let command = admitted.ticket.now();
            let records = (world.journal.admitted.get(&command.id), world.journal.ends_of(command.id));
            let outcome = command.outcome.expect("the command has ended");
            assert_eq!(records, (Some(&1), &[outcome][..]), "every_command_ends_once\n{}", world.tail());
        }
        assert_eq!(world.journal.admitted.len(), recorded.len(), "{}", world.tail());
        let count = |event: &Detail| match event {
            Detail::Device(DeviceEvent::Streamed { count, .. }) => *count,
            _ => 0,
        };
        let counted: u64 = world.journal.events.iter().map(count).sum();
        assert_eq!(counted, streamed.len() as u64, "stream requests are counted once\n{}", world.tail());
    }
}

impl World {
    /// Kills the gateway, and starts a new one.
    pub fn restart(&mut self) {
        self.disconnected("killed");
        Journal::keep(self);
        (self.actor, self.watches) = Actor::new(self.config.clone());
        let now = self.clock();
        self.actor.restore(now, self.journal.restored());
        self.settle();
    }
}
