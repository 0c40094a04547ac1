//! A FAST STOP on a line of 9600 baud waits for one frame at most: counted on the bytes that the device received.

use std::time::{Duration, Instant};

use wsg_gateway::gripper::model::{FastStopId, Reason};
use wsg_gateway::wsg::{Command, LoopData, id};

use crate::conformance::rig::{Rig, SOON, client};

/// The longest frame that is sent here: a Loop of 60 bytes.
const LONGEST_BYTES: u32 = 68;

const BYTES_PER_SECOND: u32 = 960;

/// What the machine may add, with tests beside this one.
const MACHINE: Duration = Duration::from_millis(60);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_fast_stop_waits_for_one_frame_at_most() {
    let rig = Rig::new("serial://pty?baud=9600").await;
    let flood: Vec<_> = (0..12)
        .map(|n| {
            let handle = rig.handle.clone();
            let command =
                if n % 2 == 0 { Command::Loop(LoopData::new(vec![n; 60]).unwrap()) } else { Command::GetAcceleration };
            tokio::spawn(async move { handle.exchange(command, client()).await })
        })
        .collect();
    // While the first of them is on the line.
    tokio::time::sleep(Duration::from_millis(20)).await;
    let asked = Instant::now();
    rig.handle.fast_stop(FastStopId::generate(), client(), Reason::truncated("now")).await;
    // What the device has to say first takes its time as well.
    rig.until("stopped", SOON, |state| state.latch.as_ref().is_some_and(|latch| latch.fast_stop_confirmed)).await;
    let received = rig.switch.received().await.unwrap();
    let stop = received.iter().find(|frame| frame.id == id::FAST_STOP).unwrap();
    // A pty has no speed of its own: the frame that was being written is with the device already, and the line is
    // reckoned to be busy with it.
    let between: usize = received
        .iter()
        .filter(|frame| frame.at > asked && frame.at < stop.at)
        .map(|frame| frame.payload.len() + 8)
        .sum();
    assert!(between <= LONGEST_BYTES as usize, "{between} bytes went before it");
    let line_time = Duration::from_secs(1) * LONGEST_BYTES / BYTES_PER_SECOND;
    assert!(stop.at - asked < line_time + MACHINE, "it came after {:?}", stop.at - asked);
    for answered in flood {
        let _ = answered.await.unwrap();
    }
    rig.drain().await;
}
