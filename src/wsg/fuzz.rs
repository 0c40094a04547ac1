//! Fuzz targets of the protocol.

use super::{ChecksumEvaluation, Command, Decoded, Decoder, Reply, id};

/// Checks that the findings in a stream do not depend on how it is split, and that each byte is accounted for. The first
/// byte is the length of a piece; even lengths switch the evaluation of checksums off.
pub(crate) fn frames(data: &[u8]) {
    let Some((&piece, stream)) = data.split_first() else { return };
    let evaluation = if piece % 2 == 0 { ChecksumEvaluation::Off } else { ChecksumEvaluation::On };
    let whole = findings(stream, stream.len(), evaluation);
    assert_eq!(whole, findings(stream, piece.into(), evaluation), "split into pieces of {piece} bytes");
}

/// A frame's id and payload; no payload if it was damaged.
type Finding = (u8, Option<Vec<u8>>);

fn findings(stream: &[u8], in_pieces_of: usize, evaluation: ChecksumEvaluation) -> Vec<Finding> {
    let mut decoder = Decoder::new(id::max_reply_bytes, evaluation);
    let (mut findings, mut frame_bytes) = (Vec::new(), 0);
    for piece in stream.chunks(in_pieces_of.max(1)) {
        decoder.push(piece);
        while let Some(decoded) = decoder.next() {
            findings.push(match decoded {
                Decoded::Frame(frame) => {
                    frame_bytes += frame.payload.len() + 8;
                    (frame.id, Some(frame.payload.to_vec()))
                }
                Decoded::Damaged { id } => (id, None),
            });
        }
    }
    let counters = decoder.counters();
    let skipped = usize::try_from(counters.skipped_bytes).unwrap_or(usize::MAX);
    assert_eq!(skipped + frame_bytes + decoder.partial().len(), stream.len(), "{counters:?}");
    findings
}

/// Checks that a parsed reply or request survives a round trip. The first byte is the id; no command has the id AAh, which
/// a preamble would hide.
pub(crate) fn payloads(data: &[u8]) {
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
