use crate::testing::*;
use crate::{Change, DeviceConfig, FaultKind, FaultName, LinkAction};
use wsg::{Command, Data, Reply, Status, id};

/// Sends a Loop with this fault armed. Returns the chunks of its reply, and the bench.
fn on_the_wire(kind: FaultKind) -> (Vec<Vec<u8>>, Bench) {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.arm(kind, id::LOOP);
    let mut request = Vec::new();
    looped(&[1, 2, 3]).encode(&mut request);
    bench.device.receive(bench.now, &request);
    let chunks = bench.chunks();
    for chunk in &chunks {
        bench.decoder.push(chunk);
    }
    (chunks, bench)
}

fn echo(bytes: &[u8]) -> (u8, Reply) {
    (id::LOOP, Reply::Success(Data::Loop(bytes.to_vec())))
}

#[test]
fn corrupt_byte_or_checksum_loses_one_frame() {
    for kind in [FaultKind::CorruptByte, FaultKind::CorruptChecksum] {
        let (chunks, mut bench) = on_the_wire(kind);
        assert_eq!(chunks.len(), 1);
        assert_eq!(bench.frames(), []);
        assert_eq!(bench.decoder.counters().checksum_errors, 1);
        assert_eq!(bench.happened(kind.name()), 1);
        assert_eq!(bench.ask(&looped(&[4])), [echo(&[4])], "once");
    }
}

#[test]
fn corrupt_size_loses_one_frame() {
    let (_, mut bench) = on_the_wire(FaultKind::CorruptSize);
    assert_eq!(bench.frames(), []);
    assert_eq!(bench.decoder.counters().oversized, 1);
    assert_eq!(bench.happened(FaultName::CorruptSize), 1);
}

#[test]
fn garbage_and_preamble_runs_precede_valid_frame() {
    for kind in [FaultKind::Garbage, FaultKind::PreambleRun] {
        let (_, mut bench) = on_the_wire(kind);
        assert_eq!(bench.frames(), [echo(&[1, 2, 3])]);
        assert_eq!(bench.decoder.counters().skipped_bytes, 7);
        assert_eq!(bench.happened(kind.name()), 1);
    }
}

#[test]
fn false_preamble_hides_next_frame() {
    let (_, mut bench) = on_the_wire(FaultKind::FalsePreamble);
    assert_eq!(bench.frames(), []);
    bench.decoder.give_up_partial();
    assert_eq!(bench.frames(), [echo(&[1, 2, 3])]);
    assert_eq!(bench.happened(FaultName::FalsePreamble), 1);
}

#[test]
fn half_frame_is_followed_by_silence() {
    let (chunks, mut bench) = on_the_wire(FaultKind::HalfFrame);
    assert_eq!(chunks.concat().len(), 6);
    assert_eq!(bench.ask(&looped(&[4])), []);
    assert_eq!((bench.happened(FaultName::HalfFrame), bench.happened(FaultName::Silent)), (1, 1));
    bench.apply(Change::Silent { on: false });
    bench.decoder.give_up_partial();
    assert_eq!(bench.ask(&looped(&[5])), [echo(&[5])]);
}

#[test]
fn frame_can_arrive_byte_by_byte() {
    let (chunks, mut bench) = on_the_wire(FaultKind::SplitBytes);
    assert!(chunks.len() == 13 && chunks.iter().all(|chunk| chunk.len() == 1));
    assert_eq!(bench.frames(), [echo(&[1, 2, 3])]);
    assert_eq!(bench.happened(FaultName::SplitBytes), 1);
}

#[test]
fn two_frames_can_arrive_together() {
    let (chunks, mut bench) = on_the_wire(FaultKind::JoinFrames);
    assert!(chunks.is_empty(), "the frame waits for the next one");
    assert!(bench.device.poll_timeout().is_some());
    let mut request = Vec::new();
    looped(&[4]).encode(&mut request);
    bench.device.receive(bench.now, &request);
    assert_eq!(bench.chunks().len(), 1);
    assert_eq!(bench.happened(FaultName::JoinFrames), 1);
}

#[test]
fn frame_without_successor_leaves_alone() {
    let (_, mut bench) = on_the_wire(FaultKind::JoinFrames);
    assert_eq!(bench.pass(ms(50)), [echo(&[1, 2, 3])]);
    assert_eq!(bench.happened(FaultName::JoinFrames), 0, "the fault did not occur");
}

#[test]
fn frame_and_connection_can_be_lost() {
    let (chunks, mut bench) = on_the_wire(FaultKind::DropConnection);
    assert!(chunks.is_empty());
    assert_eq!(bench.device.poll_link(), Some(LinkAction::Drop));
    assert_eq!(bench.device.poll_link(), None);
    assert_eq!(bench.ask(&looped(&[4])), [], "the connection is lost");
    assert_eq!(bench.happened(FaultName::DropConnection), 1);
    bench.device.disconnect(bench.now);
    assert!(bench.snapshot().fast_stop);
}

#[test]
fn request_can_stay_unanswered() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.arm(FaultKind::NoReply, id::SET_ACCELERATION);
    let before = bench.snapshot().acceleration_mm_s2;
    assert_eq!(bench.ask_raw(id::SET_ACCELERATION, &500.0_f32.to_le_bytes()), []);
    assert!(near(bench.snapshot().acceleration_mm_s2, before));
    assert_eq!(bench.happened(FaultName::NoReply), 1);
}

#[test]
fn any_status_can_be_the_reply() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.arm(FaultKind::Status { code: 4711 }, id::PRE_POSITION);
    assert_eq!(bench.ask(&looped(&[1])), [echo(&[1])], "other ids are not affected");
    assert_eq!(bench.reply(&move_to(50.0, 50.0)), status(Status::from_code(4711)));
    assert!(!bench.snapshot().moving);
    assert_eq!(bench.happened(FaultName::Status), 1);
}

#[test]
fn any_status_can_be_the_result() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.arm(FaultKind::FinalStatus { code: 7 }, id::PRE_POSITION);
    assert_eq!(bench.run(&move_to(50.0, 50.0)), [PENDING, status(Status::E_TIMEOUT)]);
    assert!(near(bench.snapshot().width_mm, 50.0));
    assert_eq!(bench.happened(FaultName::FinalStatus), 1);
}

#[test]
fn results_and_pending_can_arrive_in_wrong_order_and_number() {
    let cases = [
        (FaultKind::FinalTwice, vec![PENDING, DONE, DONE]),
        (FaultKind::FinalWithoutPending, vec![DONE]),
        (FaultKind::FinalBeforePending, vec![DONE, PENDING]),
        (FaultKind::PendingWithoutFinal, vec![PENDING]),
    ];
    for (kind, expected) in cases {
        let mut bench = Bench::homed(DeviceConfig::wsg50());
        bench.arm(kind, id::PRE_POSITION);
        assert_eq!(bench.run(&move_to(50.0, 50.0)), expected, "{kind:?}");
        assert_eq!(bench.happened(kind.name()), 1);
        assert_eq!(bench.run(&move_to(60.0, 50.0)), [PENDING, DONE], "{kind:?} strikes once");
    }
}

#[test]
fn result_can_be_late() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.arm(FaultKind::FinalLate { by_ms: 700 }, id::PRE_POSITION);
    bench.ask(&move_to(100.0, 50.0));
    while bench.snapshot().moving {
        assert_eq!(bench.pass(ms(1)), []);
    }
    assert_eq!(bench.pass(ms(699)), []);
    assert_eq!(bench.pass(ms(1)), [(id::PRE_POSITION, DONE)]);
    assert_eq!(bench.happened(FaultName::FinalLate), 1);
}

#[test]
fn accepted_request_can_be_followed_by_silence() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.arm(FaultKind::SilenceAfterAccept, id::PRE_POSITION);
    assert_eq!(bench.run(&move_to(50.0, 50.0)), [PENDING]);
    assert_eq!(bench.ask(&looped(&[1])), []);
    assert!(near(bench.snapshot().width_mm, 50.0), "the device keeps acting");
    assert_eq!(bench.happened(FaultName::SilenceAfterAccept), 1);
}

#[test]
fn fault_strikes_as_often_as_armed_unless_disarmed() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::Fault { kind: FaultKind::Status { code: 16 }, id: None, times: 2 });
    assert_eq!(bench.reply(&Command::GetSystemInfo), status(Status::E_ACCESS_DENIED));
    assert_eq!(bench.reply(&looped(&[1])), status(Status::E_ACCESS_DENIED));
    assert_eq!(bench.ask(&looped(&[1])), [echo(&[1])]);
    bench.arm(FaultKind::NoReply, id::LOOP);
    bench.apply(Change::DisarmFaults);
    assert_eq!(bench.ask(&looped(&[1])), [echo(&[1])]);
}

#[test]
fn armed_faults_are_bounded() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    for _ in 0..2 * super::MAX_ARMED_FAULTS {
        bench.arm(FaultKind::NoReply, id::LOOP);
    }
    for _ in 0..2 * super::MAX_ARMED_FAULTS {
        bench.ask(&looped(&[1]));
    }
    assert_eq!(bench.happened(FaultName::NoReply), super::MAX_ARMED_FAULTS as u64);
}
