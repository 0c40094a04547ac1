//! Segmentation of frames on CAN into slices of 8 bytes, each a classic data frame. The last slice can be shorter and
//! is not padded. Slices have no sequence or length byte, so only the frame's own size field marks its end (field
//! practice: four independent drivers agree; no vendor documentation is public).
//!
//! Unlike the rest of `transport`, this module knows a frame's preamble, size field and overhead. It only uses them to
//! drop bytes after the end of a frame. The decoder checks whether a frame is complete, and resynchronises after lost
//! slices.

/// Capacity of a classic CAN frame.
pub const SLICE_BYTES: usize = 8;

/// First bytes of a frame.
const PREAMBLE: [u8; 3] = [0xAA; 3];

/// Position of the payload size, a little-endian number.
const SIZE_AT: std::ops::Range<usize> = 4..6;

/// Bytes of a frame besides its payload: preamble, id, size, checksum.
const OVERHEAD_BYTES: usize = 8;

/// Cuts a frame into slices.
pub fn slices(frame: &[u8]) -> impl Iterator<Item = &[u8]> {
    frame.chunks(SLICE_BYTES)
}

/// Joins slices into a byte stream of frames, without bytes between them.
#[derive(Debug, Default)]
pub struct Reassembler {
    /// Number of bytes of the current frame that are still missing.
    missing: usize,
}

impl Reassembler {
    /// Returns the bytes of `slice` that belong to a frame.
    ///
    /// A preamble at the start of a slice starts a frame. If the previous frame is incomplete, either its rest was
    /// lost, or its payload contains a preamble. So no byte is dropped until both would be complete; the checksum
    /// decides.
    pub fn push<'a>(&mut self, slice: &'a [u8]) -> &'a [u8] {
        if slice.starts_with(&PREAMBLE) {
            let whole = match slice.get(SIZE_AT) {
                Some(&[low, high]) => OVERHEAD_BYTES + usize::from(u16::from_le_bytes([low, high])),
                // A sender that cuts elsewhere. A frame has at least this length.
                _ => OVERHEAD_BYTES,
            };
            self.missing = self.missing.max(whole);
        }
        let belonging = slice.len().min(self.missing);
        self.missing -= belonging;
        &slice[..belonging]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STOP: [u8; 8] = [0xAA, 0xAA, 0xAA, 0x22, 0, 0, 0x0E, 0x76];

    fn frame(payload: &[u8]) -> Vec<u8> {
        let size = (payload.len() as u16).to_le_bytes();
        [&[0xAA, 0xAA, 0xAA, 0x06], &size[..], payload, &[0xC5, 0x5C]].concat()
    }

    fn reassembled<'a>(slices: impl IntoIterator<Item = &'a [u8]>) -> Vec<u8> {
        let mut reassembler = Reassembler::default();
        slices.into_iter().flat_map(|slice| reassembler.push(slice)).copied().collect()
    }

    #[test]
    fn slices_have_eight_bytes_except_the_last() {
        let lengths = |payload: usize| slices(&frame(&vec![1; payload])).map(<[u8]>::len).collect::<Vec<_>>();
        assert_eq!(lengths(0), [8], "a Stop fills one");
        assert_eq!(lengths(8), [8, 8], "a Grip fills two");
        assert_eq!(lengths(6), [8, 6]);
        assert_eq!(lengths(9), [8, 8, 1]);
    }

    #[test]
    fn frames_of_any_length_are_reassembled() {
        let mut sent = Vec::new();
        let mut reassembler = Reassembler::default();
        let mut received = Vec::new();
        for payload in 0..300 {
            let frame = frame(&vec![payload as u8; payload]);
            slices(&frame).for_each(|slice| received.extend_from_slice(reassembler.push(slice)));
            sent.extend(frame);
        }
        assert_eq!(received, sent);
    }

    #[test]
    fn bytes_after_the_end_are_dropped() {
        let padded = [&[0xAA, 0xAA, 0xAA, 0x22, 2, 0, 0, 0][..], &[0x0E, 0x76, 0, 0, 0, 0, 0, 0], &[0xFF; 8]];
        assert_eq!(reassembled(padded).len(), 10);
        assert!(reassembled([&[1, 2, 3][..], &[0xAA, 0xAA]]).is_empty());
    }

    #[test]
    fn preamble_restarts_after_lost_slices() {
        let long = frame(&[7; 20]);
        let cut = slices(&long).take(2);
        let bytes = reassembled(cut.chain([&STOP[..], &[0; 8], &STOP[..]]));
        assert!(bytes.windows(8).filter(|window| *window == STOP).count() >= 2, "{bytes:02X?}");
        let mut lost_start = slices(&long);
        lost_start.next();
        assert_eq!(reassembled(lost_start.chain([&STOP[..]])), STOP);
    }

    #[test]
    fn preamble_in_payload_loses_no_byte() {
        let mut payload = vec![1, 2];
        for size in [0u8, 1, 0xAA] {
            payload.extend([0xAA, 0xAA, 0xAA, 0x22, size, 0, 1, 2]);
        }
        payload.extend([3; 40]);
        let frame = frame(&payload);
        assert_eq!(reassembled(slices(&frame)), frame);
    }

    #[test]
    fn short_first_slice_does_not_end_frame() {
        assert_eq!(reassembled([&STOP[..4], &STOP[4..]]), STOP);
        assert!(reassembled([&[][..]]).is_empty());
    }
}
