//! An operation: all that the interfaces need to know about it, declared once.

use http::Method as Verb;
use utoipa::openapi::{RefOr, Schema};

use super::call::Call;
use super::contract::Contract;
use super::handler::Performing;
use crate::access::Right;
use crate::model::Urgency;

/// An operation, as `operations!` declares it.
#[derive(Debug, Clone, Copy)]
#[allow(clippy::struct_excessive_bools, reason = "independent properties")]
pub struct Operation {
    /// Name: the WebSocket method, and the last part of the Zenoh command key.
    pub name: &'static str,
    /// HTTP method.
    pub verb: &'static Verb,
    /// HTTP path, relative to the API's root. The other interfaces take the path's variables as parameters.
    pub path: &'static str,
    /// Summary, and after an empty line the description, as a doc comment has them.
    pub doc: &'static str,
    /// `operationId` in the OpenAPI document.
    pub id: &'static str,
    /// Tag in the OpenAPI document.
    pub tag: &'static str,
    /// Description of the successful answer.
    pub answer: &'static str,
    /// Description of the answer if the operation created something.
    pub creates: Option<&'static str>,
    /// HTTP statuses of the problems that it can have.
    pub problems: &'static [u16],
    /// Parameters and answers.
    pub contract: Contract,
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
    /// Whether the HTTP response leaves out headers that only browsers need.
    pub is_compact: bool,
    /// Whether an HTTP request needs a body, although each of its fields can be absent.
    pub needs_body: bool,
    /// Whether an HTTP request can name the version that it expects (RFC 9110 13.1).
    pub is_conditional: bool,
    /// The function, which starts when it is called.
    pub(in crate::operations) start: fn(Call) -> Performing,
}

/// Declares a module's operations: each as a constant, and all as `OPERATIONS`. Loop in `gripper/device.rs` is an
/// example.
///
/// The doc comment is the summary and the description in the API's documents. `run` is a [`Handler`]; its types are the
/// parameters and the answer. `problems` is one of `problem_sets.rs`. A GET needs [`Right::Read`], any other operation
/// [`Right::Operate`], unless `.needs(right)` says otherwise; the further methods of [`Operation`] set other properties.
///
/// [`Handler`]: super::handler::Handler
macro_rules! operations {
    ($(
        $(#[doc = $doc:literal])+
        $constant:ident = $verb:ident $path:literal as $name:literal {
            run: $run:expr, id: $id:literal, tag: $tag:literal, problems: $problems:ident,
            answer: $answer:literal $(,)?
        }$(.$property:ident($($value:expr),*))*;
    )+) => {
        $(
            $(#[doc = $doc])+
            pub const $constant: $crate::operations::Operation = $crate::operations::calls::operation::Operation {
                doc: concat!($($doc, "\n"),+),
                id: $id,
                tag: $tag,
                answer: $answer,
                problems: $crate::operations::calls::problem_sets::$problems,
                ..$crate::operations::calls::operation::Operation::declared(
                    &http::Method::$verb,
                    $path,
                    $name,
                    $crate::operations::calls::handler::contract(&$run),
                    |call| $crate::operations::calls::handler::Handler::start($run, call.with_fields()),
                )
            }$(.$property($($value),*))*;
        )+

        /// The operations of this module.
        pub(in crate::operations) const OPERATIONS: &[$crate::operations::Operation] = &[$($constant),+];
    };
}
pub(in crate::operations) use operations;

impl Operation {
    /// Returns an operation without its texts. Only `operations!` uses it.
    pub(in crate::operations) const fn declared(
        verb: &'static Verb,
        path: &'static str,
        name: &'static str,
        contract: Contract,
        start: fn(Call) -> Performing,
    ) -> Self {
        let right = if matches!(*verb, Verb::GET) { Right::Read } else { Right::Operate };
        Self {
            name,
            verb,
            path,
            doc: "",
            id: "",
            tag: "",
            answer: "",
            creates: None,
            problems: &[],
            contract,
            right,
            urgency: Urgency::None,
            ignores_mistakes: false,
            starts_command: false,
            waits: false,
            is_compact: false,
            needs_body: false,
            is_conditional: false,
            start,
        }
    }

    /// Sets the right that the caller needs.
    pub(in crate::operations) const fn needs(self, right: Right) -> Self {
        Self { right, ..self }
    }

    /// Starts a command, and can wait for its end.
    pub(in crate::operations) const fn command(self) -> Self {
        Self { starts_command: true, waits: true, ..self }
    }

    /// Can wait for the end of a command that another request has started.
    pub(in crate::operations) const fn waiting(self) -> Self {
        Self { waits: true, ..self }
    }

    /// Answers 201 with this description if it created something.
    pub(in crate::operations) const fn creating(self, description: &'static str) -> Self {
        Self { creates: Some(description), ..self }
    }

    /// Leaves out headers that only browsers need.
    pub(in crate::operations) const fn compact(self) -> Self {
        Self { is_compact: true, ..self }
    }

    /// Needs one or another of its fields.
    pub(in crate::operations) const fn with_some_field(self) -> Self {
        Self { needs_body: true, ..self }
    }

    /// Takes the version that an HTTP request expects.
    pub(in crate::operations) const fn conditional(self) -> Self {
        Self { is_conditional: true, ..self }
    }

    pub(in crate::operations) const fn urgent(self, urgency: Urgency) -> Self {
        Self { urgency, ..self }
    }

    /// Executes requests in spite of their mistakes.
    pub(in crate::operations) const fn despite_mistakes(self) -> Self {
        Self { ignores_mistakes: true, ..self }
    }

    /// Summary: the first line of the doc comment.
    #[must_use]
    pub fn summary(&self) -> &'static str {
        self.doc.lines().next().unwrap_or_default().trim()
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

    /// Names of the parameters besides those in the path.
    #[must_use]
    pub fn field_names(&self) -> Vec<String> {
        match (self.contract.fields)(&mut Vec::new()).1 {
            RefOr::T(Schema::Object(object)) => object.properties.into_keys().collect(),
            _ => Vec::new(),
        }
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
