//! Frames: `AA AA AA | id | size | payload | checksum`, little endian (`fw4-en 1.2.1`).
//!
//! [`encode`] appends a frame to a buffer. A [`Decoder`](super::Decoder) finds frames in a byte stream.

use super::crc;

/// First three bytes of every frame.
pub const PREAMBLE: [u8; 3] = [0xAA; 3];

/// Size in bytes of preamble, id and size field.
pub const HEADER_BYTES: usize = 6;

/// Bytes of a frame besides its payload: header and checksum.
pub const OVERHEAD_BYTES: usize = HEADER_BYTES + 2;

/// A frame without its checksum, which was verified unless [`ChecksumEvaluation`] is off.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Command id.
    pub id: u8,
    /// Bytes between the size field and the checksum.
    pub payload: &'a [u8],
}

/// Appends the frame of `id` and `payload` to `out`.
///
/// The size field has 16 bits, so a longer payload is truncated to 65535 bytes. No type of this crate can hold one.
pub fn encode(id: u8, payload: &[u8], out: &mut Vec<u8>) {
    encode_with(id, out, |out| out.extend_from_slice(payload));
}

/// Appends a frame of `id` with the payload that `write` appends.
pub fn encode_with(id: u8, out: &mut Vec<u8>, write: impl FnOnce(&mut Vec<u8>)) {
    let start = out.len();
    out.extend_from_slice(&PREAMBLE);
    out.extend_from_slice(&[id, 0, 0]);
    write(out);
    out.truncate(start + HEADER_BYTES + usize::from(u16::MAX));
    let size = (out.len() - start - HEADER_BYTES) as u16;
    out[start + 4..start + HEADER_BYTES].copy_from_slice(&size.to_le_bytes());
    let checksum = crc::checksum(&out[start..]);
    out.extend_from_slice(&checksum.to_le_bytes());
}

/// Whether a receiver evaluates checksums. Only a device can be configured not to (`fw4-en 1.4.1`).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ChecksumEvaluation {
    /// Frames with a wrong checksum are rejected.
    #[default]
    On,
    /// The two checksum bytes must be present, but can have any value.
    Off,
}
