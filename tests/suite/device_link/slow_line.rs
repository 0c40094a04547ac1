//! A FAST STOP at 9600 baud waits for at most one frame.

use std::ops::RangeInclusive;
use std::sync::Arc;
use std::time::Duration;

use jiff::Timestamp;
use tokio::sync::broadcast;
use wsg_gateway::model::{FastStopId, FrameDirection, FrameRecord, Reason, WireRecord};
use wsg_gateway::wsg::{Command, CustomCommand, id};

use crate::conformance::rig::{Rig, SOON, client};
use crate::harness::on_pty;

const FLOOD: RangeInclusive<u8> = 0xB0..=0xB5;

/// Payload of a script command. Its frame takes 250 ms on the line, so that even a busy machine requests the FAST STOP
/// while one is being sent.
const PAYLOAD_BYTES: usize = 232;
const FRAME_BYTES: usize = PAYLOAD_BYTES + 8;

const BYTES_PER_SECOND: f64 = 960.0;

/// Extra delay on a machine that runs other tests at the same time: less than another frame would take.
const MACHINE: Duration = Duration::from_millis(200);

fn line_time(bytes: usize) -> Duration {
    Duration::from_secs_f64(bytes as f64 / BYTES_PER_SECOND)
}

fn bytes(frame: &FrameRecord) -> usize {
    frame.hex.len() / 2
}

/// Returns the time at which a real line has carried this frame. A pty has no speed of its own, and passes frames on at
/// once.
fn carried(frame: &FrameRecord) -> Timestamp {
    frame.at + line_time(bytes(frame))
}

/// Waits for the next frame that is handed to the line.
async fn handed_over(frames: &mut broadcast::Receiver<Arc<WireRecord>>) -> FrameRecord {
    let sent = async {
        loop {
            match &*frames.recv().await.unwrap() {
                WireRecord::Frame(frame) if frame.direction == FrameDirection::Sent => return frame.clone(),
                _ => {}
            }
        }
    };
    tokio::time::timeout(SOON, sent).await.expect("a frame is handed over")
}

#[tokio::test]
async fn fast_stop_waits_for_one_frame_at_most() {
    on_pty(waits_for_one_frame).await;
}

async fn waits_for_one_frame() {
    let rig = Rig::new("serial://pty?baud=9600").await;
    let mut frames = rig.handle.frames();
    // Each id can have one request in flight, so all of these could be on the line at once.
    let flood: Vec<_> = FLOOD
        .map(|id| {
            let handle = rig.handle.clone();
            let command = Command::Custom(CustomCommand::new(id, vec![id; PAYLOAD_BYTES]).unwrap());
            tokio::spawn(async move { handle.exchange(command, client(), None).await })
        })
        .collect();
    let mut sent = Vec::new();
    // Wait until the second of them is handed to the line.
    while sent.iter().filter(|frame| bytes(frame) == FRAME_BYTES).count() < 2 {
        sent.push(handed_over(&mut frames).await);
    }
    let asked = Timestamp::now();
    rig.handle.fast_stop(FastStopId::generate(), client(), Reason::truncated("now")).await;
    while sent.last().is_none_or(|frame| frame.id != id::FAST_STOP) {
        sent.push(handed_over(&mut frames).await);
    }
    let handed_over_later: Vec<_> = sent.iter().filter(|frame| frame.at > asked && frame.id != id::FAST_STOP).collect();
    assert!(handed_over_later.is_empty(), "between the request and the FAST STOP: {handed_over_later:?}");
    for (frame, next) in sent.iter().zip(&sent[1..]) {
        // The log's times are in whole milliseconds.
        let is_free = next.at + Duration::from_millis(1) >= carried(frame);
        assert!(is_free, "handed over while the line was busy with {frame:?}: {next:?}");
    }
    let (stop, latest) = (sent.last().unwrap(), asked + line_time(FRAME_BYTES) + MACHINE);
    assert!(stop.at <= latest, "requested at {asked}, handed over at {}", stop.at);
    // Earlier output of the device takes its time as well.
    rig.until("stopped", SOON, |state| state.latch.as_ref().is_some_and(|latch| latch.fast_stop_confirmed)).await;
    let is_ours = |id: &u8| FLOOD.contains(id) || *id == id::FAST_STOP;
    let handed_over: Vec<_> = sent.iter().map(|frame| frame.id).filter(is_ours).collect();
    let received: Vec<_> = rig.received().await.into_iter().filter(is_ours).take(handed_over.len()).collect();
    assert_eq!(received, handed_over);
    for answered in flood {
        let _ = answered.await.unwrap();
    }
    rig.drain().await;
}
