//! The writing half of a client's socket: answers first, then updates. While the client does not read, updates stay
//! where they are: newer states and telemetry replace older ones there, and events and frames fall behind and become a
//! gap.

use std::io::IoSlice;
use std::sync::Arc;

use bytes::Bytes;
use futures_util::FutureExt as _;
use tokio::io::AsyncWriteExt as _;
use tokio::net::TcpStream;

use super::bodies::Following;
use super::outbox::{Item, Outbox};
use crate::events::{Notification, Pace, Subscription};
use crate::interfaces::metrics::Metrics;

/// Frames that are gathered for one write.
const MAX_GATHERED: usize = 64;

/// The writer of one client.
pub struct Writer {
    half: TcpStream,
    outbox: Arc<Outbox>,
    following: Option<(Subscription, Pace)>,
    metrics: Metrics,
}

impl Writer {
    pub fn new(half: TcpStream, outbox: Arc<Outbox>, metrics: Metrics) -> Self {
        Self { half, outbox, following: None, metrics }
    }

    /// Writes until the outbox is closed and empty, or the client takes no more.
    pub async fn run(mut self) -> std::io::Result<()> {
        loop {
            let frames = tokio::select! {
                biased;
                item = self.outbox.next() => match item {
                    None => return Ok(()),
                    Some(Item::Follow(Following { updates, max_hz })) => {
                        self.following = Some((updates, Pace::new(max_hz as u32)));
                        continue;
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
            // A kernel lets a thread run on for some milliseconds although others that matter more have woken: among a
            // thousand observers it is asked after each of them.
            std::thread::yield_now();
        }
    }
}

async fn write(half: &mut TcpStream, frames: &[Bytes]) -> std::io::Result<()> {
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

/// The next updates: the newest states and telemetry when their time has come, or events and frames, with what else of
/// them is there already; and how many were dropped for newer ones. Cancelled without loss.
async fn updates(following: &mut Option<(Subscription, Pace)>) -> (Vec<Notification>, u64) {
    let Some((updates, pace)) = following else { return std::future::pending().await };
    let has_states = updates.has_states();
    let mut gathered = tokio::select! {
        biased;
        missed = pace.next(), if has_states => return updates.newest(missed),
        Some(update) = updates.next() => vec![update],
        else => return std::future::pending().await,
    };
    while gathered.len() < MAX_GATHERED
        && let Some(Some(next)) = updates.next().now_or_never()
    {
        gathered.push(next);
    }
    (gathered, 0)
}
