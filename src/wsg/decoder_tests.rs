use super::*;
use crate::frame::encode;

fn decoder() -> Decoder {
    Decoder::new(|_| 300, ChecksumEvaluation::On)
}

fn frames(decoder: &mut Decoder) -> Vec<(u8, Vec<u8>)> {
    let mut found = Vec::new();
    while let Some(decoded) = decoder.next() {
        if let Decoded::Frame(frame) = decoded {
            found.push((frame.id, frame.payload.to_vec()));
        }
    }
    found
}

fn frame(id: u8, payload: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    encode(id, payload, &mut out);
    out
}

/// Frames printed in the manuals (`fw4-en 1.2.1`, `1.2.2`, `1.3`). Do not change them.
#[test]
fn golden_frames_of_the_manuals() {
    let golden: [(&str, u8, &[u8]); 7] = [
        ("AAAAAA010000E810", 0x01, &[]),
        ("AAAAAA01020012346D66", 0x01, &[0x12, 0x34]),
        ("AAAAAA2002000000B3FD", 0x20, &[0, 0]),
        ("AAAAAA9002000E00FD02", 0x90, &[0x0E, 0]),
        ("AAAAAA2102001A0067CB", 0x21, &[0x1A, 0]),
        ("AAAAAA21020000002804", 0x21, &[0, 0]),
        ("AAAAAA310600000000001643 1CAF", 0x31, &[0, 0, 0, 0, 0x16, 0x43]),
    ];
    for (printed, id, payload) in golden {
        let bytes = hex::decode(printed.replace(' ', "")).unwrap();
        assert_eq!(frame(id, payload), bytes, "{printed}");
        let mut decoder = decoder();
        decoder.push(&bytes);
        assert_eq!(frames(&mut decoder), [(id, payload.to_vec())], "{printed}");
    }
}

/// The reply to Get Acceleration is printed with one 00h missing (`fw4-en 1.2.2`, example 3).
#[test]
fn ruling_the_damaged_printed_frame_is_a_frame_cut_short() {
    let printed = hex::decode("AAAAAA3006000000001643DCCB").unwrap();
    let mut decoder = decoder();
    decoder.push(&printed);
    assert_eq!(frames(&mut decoder), []);
    assert!(decoder.is_partial());
    decoder.push(&frame(0x20, &[0, 0]));
    assert_eq!(frames(&mut decoder), [(0x20, vec![0, 0])], "the next frame is found");
    assert_eq!(decoder.counters().checksum_errors, 1);

    let restored = hex::decode("AAAAAA300600000000001643DCCB").unwrap();
    assert_eq!(frame(0x30, &[0, 0, 0, 0, 0x16, 0x43]), restored, "with the 00h its checksum is right");
}

#[test]
fn frame_split_at_any_byte_is_found() {
    let bytes = [frame(0x43, &[0, 0, 1, 2, 3, 4]), frame(0x06, &[0xAA; 20])].concat();
    for split in 0..bytes.len() {
        let mut decoder = decoder();
        decoder.push(&bytes[..split]);
        let mut found = frames(&mut decoder);
        decoder.push(&bytes[split..]);
        found.extend(frames(&mut decoder));
        assert_eq!(found, [(0x43, vec![0, 0, 1, 2, 3, 4]), (0x06, vec![0xAA; 20])], "split at {split}");
        assert_eq!(decoder.counters().skipped_bytes, 0);
    }
}

#[test]
fn garbage_and_runs_of_aa_lose_no_frame() {
    let mut decoder = decoder();
    let good = frame(0x41, &[0, 0, 4]);
    let stream = [&[0x00, 0xAA, 0xAA, 0x01][..], &good, &[0xAA; 5], &good, &[0xAA], &good].concat();
    decoder.push(&stream);
    assert_eq!(frames(&mut decoder).len(), 3);
    assert_eq!(decoder.counters().resynchronisations, 3);
    assert_eq!(decoder.counters().skipped_bytes, 4 + 5 + 1);
}

#[test]
fn oversized_frame_ends_at_once() {
    let mut decoder = decoder();
    decoder.push(&[0xAA, 0xAA, 0xAA, 0x40, 0xFF, 0xFF]);
    decoder.push(&frame(0x40, &[0, 0, 1, 0, 0, 0]));
    assert_eq!(frames(&mut decoder).len(), 1);
    assert_eq!(decoder.counters().oversized, 1);
}

#[test]
fn giving_up_partial_frame_reveals_frame_inside() {
    let mut decoder = decoder();
    decoder.push(&[0xAA, 0xAA, 0xAA, 0x06, 0x20, 0x00]);
    decoder.push(&frame(0x41, &[0, 0, 4]));
    assert_eq!(frames(&mut decoder), []);
    decoder.give_up_partial();
    assert_eq!(frames(&mut decoder), [(0x41, vec![0, 0, 4])]);
    assert!(!decoder.is_partial());
    assert_eq!(decoder.counters().cut_short, 1);
}

#[test]
fn evaluation_off_accepts_any_checksum_but_requires_one() {
    let mut decoder = Decoder::new(|_| 300, ChecksumEvaluation::Off);
    let mut bytes = frame(0x22, &[]);
    bytes[6..].copy_from_slice(&[0x12, 0x34]);
    decoder.push(&bytes[..7]);
    assert_eq!(frames(&mut decoder), []);
    decoder.push(&bytes[7..]);
    assert_eq!(frames(&mut decoder), [(0x22, vec![])]);
}

/// Returns all findings in order, each as its name and id.
fn found(decoder: &mut Decoder) -> Vec<(&'static str, u8)> {
    let mut found = Vec::new();
    while let Some(decoded) = decoder.next() {
        found.push(match decoded {
            Decoded::Frame(frame) => ("frame", frame.id),
            Decoded::TooLong { id, .. } => ("too long", id),
            Decoded::Damaged { id } => ("damaged", id),
            Decoded::MissedFastStop => ("missed", id::FAST_STOP),
        });
    }
    found
}

fn requests() -> Decoder {
    Decoder::of_requests(ChecksumEvaluation::On)
}

/// A move, surrounded by bytes of a payload.
fn payload_with_a_move(bytes_behind: usize) -> Vec<u8> {
    [&[0; 10][..], &frame(id::PRE_POSITION, &[0; 9]), &vec![0; bytes_behind]].concat()
}

const NEXT: u8 = id::GET_SYSTEM_INFO;

#[test]
fn request_of_any_size_is_consumed_whole() {
    for bytes_behind in [0, 300, 5000, 65_000] {
        let payload = payload_with_a_move(bytes_behind);
        let stream = [frame(id::LOOP, &payload), frame(NEXT, &[])].concat();
        let mut decoder = requests();
        decoder.push(&stream);
        let name = if payload.len() > id::MAX_OPAQUE_BYTES { "too long" } else { "frame" };
        assert_eq!(found(&mut decoder), [(name, id::LOOP), ("frame", NEXT)], "{bytes_behind}");
        assert_eq!(decoder.counters().skipped_bytes, 0);

        let mut in_pieces = requests();
        for piece in stream.chunks(700) {
            in_pieces.push(piece);
            while in_pieces.next().is_some() {}
            assert!(in_pieces.buffer.len() <= id::MAX_OPAQUE_BYTES + 2 * 700, "more was kept than the limit");
        }
        assert_eq!(in_pieces.counters().frames, 2);
    }
}

#[test]
fn ruling_damaged_request_is_dropped_with_its_payload() {
    for bytes_behind in [0, 5000] {
        let mut damaged = frame(id::LOOP, &payload_with_a_move(bytes_behind));
        *damaged.last_mut().unwrap() ^= 1;
        let mut decoder = requests();
        decoder.push(&[&damaged[..], &frame(NEXT, &[])].concat());
        assert_eq!(found(&mut decoder), [("damaged", id::LOOP), ("frame", NEXT)]);
        assert_eq!(decoder.counters().skipped_bytes, damaged.len() as u64);
    }
}

/// A size field that is too small leaves the rest of a payload behind.
#[test]
fn ruling_bytes_behind_a_damaged_request_are_dropped_until_a_pause() {
    let mut damaged = frame(id::LOOP, &payload_with_a_move(20));
    damaged[4] = 4;
    let mut decoder = requests();
    decoder.push(&[&damaged[..], &frame(NEXT, &[])].concat());
    assert_eq!(found(&mut decoder), [("damaged", id::LOOP)], "the end of the payload is not known");
    decoder.pause();
    decoder.push(&frame(NEXT, &[]));
    assert_eq!(found(&mut decoder), [("frame", NEXT)]);
}

#[test]
fn ruling_request_given_up_is_dropped_with_its_rest() {
    for (bytes_behind, cut) in [(300, 3), (300, 5), (300, 20), (300, 100), (5000, 4200)] {
        let whole = frame(id::LOOP, &payload_with_a_move(bytes_behind));
        let mut decoder = requests();
        decoder.push(&whole[..cut]);
        assert_eq!(found(&mut decoder), []);
        decoder.give_up_partial();
        decoder.push(&whole[cut..]);
        decoder.push(&frame(NEXT, &[]));
        assert_eq!(found(&mut decoder), [], "{cut}");
        assert!(!decoder.is_partial());
        decoder.pause();
        decoder.push(&frame(NEXT, &[]));
        assert_eq!(found(&mut decoder), [("frame", NEXT)]);
        assert_eq!(decoder.counters().skipped_bytes, whole.len() as u64 + 8);
    }
}

/// Without a pause, a client that sends without waiting would stay unheard.
#[test]
fn pause_need_not_separate_whole_requests() {
    let mut decoder = requests();
    decoder.push(&frame(NEXT, &[]).repeat(3));
    assert_eq!(found(&mut decoder).len(), 3);
}

#[test]
fn fast_stop_behind_a_damaged_size_is_found() {
    let fast_stop = frame(id::FAST_STOP, &[]);
    let missed = ("missed", id::FAST_STOP);
    // The size field swallows the FAST STOP, ends within it, or ends before the damage does.
    for (size, bytes_behind) in [(8_u8, 0), (5, 0), (100, 92)] {
        let mut damaged = frame(NEXT, &[]);
        damaged[4] = size;
        let mut decoder = requests();
        decoder.push(&[&damaged[..], &fast_stop, &vec![0; bytes_behind]].concat());
        assert_eq!(found(&mut decoder), [("damaged", NEXT), missed], "{size}");
        decoder.pause();
        decoder.push(&frame(id::STOP, &[]));
        assert_eq!(found(&mut decoder), [("frame", id::STOP)], "{size}");
    }
    let mut decoder = requests();
    decoder.push(&[&[0xAA, 0xAA, 0xAA, 0x40, 0xFF, 0xFF][..], &fast_stop.repeat(2)].concat());
    assert_eq!(found(&mut decoder), [], "it may be part of a payload");
    decoder.give_up_partial();
    assert_eq!(found(&mut decoder), [missed]);
    decoder.push(&fast_stop);
    assert_eq!(found(&mut decoder), [missed], "at once");
}

#[test]
fn fast_stop_in_a_valid_payload_is_none() {
    for bytes_behind in [0, 5000] {
        let payload = [frame(id::FAST_STOP, &[]), vec![0; bytes_behind]].concat();
        let mut decoder = requests();
        decoder.push(&frame(id::LOOP, &payload));
        assert_eq!(found(&mut decoder).len(), 1);
        decoder.push(&[0, 0, 0]);
        assert_eq!(found(&mut decoder), []);
    }
}

fn replies(expected: &[u8]) -> Decoder {
    let mut decoder = Decoder::new(id::max_reply_bytes, ChecksumEvaluation::On);
    decoder.expect_opaque(expected.iter().copied());
    decoder
}

#[test]
fn ruling_damaged_reply_with_opaque_data_is_dropped() {
    let result = frame(id::PRE_POSITION, &[0, 0]);
    let mut damaged = frame(id::LOOP, &[&[0, 0][..], &result].concat());
    *damaged.last_mut().unwrap() ^= 1;
    let stream = [&damaged[..], &result].concat();
    let mut decoder = replies(&[id::LOOP]);
    decoder.push(&stream);
    assert_eq!(found(&mut decoder), [("damaged", id::LOOP), ("frame", id::PRE_POSITION)], "only the true one");

    // Nobody asked for a Loop: its header is damage, and the frames behind it are true.
    let mut decoder = replies(&[]);
    decoder.push(&stream);
    assert_eq!(found(&mut decoder).len(), 3);
}

#[test]
fn ruling_reply_with_opaque_data_given_up_is_dropped() {
    let result = frame(id::PRE_POSITION, &[0, 0]);
    let whole = frame(0xB0, &[&[0, 0][..], &result, &[0; 9]].concat());
    let mut decoder = replies(&[0xB0]);
    decoder.push(&whole[..whole.len() - 4]);
    assert_eq!(found(&mut decoder), []);
    decoder.give_up_partial();
    assert_eq!(found(&mut decoder), []);
    decoder.pause();
    decoder.push(&result);
    assert_eq!(found(&mut decoder), [("frame", id::PRE_POSITION)]);
}

#[test]
fn reply_longer_than_the_limit_is_consumed_whole() {
    let result = frame(id::PRE_POSITION, &[0, 0]);
    let long = frame(0xB0, &[&[0, 0][..], &result.repeat(1000)].concat());
    let mut decoder = replies(&[0xB0]);
    decoder.push(&long);
    assert_eq!(found(&mut decoder), [("too long", 0xB0)]);
}

#[test]
fn size_that_no_echo_has_does_not_blind_the_decoder() {
    let result = frame(id::PRE_POSITION, &[0, 0]);
    let mut damaged = frame(id::LOOP, &[&[0, 0][..], &result].concat());
    damaged[5] = 0xFF;
    let mut decoder = replies(&[id::LOOP]);
    decoder.push(&damaged);
    assert_eq!(found(&mut decoder), [], "its payload is not searched");
    decoder.pause();
    decoder.push(&result);
    assert_eq!(found(&mut decoder), [("frame", id::PRE_POSITION)]);
}
