//! Getters that no longer return their values, while the device goes on otherwise.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use wsg::{Reply, Status, frame};

use crate::Device;
use crate::link::faults::FaultName;

/// What a broken getter sends instead of its value, in replies and in automatic updates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BrokenGetter {
    /// Nothing.
    Silent,
    /// This status.
    Status {
        /// Any status code other than success.
        code: u16,
    },
    /// NaN; for a getter without a number, these four bytes.
    NotANumber,
}

/// Broken getters by id.
#[derive(Debug, Default)]
pub(crate) struct BrokenGetters(BTreeMap<u8, BrokenGetter>);

impl BrokenGetters {
    pub(crate) fn mend(&mut self) {
        self.0.clear();
    }
}

impl Device {
    pub(crate) fn break_getter(&mut self, id: u8, how: BrokenGetter) {
        self.broken_getters.0.insert(id, how);
    }

    /// Returns the frame of a reply or update, as a broken getter sends it; `None` if it sends nothing.
    pub(super) fn frame_of(&mut self, id: u8, reply: &Reply) -> Option<Vec<u8>> {
        let mut bytes = Vec::new();
        let Some(how) = self.broken_getters.0.get(&id) else {
            reply.encode(id, &mut bytes);
            return Some(bytes);
        };
        self.faults.counts.add(FaultName::BrokenGetter);
        match how {
            BrokenGetter::Silent => return None,
            BrokenGetter::Status { code } => Reply::Status(Status::from_code(*code)).encode(id, &mut bytes),
            BrokenGetter::NotANumber => {
                let success = Status::E_SUCCESS.code().to_le_bytes();
                frame::encode(id, &[&success[..], &f32::NAN.to_le_bytes()].concat(), &mut bytes);
            }
        }
        Some(bytes)
    }
}
