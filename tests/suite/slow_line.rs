//! A FAST STOP at 9600 baud waits for at most one frame, computed from the bytes handed to the line before it, minus
//! those already carried.

use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::broadcast;
use wsg_gateway::gripper::model::{FastStopId, FrameDirection, FrameRecord, Reason, WireRecord};
use wsg_gateway::wsg::{Command, CustomCommand, id};

use crate::conformance::rig::{Rig, SOON, client};

/// Frames of this test: a script command. The line carries one in a quarter of a second, so that a busy machine has
/// time to request the FAST STOP meanwhile.
const PAYLOAD_BYTES: usize = 232;
const FRAME_BYTES: usize = PAYLOAD_BYTES + 8;

const BYTES_PER_SECOND: f64 = 960.0;

/// Extra delay on a machine that runs other tests at the same time.
const MACHINE: Duration = Duration::from_millis(60);

fn line_time(bytes: usize) -> Duration {
    Duration::from_secs_f64(bytes as f64 / BYTES_PER_SECOND)
}

/// Waits for the next frame that is handed to the line.
async fn handed_over(frames: &mut broadcast::Receiver<Arc<WireRecord>>) -> FrameRecord {
    loop {
        match &*frames.recv().await.unwrap() {
            WireRecord::Frame(frame) if frame.direction == FrameDirection::Sent => return frame.clone(),
            _ => {}
        }
    }
}

/// Returns the time at which a real line would have carried these frames. A pty has no speed of its own, and passes
/// frames on at once.
fn carried(frames: &[FrameRecord]) -> Option<Timestamp> {
    frames.iter().fold(None, |free: Option<Timestamp>, frame| {
        let begins = free.map_or(frame.at, |free| free.max(frame.at));
        Some(begins + line_time(frame.hex.len() / 2))
    })
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn fast_stop_waits_for_one_frame_at_most() {
    let rig = Rig::new("serial://pty?baud=9600").await;
    let mut frames = rig.handle.frames();
    // Each id can have one request in flight, so all of these could be on the line at once.
    let flood: Vec<_> = (0xB0..=0xB5)
        .map(|id| {
            let handle = rig.handle.clone();
            let command = Command::Custom(CustomCommand::new(id, vec![id; PAYLOAD_BYTES]).unwrap());
            tokio::spawn(async move { handle.exchange(command, client(), None).await })
        })
        .collect();
    let mut before = Vec::new();
    // The second of them is on the line.
    while before.iter().filter(|frame: &&FrameRecord| frame.hex.len() / 2 == FRAME_BYTES).count() < 2 {
        before.push(handed_over(&mut frames).await);
    }
    let asked = Timestamp::now();
    rig.handle.fast_stop(FastStopId::generate(), client(), Reason::truncated("now")).await;
    let stop = loop {
        let frame = handed_over(&mut frames).await;
        if frame.id == id::FAST_STOP {
            break frame;
        }
        before.push(frame);
    };
    let handed_over_later: Vec<_> = before.iter().filter(|frame| frame.at > asked).collect();
    assert!(handed_over_later.is_empty(), "between the request and the FAST STOP: {handed_over_later:?}");
    let starts = carried(&before).map_or(stop.at, |free| free.max(stop.at));
    let waited = starts.duration_since(asked).unsigned_abs();
    assert!(waited <= line_time(FRAME_BYTES) + MACHINE, "the FAST STOP waited for {waited:?} of line time");
    // Earlier output of the device takes its time as well.
    rig.until("stopped", SOON, |state| state.latch.as_ref().is_some_and(|latch| latch.fast_stop_confirmed)).await;
    for answered in flood {
        let _ = answered.await.unwrap();
    }
    rig.drain().await;
}
