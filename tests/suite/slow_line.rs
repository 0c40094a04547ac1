//! A FAST STOP at 9600 baud waits for at most one frame, computed from the bytes handed to the line before it, minus
//! those already carried.

use std::time::{Duration, Instant};

use wsg_gateway::gripper::model::{FastStopId, Reason};
use wsg_gateway::sim::ReceivedFrame;
use wsg_gateway::wsg::{Command, CustomCommand, id};

use crate::conformance::rig::{Rig, SOON, client};

/// Frames of this test: a script command with a payload of 60 bytes.
const PAYLOAD_BYTES: usize = 60;
const FRAME_BYTES: usize = PAYLOAD_BYTES + 8;

const BYTES_PER_SECOND: f64 = 960.0;

/// Extra delay on a machine that runs other tests at the same time.
const MACHINE: Duration = Duration::from_millis(60);

fn line_time(bytes: usize) -> Duration {
    Duration::from_secs_f64(bytes as f64 / BYTES_PER_SECOND)
}

/// Returns the time at which a real line would have carried these frames. A pty has no speed of its own, and passes
/// frames on at once.
fn carried(frames: &[ReceivedFrame]) -> Option<Instant> {
    frames.iter().fold(None, |free: Option<Instant>, frame| {
        let begins = free.map_or(frame.at, |free| free.max(frame.at));
        Some(begins + line_time(frame.payload.len() + 8))
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fast_stop_waits_for_one_frame_at_most() {
    let rig = Rig::new("serial://pty?baud=9600").await;
    // Each id can have one request in flight, so all of these could be on the line at once.
    let flood: Vec<_> = (0xB0..=0xB7)
        .map(|id| {
            let handle = rig.handle.clone();
            let command = Command::Custom(CustomCommand::new(id, vec![id; PAYLOAD_BYTES]).unwrap());
            tokio::spawn(async move { handle.exchange(command, client(), None).await })
        })
        .collect();
    // Wait until one of them is on the line.
    tokio::time::sleep(line_time(FRAME_BYTES) * 2).await;
    let asked = Instant::now();
    rig.handle.fast_stop(FastStopId::generate(), client(), Reason::truncated("now")).await;
    // Earlier output of the device takes its time as well.
    rig.until("stopped", SOON, |state| state.latch.as_ref().is_some_and(|latch| latch.fast_stop_confirmed)).await;

    let received = rig.switch.received().await.unwrap();
    let stop = received.iter().position(|frame| frame.id == id::FAST_STOP).unwrap();
    let (before, stop) = (&received[..stop], &received[stop]);
    let handed_over_later: usize =
        before.iter().filter(|frame| frame.at > asked).map(|frame| frame.payload.len() + 8).sum();
    assert_eq!(handed_over_later, 0, "bytes were handed over between the request and the FAST STOP");
    let starts = carried(before).map_or(stop.at, |free| free.max(stop.at));
    let waited = starts.saturating_duration_since(asked);
    assert!(waited <= line_time(FRAME_BYTES) + MACHINE, "the FAST STOP waited for {waited:?} of line time");
    for answered in flood {
        let _ = answered.await.unwrap();
    }
    rig.drain().await;
}
