//! The first bytes of a connection, which show whether its client speaks the WSG protocol.
//!
//! A [`Decoder`](super::Decoder) resynchronises after any bytes. Without this check, it would find the frames in the body
//! of an HTTP request, and every web page can make a browser send such a request to a local port. A page cannot choose
//! the first bytes: they are the request line, a TLS handshake or a STUN header.

use super::frame::PREAMBLE;

/// Maximum number of bytes before the first preamble: the few that a line or a converter adds when it is switched on.
pub const MAX_NOISE_BYTES: usize = 16;

/// Bytes of an idle or disturbed line. With an AAh of an incomplete preamble, these are all bytes that can come before
/// the first frame. No other protocol begins with such bytes and a preamble.
const NOISE: [u8; 2] = [0x00, 0xFF];

/// Check of a connection's first bytes, which may arrive in pieces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Opening {
    /// Only noise and an incomplete preamble have arrived.
    Undecided {
        /// Bytes so far.
        bytes: usize,
        /// Bytes of the preamble at their end.
        preamble: usize,
    },
    /// The client has sent a preamble.
    Wsg,
    /// The client speaks another protocol. Nothing that it sends is a request.
    Foreign,
}

impl Default for Opening {
    fn default() -> Self {
        Self::Undecided { bytes: 0, preamble: 0 }
    }
}

impl Opening {
    /// Takes received bytes. Returns whether they, and all before them, may be those of a WSG client.
    pub fn accepts(&mut self, received: &[u8]) -> bool {
        for &byte in received {
            let Self::Undecided { bytes, preamble } = *self else { break };
            *self = match byte {
                _ if byte == PREAMBLE[0] && preamble + 1 == PREAMBLE.len() => Self::Wsg,
                _ if bytes == MAX_NOISE_BYTES + PREAMBLE.len() - 1 => Self::Foreign,
                _ if byte == PREAMBLE[0] => Self::Undecided { bytes: bytes + 1, preamble: preamble + 1 },
                _ if NOISE.contains(&byte) => Self::Undecided { bytes: bytes + 1, preamble: 0 },
                _ => Self::Foreign,
            };
        }
        *self != Self::Foreign
    }

    /// Whether a datagram begins with a frame. Each datagram is checked, because another program of the same host can
    /// send one to the same port.
    #[must_use]
    pub fn begins_with_frame(datagram: &[u8]) -> bool {
        let mut opening = Self::default();
        opening.accepts(datagram) && opening == Self::Wsg
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::encode;

    fn fast_stop() -> Vec<u8> {
        let mut bytes = Vec::new();
        encode(0x23, &[], &mut bytes);
        bytes
    }

    /// Whether the bytes are accepted, in pieces of each length.
    fn accepts(bytes: &[u8]) -> bool {
        let found = [1, 2, 3, 7, bytes.len()].map(|length| {
            let mut opening = Opening::default();
            bytes.chunks(length).all(|piece| opening.accepts(piece))
        });
        assert!(found.iter().all(|accepted| *accepted == found[0]), "{bytes:x?}: {found:?}");
        found[0]
    }

    #[test]
    fn frame_behind_a_little_noise_is_accepted() {
        let most = vec![0x00; MAX_NOISE_BYTES];
        let noises: [&[u8]; 8] = [
            &[],
            &[0x00],
            &[0xFF; 4],
            &[0xAA; 7],
            &[0xAA, 0xAA, 0x00],
            &[0x00, 0xFF, 0xAA, 0x00],
            &most,
            &[0xAA, 0xFF],
        ];
        for noise in noises {
            let bytes = [noise, &fast_stop()].concat();
            assert!(accepts(&bytes), "{noise:x?}");
            assert!(Opening::begins_with_frame(&bytes), "{noise:x?}");
        }
    }

    #[test]
    fn other_protocols_are_foreign_whatever_follows() {
        let too_much = vec![0xFF; MAX_NOISE_BYTES + 1];
        let stun = [0x00, 0x01, 0x00, 0x08, 0x21, 0x12, 0xA4, 0x42];
        let turn = [0x00, 0x03, 0x00, 0x08, 0x21, 0x12, 0xA4, 0x42];
        let beginnings: [&[u8]; 11] = [
            b"GET / HTTP/1.1\r\n\r\n",
            b"POST / HTTP/1.1\r\n\r\n",
            b"PRI * HTTP/2.0\r\n\r\n",
            b"SSH-2.0-x\r\n",
            b"x",
            b"\r\n",
            &[0x16, 0x03, 0x01],
            &[0xAA, 0xAA, 0x01],
            &stun,
            &turn,
            &too_much,
        ];
        for beginning in beginnings {
            let bytes = [beginning, &fast_stop()].concat();
            assert!(!accepts(&bytes), "{beginning:x?}");
            assert!(!Opening::begins_with_frame(&bytes), "{beginning:x?}");
        }
    }

    #[test]
    fn noise_alone_is_undecided_and_no_frame() {
        assert!(accepts(&[0x00, 0xFF, 0xAA, 0xAA]));
        assert!(!Opening::begins_with_frame(&[0x00, 0xFF, 0xAA, 0xAA]));
    }

    #[test]
    fn bytes_behind_the_first_preamble_are_not_judged() {
        assert!(accepts(&[&fast_stop()[..], b"GET / HTTP/1.1\r\n\r\n"].concat()));
    }
}
