//! Answers to clients, sent at the end of each input.

use std::fmt;

use tokio::sync::oneshot;

/// Answers that wait until the new state is published, so that the next read of a client returns no older state.
#[derive(Default)]
pub(super) struct Answers(Vec<Box<dyn FnOnce() + Send + Sync>>);

impl Answers {
    pub(super) fn add<T: Send + Sync + 'static>(&mut self, client: oneshot::Sender<T>, answer: T) {
        self.0.push(Box::new(move || {
            // The client may be gone.
            let _ = client.send(answer);
        }));
    }

    pub(super) fn send(&mut self) {
        for send in self.0.drain(..) {
            send();
        }
    }
}

impl fmt::Debug for Answers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} answers", self.0.len())
    }
}
