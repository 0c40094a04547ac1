use crate::testing::*;
use crate::{BadChecksum, Change, DeviceConfig, FaultName, Interface, MAX_QUEUED_REPLIES, MAX_RECEIVED_FRAMES};
use wsg::{ChecksumEvaluation, Command, Data, Reply, Status, SystemState, id};

fn reconnect(bench: &mut Bench) {
    bench.device.disconnect(bench.now);
    assert!(bench.device.connect(bench.now, Interface::Tcp));
}

fn bytes(command: &Command) -> Vec<u8> {
    let mut bytes = Vec::new();
    command.encode(&mut bytes);
    bytes
}

fn damaged(command: &Command) -> Vec<u8> {
    let mut bytes = bytes(command);
    *bytes.last_mut().unwrap() ^= 0xFF;
    bytes
}

#[test]
fn unannounced_tcp_disconnect_triggers_fast_stop() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&move_to(20.0, 50.0));
    bench.pass(ms(100));
    reconnect(&mut bench);
    assert!(bench.has(SystemState::FAST_STOP));
    assert_eq!(bench.pass(ms(2000)), [], "the new client does not get the old result");
    assert!(bench.snapshot().width_mm > 90.0);
}

#[test]
fn fast_stop_on_disconnect_can_be_disabled() {
    let mut bench = Bench::homed(DeviceConfig { fast_stop_on_disconnect: false, ..DeviceConfig::wsg50() });
    bench.ask(&move_to(50.0, 50.0));
    reconnect(&mut bench);
    assert_eq!(bench.pass(ms(3000)), []);
    assert!(!bench.has(SystemState::FAST_STOP) && near(bench.snapshot().width_mm, 50.0));
}

#[test]
fn other_interfaces_ignore_disconnect() {
    for interface in [Interface::Udp, Interface::Serial, Interface::Can] {
        let mut bench = Bench::on(DeviceConfig::wsg50(), interface);
        bench.device.disconnect(bench.now);
        assert!(!bench.has(SystemState::FAST_STOP));
        assert_eq!(bench.reply(&looped(&[1])), Reply::Success(Data::Loop(vec![1])));
    }
}

#[test]
fn second_client_replaces_first() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    assert!(bench.device.connect(bench.now, Interface::Tcp));
    assert!(bench.has(SystemState::FAST_STOP));
}

#[test]
fn half_open_connection_passes_no_bytes_and_hides_its_end() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    bench.ask(&move_to(50.0, 50.0));
    bench.apply(Change::HalfOpen { on: true });
    let received = bench.device.received().len();
    assert_eq!(bench.ask(&Command::FastStop), []);
    assert_eq!(bench.device.received().len(), received);
    bench.pass(ms(3000));
    assert!(near(bench.snapshot().width_mm, 50.0), "the motion continues");
    assert_eq!(bench.happened(FaultName::HalfOpen), 2, "a request and a result");
    reconnect(&mut bench);
    assert!(!bench.has(SystemState::FAST_STOP));
    assert_eq!(bench.reply(&looped(&[1])), Reply::Success(Data::Loop(vec![1])));
}

#[test]
fn refused_connections_are_counted() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    bench.apply(Change::RefuseConnections { on: true });
    assert!(!bench.device.accepts_connections());
    assert!(!bench.device.connect(bench.now, Interface::Tcp));
    assert_eq!(bench.happened(FaultName::RefusedConnection), 1);
    assert_eq!(bench.reply(&looped(&[1])), Reply::Success(Data::Loop(vec![1])), "the open connection stays");
}

#[test]
fn requests_can_arrive_in_pieces_or_together() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    let two = [bytes(&looped(&[1])), bytes(&looped(&[2]))].concat();
    for byte in &two {
        bench.device.receive(bench.now, &[*byte]);
    }
    assert_eq!(bench.frames().len(), 2);
    bench.device.receive(bench.now, &two);
    assert_eq!(bench.frames().len(), 2);
}

#[test]
fn incomplete_request_is_given_up() {
    let mut bench = Bench::homed(DeviceConfig::wsg50());
    let start = [0xAA, 0xAA, 0xAA, id::LOOP, 0, 2];
    bench.device.receive(bench.now, &start);
    assert_eq!(bench.ask(&move_to(50.0, 50.0)), [], "part of the payload");
    assert_eq!(bench.pass(ms(499)), []);
    assert_eq!(bench.pass(ms(2)), [], "dropped with the rest of the frame");
    assert_eq!(bench.device.poll_timeout(), None);
    assert_eq!(bench.ask(&looped(&[1])), [(id::LOOP, Reply::Success(Data::Loop(vec![1])))]);

    bench.device.receive(bench.now, &start);
    assert_eq!(bench.ask(&Command::FastStop), [], "perhaps part of the payload");
    assert_eq!(bench.pass(ms(501)), [(id::FAST_STOP, DONE)], "perhaps not");
}

#[test]
fn request_of_any_size_gets_its_status_and_its_payload_does_nothing() {
    let mut bench = Bench::homed(DeviceConfig { bad_checksum: BadChecksum::Answer, ..DeviceConfig::wsg50() });
    let payload = [&[0; 10][..], &bytes(&move_to(50.0, 50.0)), &bytes(&Command::FastStop), &[0; 5000]].concat();
    let too_long = [
        (id::LOOP, Status::E_CMD_FORMAT_ERROR),
        (id::SET_DEVICE_TAG, Status::E_OVERRUN),
        (id::STOP, Status::E_NO_PARAM_EXPECTED),
        (id::GRIP, Status::E_CMD_FORMAT_ERROR),
        (0xB0, Status::E_CMD_UNKNOWN),
    ];
    for (id, status) in too_long {
        assert_eq!(bench.status_of_raw(id, &payload), status, "{id:02X}h");
    }
    assert!(!bench.has_any(SystemState::MOVING | SystemState::FAST_STOP));
    let mut wrong = Vec::new();
    wsg::frame::encode(id::LOOP, &[&[0; 10][..], &bytes(&move_to(50.0, 50.0)), &[0; 5000]].concat(), &mut wrong);
    *wrong.last_mut().unwrap() ^= 1;
    bench.device.receive(bench.now, &wrong);
    assert_eq!(bench.frames(), [(id::LOOP, status(Status::E_CHECKSUM_ERROR))]);
    assert!(!bench.has(SystemState::MOVING));
    assert_eq!(bench.status_of_raw(id::FAST_STOP, &[0; 5000]), Status::E_SUCCESS, "stops whatever its payload");
    assert!(bench.has(SystemState::FAST_STOP));
}

#[test]
fn bad_checksum_gets_silence_or_status() {
    for (bad_checksum, answered) in [(BadChecksum::Silence, false), (BadChecksum::Answer, true)] {
        let mut bench = Bench::new(DeviceConfig { bad_checksum, ..DeviceConfig::wsg50() });
        bench.device.receive(bench.now, &damaged(&Command::FastStop));
        let expected = [(id::FAST_STOP, status(Status::E_CHECKSUM_ERROR))];
        assert_eq!(bench.frames(), &expected[..usize::from(answered)]);
        assert!(!bench.has(SystemState::FAST_STOP) && bench.device.received().is_empty());
        assert_eq!(bench.snapshot().damaged_requests, 1);
    }
}

#[test]
fn evaluation_off_accepts_any_checksum_but_sends_correct_ones() {
    let config = DeviceConfig { checksum_evaluation: ChecksumEvaluation::Off, ..DeviceConfig::wsg50() };
    let mut bench = Bench::new(config);
    bench.device.receive(bench.now, &damaged(&Command::FastStop));
    assert_eq!(bench.frames(), [(id::FAST_STOP, DONE)]);
}

#[test]
fn full_queue_rejects_requests_except_fast_stop() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    for _ in 0..MAX_QUEUED_REPLIES + 10 {
        bench.device.receive(bench.now, &bytes(&looped(&[1])));
    }
    bench.device.receive(bench.now, &bytes(&Command::FastStop));
    assert!(bench.has(SystemState::FAST_STOP));
    assert_eq!(bench.snapshot().refused_requests, 11);
    assert_eq!(bench.frames().len(), MAX_QUEUED_REPLIES);
    assert_eq!(bench.ask(&looped(&[1])).len(), 1);
}

#[test]
fn request_log_is_bounded_but_counts_all() {
    let mut bench = Bench::new(DeviceConfig::wsg50());
    for _ in 0..=MAX_RECEIVED_FRAMES {
        bench.ask(&looped(&[1]));
    }
    bench.ask(&looped(&[2]));
    assert!(bench.device.received().len() <= MAX_RECEIVED_FRAMES);
    let last = bench.device.received().last().unwrap();
    assert_eq!((last.id, &last.payload[..], last.at), (id::LOOP, &[2][..], bench.now));
    assert_eq!(bench.snapshot().received_frames, MAX_RECEIVED_FRAMES as u64 + 2);
}
