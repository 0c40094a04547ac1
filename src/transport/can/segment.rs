//! How a frame travels on CAN: cut into slices of 8 bytes, each a classic data frame; the last may be short, and is not
//! padded. There is no sequence byte and no length byte, so the end is known from the frame's own size field alone
//! (field practice: four independent drivers agree; no vendor's text is public).
//!
//! This module knows three things of what it carries, which the rest of `transport` does not: what a frame begins with,
//! where its size stands, and how much there is besides. It only uses them to drop what lies behind a frame's end.
//! Whether a frame is whole, and where one begins if slices were lost, is for whoever checks its checksum.

/// A slice is what a classic CAN frame holds.
pub const SLICE_BYTES: usize = 8;

/// What a frame begins with.
const PREAMBLE: [u8; 3] = [0xAA; 3];

/// Where the size of its payload stands, as a little-endian number.
const SIZE_AT: std::ops::Range<usize> = 4..6;

/// What a frame has besides its payload: preamble, id, size, checksum.
const OVERHEAD_BYTES: usize = 8;

/// The slices of a frame.
pub fn slices(frame: &[u8]) -> impl Iterator<Item = &[u8]> {
    frame.chunks(SLICE_BYTES)
}

/// Makes a byte stream of slices again: frame behind frame, without what lies between them.
#[derive(Debug, Default)]
pub struct Reassembler {
    /// How many bytes of the frame that has begun are still to come.
    missing: usize,
}

impl Reassembler {
    /// Takes a slice, and returns what of it belongs to a frame.
    ///
    /// A preamble at the start of a slice begins a frame. If the one before isn't whole, either its rest was lost, or
    /// its payload happens to look like that: no byte is dropped until both would be whole, and the checksum tells.
    pub fn push<'a>(&mut self, slice: &'a [u8]) -> &'a [u8] {
        if slice.starts_with(&PREAMBLE) {
            let whole = match slice.get(SIZE_AT) {
                Some(&[low, high]) => OVERHEAD_BYTES + usize::from(u16::from_le_bytes([low, high])),
                // A sender that cuts elsewhere: a frame is as long as this at least.
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
    fn slices_have_eight_bytes_and_the_last_what_is_left() {
        let lengths = |payload: usize| slices(&frame(&vec![1; payload])).map(<[u8]>::len).collect::<Vec<_>>();
        assert_eq!(lengths(0), [8], "a Stop fills one");
        assert_eq!(lengths(8), [8, 8], "a Grip fills two");
        assert_eq!(lengths(6), [8, 6]);
        assert_eq!(lengths(9), [8, 8, 1]);
    }

    #[test]
    fn frames_of_any_length_come_together_again_one_behind_the_other() {
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
    fn what_lies_behind_the_end_is_dropped() {
        let padded = [&[0xAA, 0xAA, 0xAA, 0x22, 2, 0, 0, 0][..], &[0x0E, 0x76, 0, 0, 0, 0, 0, 0], &[0xFF; 8]];
        assert_eq!(reassembled(padded).len(), 10);
        assert!(reassembled([&[1, 2, 3][..], &[0xAA, 0xAA]]).is_empty());
    }

    #[test]
    fn a_preamble_begins_anew_where_slices_were_lost() {
        let long = frame(&[7; 20]);
        let cut = slices(&long).take(2);
        let bytes = reassembled(cut.chain([&STOP[..], &[0; 8], &STOP[..]]));
        assert!(bytes.windows(8).filter(|window| *window == STOP).count() >= 2, "{bytes:02X?}");
        let mut lost_start = slices(&long);
        lost_start.next();
        assert_eq!(reassembled(lost_start.chain([&STOP[..]])), STOP);
    }

    #[test]
    fn a_preamble_in_a_payload_costs_no_byte() {
        let mut payload = vec![1, 2];
        for size in [0u8, 1, 0xAA] {
            payload.extend([0xAA, 0xAA, 0xAA, 0x22, size, 0, 1, 2]);
        }
        payload.extend([3; 40]);
        let frame = frame(&payload);
        assert_eq!(reassembled(slices(&frame)), frame);
    }

    #[test]
    fn a_short_first_slice_is_no_end() {
        assert_eq!(reassembled([&STOP[..4], &STOP[4..]]), STOP);
        assert!(reassembled([&[][..]]).is_empty());
    }
}
