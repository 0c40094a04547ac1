//! An operation: its name, path, right, urgency and function.

use futures_util::future::{BoxFuture, FutureExt as _};
use http::Method as Verb;

use super::call::Call;
use super::problem::Problem;
use super::reply::{IntoReply, OperationReply};
use crate::access::Right;
use crate::gripper::model::Urgency;

#[derive(Debug, Clone, Copy)]
#[allow(clippy::struct_excessive_bools, reason = "independent properties")]
pub struct Operation {
    /// Name: the WebSocket method, and the last part of the Zenoh command key.
    pub name: &'static str,
    /// HTTP method.
    pub verb: &'static Verb,
    /// HTTP path, relative to the API's root. The other interfaces take the path's variables as parameters.
    pub path: &'static str,
    /// Right that the caller needs.
    pub right: Right,
    /// Precedence over other requests.
    pub urgency: Urgency,
    /// Whether a request is executed whatever it contains, because a mistake must not keep the fingers moving.
    pub ignores_mistakes: bool,
    /// Whether the operation starts a command, whose end is reported later.
    pub starts_command: bool,
    /// Whether the operation can wait for a command's end.
    pub waits: bool,
    /// Fields that an HTTP request has in its query string.
    pub query: &'static [&'static str],
    /// Whether the HTTP response leaves out headers that only browsers need.
    pub is_compact: bool,
    /// Whether an HTTP request can name the version that it expects (RFC 9110 13.1).
    pub is_conditional: bool,
    run: Run,
}

type Run = fn(Call) -> BoxFuture<'static, Result<OperationReply, Problem>>;

impl Operation {
    /// Declares an operation that only reads.
    pub(super) const fn read(name: &'static str, path: &'static str, run: Run) -> Self {
        Self { right: Right::Read, ..Self::change(name, &Verb::GET, path, run) }
    }

    /// Declares an operation that can change something.
    pub(super) const fn change(name: &'static str, verb: &'static Verb, path: &'static str, run: Run) -> Self {
        Self {
            name,
            verb,
            path,
            right: Right::Operate,
            urgency: Urgency::None,
            ignores_mistakes: false,
            starts_command: false,
            waits: false,
            query: &[],
            is_compact: false,
            is_conditional: false,
            run,
        }
    }

    /// Declares an operation that starts a command.
    pub(super) const fn command(name: &'static str, path: &'static str, run: Run) -> Self {
        Self { starts_command: true, waits: true, ..Self::change(name, &Verb::POST, path, run) }
    }

    pub(super) const fn needs(self, right: Right) -> Self {
        Self { right, ..self }
    }

    pub(super) const fn waiting(self) -> Self {
        Self { waits: true, ..self }
    }

    /// Takes these parameters from the query over HTTP.
    pub(super) const fn queried(self, query: &'static [&'static str]) -> Self {
        Self { query, ..self }
    }

    /// Leaves out headers that only browsers need.
    pub(super) const fn compact(self) -> Self {
        Self { is_compact: true, ..self }
    }

    /// Takes the version that an HTTP request expects.
    pub(super) const fn conditional(self) -> Self {
        Self { is_conditional: true, ..self }
    }

    pub(super) const fn urgent(self, urgency: Urgency) -> Self {
        Self { urgency, ..self }
    }

    /// Executes requests in spite of their mistakes.
    pub(super) const fn despite_mistakes(self) -> Self {
        Self { ignores_mistakes: true, ..self }
    }

    pub(super) fn start(&self, call: Call) -> BoxFuture<'static, Result<OperationReply, Problem>> {
        (self.run)(call)
    }

    /// Whether the operation can change something.
    #[must_use]
    pub fn changes_something(&self) -> bool {
        self.verb != Verb::GET
    }

    /// Whether the operation acts on one gripper.
    #[must_use]
    pub fn is_of_gripper(&self) -> bool {
        self.path_parameters().any(|key| key == "gripper")
    }

    /// Names of the path's parameters, in order.
    pub fn path_parameters(&self) -> impl Iterator<Item = &'static str> + use<> {
        self.path.split('/').filter_map(|part| part.strip_prefix('{')?.strip_suffix('}'))
    }

    /// The operation's `command` in the journal: the last fixed part of its path.
    #[must_use]
    pub fn journal_command(&self) -> &'static str {
        journal_command(self.path)
    }
}

/// The last fixed part of a path's template.
#[must_use]
pub fn journal_command(template: &str) -> &str {
    template.rsplit('/').find(|part| !part.starts_with('{')).unwrap_or_default()
}

/// Runs an operation's function to its reply.
pub(super) fn reply<R: IntoReply>(
    running: impl Future<Output = Result<R, Problem>> + Send + 'static,
) -> BoxFuture<'static, Result<OperationReply, Problem>> {
    async move { running.await?.into_reply() }.boxed()
}

/// Returns the reply of an operation that waits for nothing.
pub(super) fn ready<R: IntoReply>(result: Result<R, Problem>) -> BoxFuture<'static, Result<OperationReply, Problem>> {
    std::future::ready(result.and_then(IntoReply::into_reply)).boxed()
}
