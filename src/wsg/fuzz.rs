//! Fuzz targets of the protocol.

use super::{ChecksumEvaluation, Command, Decoded, Decoder, Reply, frame, id};

/// Checks that the findings in a stream do not depend on how it is split, that each byte is accounted for, and that no
/// byte of a payload is taken for a frame. The first byte is the length of a piece; even lengths switch the evaluation
/// of checksums off.
///
/// # Panics
/// If a guarantee does not hold.
pub fn frames(data: &[u8]) {
    let Some((&piece, stream)) = data.split_first() else { return };
    let evaluation = if piece % 2 == 0 { ChecksumEvaluation::Off } else { ChecksumEvaluation::On };
    for new in [replies, Decoder::of_requests, requests_of_the_port] {
        let whole = findings(&mut new(evaluation), stream, stream.len());
        assert_eq!(whole, findings(&mut new(evaluation), stream, piece.into()), "split into pieces of {piece} bytes");
    }
    nested(evaluation, stream);
}

fn replies(evaluation: ChecksumEvaluation) -> Decoder {
    Decoder::new(id::max_reply_bytes, evaluation)
}

fn requests_of_the_port(evaluation: ChecksumEvaluation) -> Decoder {
    Decoder::of_requests(evaluation).with_short_announcements()
}

/// A finding: its kind, an id, and a payload or its length.
#[derive(Debug, PartialEq)]
enum Finding {
    Frame(u8, Vec<u8>),
    TooLong(u8, usize),
    Damaged(u8),
    MissedFastStop,
}

fn findings(decoder: &mut Decoder, stream: &[u8], in_pieces_of: usize) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut frame_bytes = 0;
    let before = decoder.counters();
    for piece in stream.chunks(in_pieces_of.max(1)) {
        decoder.push(piece);
        while let Some(decoded) = decoder.next() {
            findings.push(match decoded {
                Decoded::Frame(frame) => {
                    frame_bytes += frame.payload.len() + frame::OVERHEAD_BYTES;
                    Finding::Frame(frame.id, frame.payload.to_vec())
                }
                Decoded::TooLong { id, payload_bytes } => {
                    frame_bytes += payload_bytes + frame::OVERHEAD_BYTES;
                    Finding::TooLong(id, payload_bytes)
                }
                Decoded::Damaged { id } => Finding::Damaged(id),
                Decoded::MissedFastStop => Finding::MissedFastStop,
            });
        }
    }
    let counters = decoder.counters();
    let skipped = usize::try_from(counters.skipped_bytes - before.skipped_bytes).unwrap_or(usize::MAX);
    let short_announcements =
        findings.iter().filter(|found| matches!(found, Finding::Frame(0x07, payload) if payload.is_empty())).count();
    let accounted = skipped + frame_bytes + decoder.partial_bytes();
    // An announcement with a short size field has one byte less.
    assert!((accounted - short_announcements..=accounted).contains(&stream.len()), "{counters:?}");
    findings
}

/// Sends frames with these bytes as payload, once and repeated: whole, damaged, and interrupted.
fn nested(evaluation: ChecksumEvaluation, bytes: &[u8]) {
    let Some((&id, bytes)) = bytes.split_first().filter(|(id, _)| **id != frame::PREAMBLE[0]) else { return };
    let next = Finding::Frame(id::GET_SYSTEM_INFO, Vec::new());
    let mut next_bytes = Vec::new();
    frame::encode(id::GET_SYSTEM_INFO, &[], &mut next_bytes);
    for times in [1, 1 + 5000 / bytes.len().max(1), 65_535 / bytes.len().max(1)] {
        let payload = bytes.repeat(times);
        let mut sent = Vec::new();
        frame::encode(id, &payload, &mut sent);
        let cut = sent.len() * usize::from(bytes.first().copied().unwrap_or_default()) / 256;
        let mut decoders = vec![Decoder::of_requests(evaluation)];
        let is_reply = id != id::LOOP || payload.len() <= id::max_reply_bytes(id);
        if id::has_opaque_replies(id) && is_reply {
            let mut decoder = replies(evaluation);
            decoder.expect_opaque(std::iter::once(id));
            decoders.push(decoder);
        }
        for mut decoder in decoders {
            let found = frames_and_damage(&mut decoder, &[&sent[..], &next_bytes].concat());
            assert!(matches!(found[0], Finding::Frame(found, _) | Finding::TooLong(found, _) if found == id));
            assert_eq!(found[1..], [Finding::Frame(id::GET_SYSTEM_INFO, Vec::new())]);
            if evaluation == ChecksumEvaluation::On {
                let mut damaged = sent.clone();
                *damaged.last_mut().unwrap_or(&mut 0) ^= 1;
                let found = frames_and_damage(&mut decoder, &[&damaged[..], &next_bytes].concat());
                assert_eq!(found, [Finding::Damaged(id), Finding::Frame(id::GET_SYSTEM_INFO, Vec::new())]);
            }
            assert_eq!(findings(&mut decoder, &sent[..cut], 1000), []);
            decoder.give_up_partial();
            let rest = frames_and_damage(&mut decoder, &sent[cut..]);
            assert!(cut == 0 || rest.is_empty(), "{rest:?} in the rest of a frame that was given up");
            decoder.pause();
            assert_eq!(findings(&mut decoder, &next_bytes, 1000).last(), Some(&next));
        }
    }
}

/// Returns the findings except missed FAST STOPs, which any payload can contain.
fn frames_and_damage(decoder: &mut Decoder, stream: &[u8]) -> Vec<Finding> {
    let mut found = findings(decoder, stream, 1000);
    found.retain(|found| *found != Finding::MissedFastStop);
    found
}

/// Checks that a parsed reply or request survives a round trip. The first byte is the id; no command has the id AAh, which
/// a preamble would hide.
///
/// # Panics
/// If a guarantee does not hold.
pub fn payloads(data: &[u8]) {
    let Some((&id, payload)) = data.split_first().filter(|(id, _)| **id != 0xAA) else { return };
    let payload = &payload[..payload.len().min(id::max_reply_bytes(id).max(id::max_request_bytes(id)))];
    if let Ok(reply) = Reply::parse(id, payload) {
        let encoded = only_payload(|out| reply.encode(id, out), id::max_reply_bytes);
        assert_eq!(Reply::parse(id, &encoded), Ok(reply));
    }
    if let Ok(command) = Command::parse(id, payload) {
        let encoded = only_payload(|out| command.encode(out), id::max_request_bytes);
        assert_eq!(Command::parse(id, &encoded), Ok(command));
    }
}

/// Returns the payload of the only frame that is written.
fn only_payload(write: impl FnOnce(&mut Vec<u8>), max_payload_bytes: fn(u8) -> usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    write(&mut bytes);
    let mut decoder = Decoder::new(max_payload_bytes, ChecksumEvaluation::On);
    decoder.push(&bytes);
    let payload = match decoder.next() {
        Some(Decoded::Frame(frame)) => Some(frame.payload.to_vec()),
        _ => None,
    };
    assert!(payload.is_some() && !decoder.is_partial(), "not one frame: {bytes:02x?}");
    payload.unwrap_or_default()
}
