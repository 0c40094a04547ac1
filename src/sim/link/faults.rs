//! Faults on demand: armed faults, the stage at which each strikes, and a count per kind.

use serde::{Deserialize, Serialize};

/// Limit of armed faults; further ones are ignored.
pub const MAX_ARMED_FAULTS: usize = 256;

/// A fault that affects one frame of the device, on the wire or in the protocol.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultKind {
    /// A byte of the payload arrives wrong.
    CorruptByte,
    /// The checksum arrives wrong.
    CorruptChecksum,
    /// The size field arrives as FFFFh.
    CorruptSize,
    /// Half a frame arrives, then nothing more until [`Change::Silent`](crate::Change::Silent) ends the silence or a
    /// client reconnects.
    HalfFrame,
    /// Garbage bytes precede the frame.
    Garbage,
    /// A run of AAh precedes the frame.
    PreambleRun,
    /// The header of a missing Loop reply precedes the frame.
    FalsePreamble,
    /// The frame's bytes arrive one by one.
    SplitBytes,
    /// The frame arrives in one chunk with the next frame.
    JoinFrames,
    /// The frame and the connection are lost (TCP).
    DropConnection,
    /// The request is neither executed nor answered.
    NoReply,
    /// The request gets this status at once and is not executed.
    Status {
        /// Any status code, listed or not.
        code: u16,
    },
    /// The request is executed but gets this status as its result.
    FinalStatus {
        /// Any status code, listed or not.
        code: u16,
    },
    /// The result arrives twice.
    FinalTwice,
    /// The result arrives late.
    FinalLate { by_ms: u32 },
    /// The result arrives without `E_CMD_PENDING`.
    FinalWithoutPending,
    /// The result arrives before `E_CMD_PENDING`.
    FinalBeforePending,
    /// `E_CMD_PENDING` arrives, but the result never does.
    PendingWithoutFinal,
    /// The request is accepted, then the device stays silent, as after [`FaultKind::HalfFrame`].
    SilenceAfterAccept,
}

macro_rules! fault_names {
    ($($name:ident)*) => {
        /// Kinds of faults, for counting. [`FaultKind`] describes the armed ones, [`Change`](crate::Change) the others.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        #[allow(missing_docs, reason = "the names explain themselves")]
        pub enum FaultName { $($name),* }

        impl FaultName {
            pub const ALL: &[Self] = &[$(Self::$name),*];
        }
    };
}

fault_names! {
    CorruptByte CorruptChecksum CorruptSize HalfFrame Garbage PreambleRun FalsePreamble SplitBytes JoinFrames
    DropConnection NoReply Status FinalStatus FinalTwice FinalLate FinalWithoutPending FinalBeforePending
    PendingWithoutFinal SilenceAfterAccept Silent HalfOpen RefusedConnection Reboot FastStop TemperatureFault
    CurrentFault PowerFault FingerFault ForeignMotion Obstacle PartTaken PartSlipped ScriptFailure BrokenGetter
}

impl FaultKind {
    #[must_use]
    pub const fn name(self) -> FaultName {
        match self {
            Self::CorruptByte => FaultName::CorruptByte,
            Self::CorruptChecksum => FaultName::CorruptChecksum,
            Self::CorruptSize => FaultName::CorruptSize,
            Self::HalfFrame => FaultName::HalfFrame,
            Self::Garbage => FaultName::Garbage,
            Self::PreambleRun => FaultName::PreambleRun,
            Self::FalsePreamble => FaultName::FalsePreamble,
            Self::SplitBytes => FaultName::SplitBytes,
            Self::JoinFrames => FaultName::JoinFrames,
            Self::DropConnection => FaultName::DropConnection,
            Self::NoReply => FaultName::NoReply,
            Self::Status { .. } => FaultName::Status,
            Self::FinalStatus { .. } => FaultName::FinalStatus,
            Self::FinalTwice => FaultName::FinalTwice,
            Self::FinalLate { .. } => FaultName::FinalLate,
            Self::FinalWithoutPending => FaultName::FinalWithoutPending,
            Self::FinalBeforePending => FaultName::FinalBeforePending,
            Self::PendingWithoutFinal => FaultName::PendingWithoutFinal,
            Self::SilenceAfterAccept => FaultName::SilenceAfterAccept,
        }
    }

    pub(super) const fn stage(self) -> FaultStage {
        match self {
            Self::NoReply | Self::Status { .. } => FaultStage::Request,
            Self::FinalWithoutPending | Self::FinalBeforePending => FaultStage::Pending,
            Self::FinalStatus { .. }
            | Self::FinalTwice
            | Self::FinalLate { .. }
            | Self::PendingWithoutFinal
            | Self::SilenceAfterAccept => FaultStage::Result,
            Self::JoinFrames => FaultStage::Join,
            _ => FaultStage::Wire,
        }
    }
}

/// Stage in the handling of a frame at which a fault strikes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FaultStage {
    /// Before the request is processed.
    Request,
    /// Instead of `E_CMD_PENDING`.
    Pending,
    /// When the result is known.
    Result,
    /// When two frames can leave together.
    Join,
    /// When the frame leaves.
    Wire,
}

/// Number of occurrences of each kind of fault.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FaultCounts([u64; FaultName::ALL.len()]);

impl Default for FaultCounts {
    fn default() -> Self {
        Self([0; FaultName::ALL.len()])
    }
}

impl FaultCounts {
    #[must_use]
    pub fn of(&self, name: FaultName) -> u64 {
        self.0[name as usize]
    }

    pub fn iter(&self) -> impl Iterator<Item = (FaultName, u64)> {
        FaultName::ALL.iter().map(|&name| (name, self.of(name)))
    }

    pub(crate) fn add(&mut self, name: FaultName) {
        self.0[name as usize] += 1;
    }
}

#[derive(Debug)]
struct Armed {
    kind: FaultKind,
    id: Option<u8>,
    times: u32,
}

#[derive(Debug, Default)]
pub(crate) struct Faults {
    armed: Vec<Armed>,
    pub counts: FaultCounts,
}

impl Faults {
    /// Arms a fault for the next `times` frames of `id`, or of any id.
    pub fn arm(&mut self, kind: FaultKind, id: Option<u8>, times: u32) {
        if times > 0 && self.armed.len() < MAX_ARMED_FAULTS {
            self.armed.push(Armed { kind, id, times });
        }
    }

    pub fn disarm(&mut self) {
        self.armed.clear();
    }

    /// Whether a fault is armed for a frame of `id` at `stage`.
    pub fn is_armed(&self, id: u8, stage: FaultStage) -> bool {
        self.armed.iter().any(|armed| armed.strikes(id, stage))
    }

    /// Takes and counts a fault armed for a frame of `id` at `stage`.
    pub fn take(&mut self, id: u8, stage: FaultStage) -> Option<FaultKind> {
        self.take_if(id, stage, |_| true)
    }

    pub fn take_if(&mut self, id: u8, stage: FaultStage, allowed: impl Fn(FaultKind) -> bool) -> Option<FaultKind> {
        let index = self.armed.iter().position(|armed| armed.strikes(id, stage) && allowed(armed.kind))?;
        let armed = &mut self.armed[index];
        let kind = armed.kind;
        armed.times -= 1;
        if armed.times == 0 {
            self.armed.remove(index);
        }
        self.counts.add(kind.name());
        Some(kind)
    }
}

impl Armed {
    fn strikes(&self, id: u8, stage: FaultStage) -> bool {
        self.kind.stage() == stage && self.id.is_none_or(|wanted| wanted == id)
    }
}

#[cfg(test)]
#[path = "faults_tests.rs"]
mod tests;
