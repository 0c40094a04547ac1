//! The table of operations.

use futures_util::future::{BoxFuture, FutureExt as _};
use http::Method as Verb;

use super::call::Call;
use super::problem::Problem;
use super::reply::{IntoReply, Reply};
use super::{commands, device, fast_stop, fingers, fleet, grippers, lease, motion, raw, settings};
use crate::gripper::model::Urgency;

/// An operation.
#[derive(Debug, Clone, Copy)]
pub struct Operation {
    /// Its name: WebSocket's method, and the last part of Zenoh's command key.
    pub name: &'static str,
    /// HTTP's method.
    pub verb: &'static Verb,
    /// HTTP's path, below the API's. What it names stands among the parameters of the other interfaces.
    pub path: &'static str,
    /// The role that it needs.
    pub role: Role,
    /// What it may wait behind.
    pub urgency: Urgency,
    /// Whether it starts a command, whose end is reported later.
    pub starts_command: bool,
    run: Run,
}

type Run = fn(Call) -> BoxFuture<'static, Result<Reply, Problem>>;

/// What a client is entitled to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Stops only: a light curtain's box.
    Stop,
    /// Reads.
    Observer,
    /// Moves the gripper, holds its lease, changes its settings, acknowledges.
    Operator,
    /// Sends requests of the device's own protocol.
    Supervisor,
}

/// All operations. Several may share a name: the first counts whose path's parameters are all given.
pub const OPERATIONS: &[Operation] = &[
    motion::HOME,
    motion::MOVE,
    motion::GRIP,
    motion::RELEASE,
    motion::STOP,
    fast_stop::ONE,
    fast_stop::ALL,
    fast_stop::ACKNOWLEDGE,
    lease::GET,
    lease::TAKE,
    lease::RENEW,
    lease::RELEASE,
    lease::HAND_OVER,
    commands::GET,
    commands::CANCEL,
    grippers::LIST,
    grippers::INFO,
    grippers::STATE,
    settings::GET_ACCELERATION,
    settings::SET_ACCELERATION,
    settings::GET_FORCE_LIMIT,
    settings::SET_FORCE_LIMIT,
    settings::GET_SOFT_LIMITS,
    settings::SET_SOFT_LIMITS,
    settings::CLEAR_SOFT_LIMITS,
    settings::GET_OVERDRIVE,
    settings::SET_OVERDRIVE,
    settings::GET_TAG,
    settings::SET_TAG,
    device::STATISTICS,
    device::RESET_STATISTICS,
    fingers::INFO,
    fingers::DATA,
    fingers::POWER,
    device::TARE,
    device::LOOP,
    raw::RAW,
    fleet::LIST,
    fleet::FAST_STOP,
];

impl Operation {
    /// Declares an operation that only reads.
    pub(super) const fn read(name: &'static str, path: &'static str, run: Run) -> Self {
        let (role, urgency) = (Role::Observer, Urgency::None);
        Self { name, verb: &Verb::GET, path, role, urgency, starts_command: false, run }
    }

    /// Declares an operation that may change something.
    pub(super) const fn change(name: &'static str, verb: &'static Verb, path: &'static str, run: Run) -> Self {
        let (role, urgency) = (Role::Operator, Urgency::None);
        Self { name, verb, path, role, urgency, starts_command: false, run }
    }

    /// Declares an operation that starts a command.
    pub(super) const fn command(name: &'static str, path: &'static str, run: Run) -> Self {
        Self { starts_command: true, ..Self::change(name, &Verb::POST, path, run) }
    }

    pub(super) const fn needs(self, role: Role) -> Self {
        Self { role, ..self }
    }

    pub(super) const fn urgent(self, urgency: Urgency) -> Self {
        Self { urgency, ..self }
    }

    /// Starts the operation.
    pub(super) fn start(&self, call: Call) -> BoxFuture<'static, Result<Reply, Problem>> {
        (self.run)(call)
    }

    /// Whether the operation may change something.
    #[must_use]
    pub fn changes_something(&self) -> bool {
        self.verb != Verb::GET
    }

    /// Whether the operation may wait for a command's end.
    #[must_use]
    pub fn waits(&self) -> bool {
        self.starts_command || self.name == commands::GET.name
    }

    /// Whether the operation is one on a gripper.
    #[must_use]
    pub fn is_of_gripper(&self) -> bool {
        self.path_parameters().any(|key| key == "gripper")
    }

    /// The parameters that the path names, in their order.
    pub fn path_parameters(&self) -> impl Iterator<Item = &'static str> + use<> {
        self.path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'))
    }

    /// The subject of the operation in the journal: the last part of its path that is no parameter.
    #[must_use]
    pub fn subject(&self) -> &'static str {
        subject(self.path)
    }
}

/// The last part of a path's template that is no parameter.
#[must_use]
pub fn subject(template: &str) -> &str {
    template.rsplit('/').find(|part| !part.starts_with('{')).unwrap_or_default()
}

/// Runs an operation's function to its reply.
pub(super) fn reply<R: IntoReply>(
    running: impl Future<Output = Result<R, Problem>> + Send + 'static,
) -> BoxFuture<'static, Result<Reply, Problem>> {
    async move { running.await?.into_reply() }.boxed()
}

/// Returns the reply of an operation that waits for nothing.
pub(super) fn ready<R: IntoReply>(result: Result<R, Problem>) -> BoxFuture<'static, Result<Reply, Problem>> {
    std::future::ready(result.and_then(IntoReply::into_reply)).boxed()
}

/// The operations of a name.
pub fn named(name: &str) -> impl Iterator<Item = &'static Operation> {
    OPERATIONS.iter().filter(move |operation| operation.name == name)
}

/// The operation of a method and a path's template below the API's.
#[must_use]
pub fn find(verb: &Verb, path: &str) -> Option<&'static Operation> {
    OPERATIONS.iter().find(|operation| operation.verb == verb && operation.path == path)
}

/// Whether a name is that of a FAST STOP.
#[must_use]
pub fn is_fast_stop(name: &str) -> bool {
    urgency(name) == Urgency::FastStop
}

/// The urgency of the operations of a name.
#[must_use]
pub fn urgency(name: &str) -> Urgency {
    named(name).next().map_or(Urgency::None, |operation| operation.urgency)
}

/// As much of a client's text as an answer repeats.
pub(super) fn shortened(text: &str) -> String {
    text.chars().take(32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn operations_of_one_name_have_one_urgency() {
        for operation in OPERATIONS {
            assert_eq!(urgency(operation.name), operation.urgency, "{}", operation.name);
        }
    }

    #[test]
    fn subject_is_last_part_that_is_no_parameter() {
        assert_eq!(settings::SET_ACCELERATION.subject(), "acceleration");
        assert_eq!(subject("/grippers/{g}/custom/{id}"), "custom");
        assert_eq!(commands::CANCEL.subject(), "cancel");
    }

    #[test]
    fn whatever_stops_is_urgent() {
        let urgent: Vec<_> =
            OPERATIONS.iter().filter(|operation| operation.urgency != Urgency::None).map(|one| one.name).collect();
        let expected = ["stop", "fast-stop", "fast-stop", "lease.renew", "lease.release", "cancel", "fleet.fast-stop"];
        assert_eq!(urgent, expected);
    }
}
