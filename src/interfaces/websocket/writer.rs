//! The writing half of a client's socket: responses first, then updates. Updates stay in the subscription while the
//! client does not read: newer states and telemetry replace older ones, and missed events and frames become a gap.

use std::io::IoSlice;
use std::sync::Arc;

use bytes::Bytes;
use futures_util::FutureExt as _;
use tokio::io::AsyncWriteExt as _;

use super::bodies::Following;
use super::outbox::{Item, Outbox};
use super::split_connection::WritingHalf;
use crate::connections::metrics::InterfaceMetrics;
use crate::events::{Notification, Pace, Subscription};

/// Maximum number of frames in one write.
const MAX_GATHERED: usize = 64;

pub struct Writer {
    half: WritingHalf,
    outbox: Arc<Outbox>,
    following: Option<(Subscription, Pace)>,
    metrics: InterfaceMetrics,
}

impl Writer {
    pub fn new(half: WritingHalf, outbox: Arc<Outbox>, metrics: InterfaceMetrics) -> Self {
        Self { half, outbox, following: None, metrics }
    }

    /// Writes until the outbox is closed and empty, or writing fails.
    pub async fn run(mut self) -> std::io::Result<()> {
        loop {
            let frames = tokio::select! {
                biased;
                item = self.outbox.next() => match item {
                    None => return Ok(()),
                    Some(Item::Follow(Following { updates, max_hz })) => {
                        let rest = self.following.as_mut().map(|(replaced, _)| replaced.rest(&updates));
                        self.following = Some((updates, Pace::new(max_hz as u32)));
                        rest.unwrap_or_default()
                    }
                    Some(Item::Frames(frames)) => {
                        let more = std::iter::from_fn(|| self.outbox.next_frames());
                        let frames: Vec<_> = std::iter::once(frames).chain(more.take(MAX_GATHERED - 1)).collect();
                        write(&mut self.half, &frames).await?;
                        for frames in &frames {
                            self.outbox.written(frames);
                        }
                        continue;
                    }
                },
                (updates, dropped) = updates(&mut self.following) => {
                    self.metrics.dropped(dropped);
                    updates
                }
            };
            let frames: Vec<_> = frames.iter().map(Notification::frame).collect();
            write(&mut self.half, &frames).await?;
            // The kernel can let this thread run on for some milliseconds although more important ones have woken, so
            // this thread yields after each of a thousand observers.
            std::thread::yield_now();
        }
    }
}

async fn write(half: &mut WritingHalf, frames: &[Bytes]) -> std::io::Result<()> {
    let mut slices: Vec<_> = frames.iter().map(|frame| IoSlice::new(frame)).collect();
    let mut rest = slices.as_mut_slice();
    while !rest.is_empty() {
        let bytes = half.write_vectored(rest).await?;
        if bytes == 0 {
            return Err(std::io::ErrorKind::WriteZero.into());
        }
        IoSlice::advance_slices(&mut rest, bytes);
    }
    Ok(())
}

/// Returns the next updates: the newest states and telemetry when they are due, or all events and frames that are
/// ready. Also returns the number of updates that newer ones replaced. Cancellation-safe.
async fn updates(following: &mut Option<(Subscription, Pace)>) -> (Vec<Notification>, u64) {
    let Some((updates, pace)) = following else { return std::future::pending().await };
    let has_states = updates.has_states();
    let mut gathered = tokio::select! {
        biased;
        missed = pace.next(), if has_states => return updates.newest(missed),
        update = updates.next() => vec![update],
    };
    while gathered.len() < MAX_GATHERED
        && let Some(next) = updates.next().now_or_never()
    {
        gathered.push(next);
    }
    (gathered, 0)
}
