//! Moving a connection to another runtime.

use std::sync::Arc;

use tokio::runtime::Handle;
use tokio::sync::watch;

/// Moves a connection to another runtime. Handlers find it in a request's extensions.
#[derive(Debug, Clone)]
pub struct RuntimeMover(Arc<watch::Sender<Handle>>);

impl RuntimeMover {
    /// Returns the mover of a connection that watches this channel.
    pub fn new(moves: watch::Sender<Handle>) -> Self {
        Self(Arc::new(moves))
    }

    /// Moves the connection to a runtime, unwritten bytes included.
    pub fn move_to(&self, runtime: &Handle) {
        self.move_if(runtime, |current| current.id() != runtime.id());
    }

    /// Moves the connection from `from` to `to`, if it is on `from`.
    pub fn leave(&self, from: &Handle, to: &Handle) {
        self.move_if(to, |current| current.id() == from.id() && current.id() != to.id());
    }

    fn move_if(&self, runtime: &Handle, moves: impl FnOnce(&Handle) -> bool) {
        self.0.send_if_modified(|current| {
            let moves = moves(current);
            if moves {
                *current = runtime.clone();
            }
            moves
        });
    }
}
