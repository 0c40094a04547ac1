//! Effects of wire faults on a frame's bytes.

use wsg::{frame, id};

use super::faults::FaultKind;

/// Bytes without a frame, but with the start of a preamble.
const GARBAGE: [u8; 7] = [0x00, 0x55, 0xAA, 0xAA, 0x13, 0xFF, 0x7E];

/// Run of AAh before a frame: longer than a preamble, and not a multiple of one.
const PREAMBLE_RUN: [u8; 7] = [0xAA; 7];

/// Header of a missing 32-byte Loop reply.
const FALSE_HEADER: [u8; 6] = [0xAA, 0xAA, 0xAA, id::LOOP, 32, 0];

/// Splits a frame into the chunks that arrive.
pub(super) fn damage(kind: FaultKind, mut bytes: Vec<u8>) -> Vec<Vec<u8>> {
    match kind {
        FaultKind::CorruptByte => flip(&mut bytes, frame::HEADER_BYTES),
        FaultKind::CorruptChecksum => {
            let last = bytes.len() - 1;
            flip(&mut bytes, last);
        }
        FaultKind::CorruptSize => {
            bytes[4..frame::HEADER_BYTES].fill(0xFF);
        }
        FaultKind::HalfFrame => bytes.truncate(bytes.len() / 2),
        FaultKind::Garbage => bytes.splice(..0, GARBAGE).for_each(drop),
        FaultKind::PreambleRun => bytes.splice(..0, PREAMBLE_RUN).for_each(drop),
        FaultKind::FalsePreamble => bytes.splice(..0, FALSE_HEADER).for_each(drop),
        FaultKind::SplitBytes => return bytes.into_iter().map(|byte| vec![byte]).collect(),
        _ => {}
    }
    vec![bytes]
}

fn flip(bytes: &mut [u8], at: usize) {
    if let Some(byte) = bytes.get_mut(at) {
        *byte ^= 0x5A;
    }
}
