//! Frames of Modbus TCP (Modbus Messaging on TCP/IP Implementation Guide V1.0b): a header and a request or a response.

use bytes::{Buf as _, BufMut as _, Bytes};
use tokio_modbus::Request;
use tokio_modbus::prelude::{ConformityLevel, ExceptionCode, ReadCode};
use tokio_util::codec::LengthDelimitedCodec;

/// Longest value of the header's length: the unit identifier and a request of 253 bytes.
const MAX_LENGTH: usize = 254;

/// Position of the length in the header, and the bytes up to its end.
const LENGTH_AT: usize = 4;
const HEADER_TO_LENGTH: isize = 6;

/// Bit of the function code that marks an exception.
const EXCEPTION: u8 = 0x80;

/// Read Device Identification (Modbus Application Protocol V1.1b3, 6.21).
const IDENTIFICATION: [u8; 2] = [0x2B, 0x0E];

/// Function codes, and the position of the number of registers to write.
const WRITE_MULTIPLE: (u8, usize) = (16, 3);
const READ_AND_WRITE: (u8, usize) = (23, 7);

/// Maximum numbers of registers to write (Modbus Application Protocol V1.1b3, 6.12 and 6.17).
const MAX_WRITE: u16 = 123;

/// Header of a request, which its response repeats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Header {
    transaction: u16,
    pub unit: u8,
    pub function: u8,
}

/// Bytes that are not Modbus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct NotModbus;

/// Returns the codec that splits a stream into frames, with their headers.
pub(super) fn frames() -> LengthDelimitedCodec {
    LengthDelimitedCodec::builder()
        .length_field_offset(LENGTH_AT)
        .length_field_type::<u16>()
        .length_adjustment(HEADER_TO_LENGTH)
        .num_skip(0)
        .max_frame_length(MAX_LENGTH)
        .new_codec()
}

/// Whether a connection begins with a whole request that writes registers, which can be a FAST STOP.
pub(super) fn begins_with_write(first: &[u8]) -> bool {
    const WRITE_SINGLE: u8 = 6;
    let [_, _, 0, 0, 0, length, rest @ ..] = first else { return false };
    let writes = [WRITE_SINGLE, WRITE_MULTIPLE.0, READ_AND_WRITE.0];
    rest.len() >= usize::from(*length) && rest.get(1).is_some_and(|function| writes.contains(function))
}

/// Splits a frame into its header and its request, which begins with the function code.
pub(super) fn parse(mut frame: Bytes) -> Result<(Header, Bytes), NotModbus> {
    let transaction = frame.try_get_u16();
    let protocol = frame.try_get_u16();
    let _length = frame.try_get_u16();
    let unit = frame.try_get_u8();
    let (Ok(transaction), Ok(0), Ok(unit), Some(&function)) = (transaction, protocol, unit, frame.first()) else {
        return Err(NotModbus);
    };
    Ok((Header { transaction, unit, function }, frame))
}

/// Parses a request.
///
/// # Errors
/// The exception of a request that is not supported, or whose length or number of registers is wrong.
pub(super) fn request(request: Bytes) -> Result<Request<'static>, ExceptionCode> {
    // The parser relies on these checks.
    let count_at = match request.first() {
        Some(3 | 4 | 6) => None,
        Some(43) if request.get(1) == Some(&IDENTIFICATION[1]) => None,
        Some(&function) if function == WRITE_MULTIPLE.0 => Some(WRITE_MULTIPLE.1),
        Some(&function) if function == READ_AND_WRITE.0 => Some(READ_AND_WRITE.1),
        _ => return Err(ExceptionCode::IllegalFunction),
    };
    if count_at.is_some_and(|at| !has_valid_count(&request, at)) {
        return Err(ExceptionCode::IllegalDataValue);
    }
    // The function code is known, so the rest of the request is wrong.
    Request::try_from(request).map_err(|_| ExceptionCode::IllegalDataValue)
}

/// Whether the number at this position is a number of registers that a request can write.
fn has_valid_count(request: &[u8], at: usize) -> bool {
    match request.get(at..) {
        Some([high, low, ..]) => (1..=MAX_WRITE).contains(&u16::from_be_bytes([*high, *low])),
        _ => false,
    }
}

/// Returns the address and the registers that a request writes; `None` if it writes none.
pub(super) fn written(bytes: Bytes) -> Option<(u16, Vec<u16>)> {
    match request(bytes).ok()? {
        Request::WriteSingleRegister(address, word) => Some((address, vec![word])),
        Request::WriteMultipleRegisters(address, words) | Request::ReadWriteMultipleRegisters(_, _, address, words) => {
            Some((address, words.into_owned()))
        }
        _ => None,
    }
}

impl Header {
    /// Returns the frame of a response; `data` follows its function code.
    pub(super) fn response(self, data: &[u8]) -> Vec<u8> {
        self.frame(self.function, data)
    }

    pub(super) fn exception(self, exception: ExceptionCode) -> Vec<u8> {
        self.frame(self.function | EXCEPTION, &[exception.into()])
    }

    fn frame(self, function: u8, data: &[u8]) -> Vec<u8> {
        let mut frame = Vec::with_capacity(8 + data.len());
        frame.put_u16(self.transaction);
        frame.put_u16(0);
        // A response has at most 253 bytes.
        frame.put_u16(2 + data.len() as u16);
        frame.put_u8(self.unit);
        frame.put_u8(function);
        frame.put_slice(data);
        frame
    }
}

/// Data of a response with registers.
pub(super) fn registers(words: &[u16]) -> Vec<u8> {
    // 125 registers have 250 bytes.
    let count = 2 * words.len() as u8;
    std::iter::once(count).chain(words.iter().flat_map(|word| word.to_be_bytes())).collect()
}

/// Data of a response that repeats two words of its request: an address, and a value or a count.
pub(super) fn echo(address: u16, word: u16) -> Vec<u8> {
    [address.to_be_bytes(), word.to_be_bytes()].concat()
}

/// Data of the identification: the objects with these texts, of which the first has the id 0. `None` if the requested
/// object does not exist.
pub(super) fn identification(code: ReadCode, first: u8, objects: &[&str]) -> Option<Vec<u8>> {
    let all = (0_u8..).zip(objects);
    // For stream access, an unknown object id restarts at object 0.
    let is_known = usize::from(first) < objects.len();
    let chosen: Vec<_> = match code {
        ReadCode::Specific if !is_known => return None,
        ReadCode::Specific => all.filter(|(id, _)| *id == first).collect(),
        _ => all.filter(|(id, _)| !is_known || *id >= first).collect(),
    };
    let mut data = vec![IDENTIFICATION[1], code.value(), ConformityLevel::BasicIdentification.value(), 0, 0];
    // There are three objects.
    data.push(chosen.len() as u8);
    for (id, text) in chosen {
        let text = &text.as_bytes()[..text.floor_char_boundary(64)];
        // At most 64 bytes.
        data.extend([id, text.len() as u8]);
        data.extend(text);
    }
    Some(data)
}

#[cfg(test)]
mod tests {
    use bytes::BytesMut;
    use rand::rngs::StdRng;
    use rand::{RngExt as _, SeedableRng as _};
    use tokio_util::codec::Decoder as _;

    use super::*;

    fn frame(hex: &str) -> BytesMut {
        BytesMut::from(&hex::decode(hex.replace(' ', "")).unwrap()[..])
    }

    #[test]
    fn stream_is_split_into_frames() {
        let mut codec = frames();
        let mut stream = frame("0001 0000 0006 01 03 0064 0002 0002 0000 0006 FF");
        let first = codec.decode(&mut stream).unwrap().unwrap();
        let (header, request) = parse(first.freeze()).unwrap();
        assert_eq!(header, Header { transaction: 1, unit: 1, function: 3 });
        assert_eq!(&request[..], [3, 0, 0x64, 0, 2]);
        assert_eq!(codec.decode(&mut stream).unwrap(), None, "incomplete");
        assert!(frames().decode(&mut frame("0001 0000 00FF 01 03")).is_err(), "too long");
    }

    #[test]
    fn other_protocols_are_refused() {
        let wrong = ["0001 0001 0006 01 03 0064 0002", "0001 0000 0001 01", "0001 0000 0000"];
        for wrong in wrong {
            assert_eq!(parse(frame(wrong).freeze()), Err(NotModbus), "{wrong}");
        }
    }

    #[test]
    fn wrong_requests_have_exceptions() {
        let exception = |hex: &str| request(frame(hex).freeze()).map_err(u8::from).unwrap_err();
        for unsupported in ["00", "01", "0F 0000 0009 01 FF", "2B 0D 01 00", "2B", "83", "FF 00"] {
            assert_eq!(exception(unsupported), 1, "{unsupported}");
        }
        let wrong = [
            "03 0064",
            "10 0064 0002 02 0007",
            "10 0064 0000 00",
            "10 0064 8001 02 0007",
            "17 044C 0002 0064 FFFF 02 0007",
            "06 0064 0001 00",
        ];
        for wrong in wrong {
            assert_eq!(exception(wrong), 3, "{wrong}");
        }
    }

    #[test]
    fn no_request_panics() {
        let mut random = StdRng::seed_from_u64(1);
        for _ in 0..200_000 {
            let mut bytes: Vec<u8> = (0..random.random_range(0..40)).map(|_| random.random()).collect();
            if let Some(function) = bytes.first_mut().filter(|_| random.random_bool(0.8)) {
                *function = [3, 4, 6, 16, 23, 43][random.random_range(0..6)];
            }
            // Only a panic would be wrong.
            let _ = request(bytes.into());
        }
    }

    #[test]
    fn responses_repeat_the_header() {
        let header = Header { transaction: 0x1234, unit: 5, function: 3 };
        assert_eq!(header.response(&registers(&[0x0102, 0xFFFE])), frame("1234 0000 0007 05 03 04 0102 FFFE"));
        assert_eq!(header.exception(ExceptionCode::IllegalDataAddress), frame("1234 0000 0003 05 83 02"));
        assert_eq!(echo(100, 2), [0, 100, 0, 2]);
    }

    #[test]
    fn identification_has_three_objects() {
        let objects = ["maker", "left", "1.0"];
        let all = identification(ReadCode::Basic, 0, &objects).unwrap();
        assert_eq!(all, frame("0E 01 81 00 00 03 00 05 6D616B6572 01 04 6C656674 02 03 312E30"));
        assert_eq!(identification(ReadCode::Specific, 2, &objects).unwrap(), frame("0E 04 81 00 00 01 02 03 312E30"));
        assert_eq!(identification(ReadCode::Specific, 3, &objects), None);
        assert_eq!(identification(ReadCode::Basic, 99, &objects), Some(all));
    }
}
