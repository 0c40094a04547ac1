//! The last replies to a client: at shutdown, and after the client has closed its sending side or its connection.

use std::time::Duration;

use futures_util::stream::StreamExt as _;
use tokio::io::{AsyncRead, AsyncWrite, AsyncWriteExt};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;

use super::super::order::PortOrder;
use super::Served;
use crate::model::Action;

/// Time for the replies to a client that sends no more: longer than a motion that `on_loss_moving` lets finish.
const REPLIES_AFTER_END_WITHIN: Duration = Duration::from_secs(30);

impl<R: AsyncRead + Unpin, W: AsyncWrite + Unpin> Served<R, W> {
    pub(super) async fn finish(&mut self) {
        while let Some(step) = self.under_way.next().await {
            self.take(step);
            self.start_orders();
        }
        let unfinished = self.outgoing.get(self.written..).unwrap_or_default().to_vec();
        let rest = std::iter::from_fn(|| self.device.poll_frame());
        for frame in std::iter::once(unfinished).chain(rest) {
            if self.writer.write_all(&frame).await.is_err() {
                return;
            }
        }
    }

    pub(super) async fn finish_fast_stops(&mut self) {
        while self.device.is_stopping()
            && let Some(step) = self.under_way.next().await
        {
            self.take(step);
            self.start_orders();
        }
    }

    /// Answers what the client has sent before it closed its sending side, until all is answered or the client reads no
    /// more. Sends no automatic updates.
    pub(super) async fn send_last_replies(&mut self, closing: &CancellationToken) {
        let _ = timeout(REPLIES_AFTER_END_WITHIN, self.answer_all(closing)).await;
        self.device.forget_waiting();
    }

    async fn answer_all(&mut self, closing: &CancellationToken) {
        loop {
            self.start_orders();
            if self.device.has_overflown() || self.is_owed_nothing() {
                return;
            }
            if self.written == self.outgoing.len() {
                self.written = 0;
                self.outgoing = self.device.poll_frame().unwrap_or_default();
            }
            let is_writing = !self.outgoing.is_empty();
            tokio::select! {
                biased;
                () = closing.cancelled() => return,
                () = self.permit.evicted() => return,
                written = self.writer.write(self.outgoing.get(self.written..).unwrap_or_default()), if is_writing => {
                    match written {
                        Ok(bytes) if bytes > 0 => self.written += bytes,
                        _ => return,
                    }
                }
                Some(step) = self.under_way.next() => self.take(step),
            }
        }
    }

    /// Whether an order of a client that has ended is not carried out. Such a client must not acknowledge the FAST STOP
    /// that its own end has caused.
    pub(super) fn is_too_late(&self, order: &PortOrder) -> bool {
        let needs_client = match order {
            PortOrder::Command(Action::Stop) | PortOrder::FastStop | PortOrder::Release | PortOrder::Exchange(_) => {
                false
            }
            PortOrder::Command(_) | PortOrder::Acknowledge(_) | PortOrder::AcknowledgeFault => true,
        };
        self.end.is_some() && needs_client
    }
}
