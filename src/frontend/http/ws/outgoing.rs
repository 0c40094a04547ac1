//! What is on its way to the client. Reading goes on while it takes nothing.

use std::collections::VecDeque;
use std::future::poll_fn;
use std::pin::Pin;

use axum::Error;
use axum::extract::ws::{Message, WebSocket};
use futures_util::Sink;
use futures_util::stream::SplitSink;

/// The writing half.
#[derive(Debug)]
pub struct Outgoing {
    sink: SplitSink<WebSocket, Message>,
    queue: VecDeque<Message>,
    is_flushed: bool,
}

impl Outgoing {
    pub fn new(sink: SplitSink<WebSocket, Message>) -> Self {
        Self { sink, queue: VecDeque::new(), is_flushed: true }
    }

    /// Whether all was written: who has news for a client without need of them waits until then.
    pub fn is_idle(&self) -> bool {
        self.queue.is_empty() && self.is_flushed
    }

    /// How many messages wait.
    pub fn waiting(&self) -> usize {
        self.queue.len()
    }

    pub fn push(&mut self, message: Message) {
        self.queue.push_back(message);
    }

    pub fn push_all(&mut self, messages: impl IntoIterator<Item = Message>) {
        self.queue.extend(messages);
    }

    /// Writes all that waits. Cancelled without loss.
    pub async fn write(&mut self) -> Result<(), Error> {
        while !self.queue.is_empty() {
            poll_fn(|context| Pin::new(&mut self.sink).poll_ready(context)).await?;
            let Some(message) = self.queue.pop_front() else { break };
            self.is_flushed = false;
            Pin::new(&mut self.sink).start_send(message)?;
        }
        poll_fn(|context| Pin::new(&mut self.sink).poll_flush(context)).await?;
        self.is_flushed = true;
        // A kernel lets a thread run on for some milliseconds although others that matter more have woken: among a
        // thousand observers it is asked after each of them.
        std::thread::yield_now();
        Ok(())
    }
}
