//! The functions of operations, and what their types say about an operation: its parameters and its answers.

use futures_util::future::{BoxFuture, FutureExt as _, ready};
use utoipa::ToSchema;

use super::call::Call;
use super::contract::{Contract, described};
use super::reply::{IntoReply, OperationReply};
use crate::operations::problem::Problem;

/// An operation that is being performed.
pub type Performing = BoxFuture<'static, Result<OperationReply, Problem>>;

/// A function that performs an operation for a [`Call`]: either `async fn(Call<P>)`, or `fn(&Call<P>)` if it awaits nothing.
///
/// `K` only tells these kinds apart, so that they can have an implementation each.
#[diagnostic::on_unimplemented(
    message = "`{Self}` cannot perform an operation",
    note = "use `async fn(Call<P>) -> Result<R, Problem>` with a future that is `Send`, or `fn(&Call<P>) -> Result<R, Problem>`",
    note = "`P` is `Deserialize` and `ToSchema`; `R` is `Json`, `SharedJson`, `Versioned`, `OrRunning` or `OrWaiting`"
)]
pub trait Handler<P, K>: Copy + 'static {
    type Reply: IntoReply;

    fn start(self, call: Call<P>) -> Performing;
}

/// Kind of a function that awaits something.
#[derive(Debug)]
pub struct Awaits;

/// Kind of a function that awaits nothing.
#[derive(Debug)]
pub struct Immediate;

impl<P, R, F, Fut> Handler<P, Awaits> for F
where
    R: IntoReply,
    F: Fn(Call<P>) -> Fut + Copy + 'static,
    Fut: Future<Output = Result<R, Problem>> + Send + 'static,
{
    type Reply = R;

    fn start(self, call: Call<P>) -> Performing {
        let running = self(call);
        async move { running.await?.into_reply() }.boxed()
    }
}

impl<P, R, F> Handler<P, Immediate> for F
where
    R: IntoReply,
    F: Fn(&Call<P>) -> Result<R, Problem> + Copy + 'static,
{
    type Reply = R;

    fn start(self, call: Call<P>) -> Performing {
        ready(self(&call).and_then(IntoReply::into_reply)).boxed()
    }
}

/// Returns what the types of a function say.
pub const fn contract<P: ToSchema, K, H: Handler<P, K>>(_: &H) -> Contract {
    Contract { fields: described::<P>, answers: H::Reply::answers }
}
